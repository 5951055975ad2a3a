"""What `scaling` takes."""

from pathlib import Path

from experiments.terminal.options import counted, names_of, numbers
from experiments.transient.reading import read_problem
from sphfilter.errors import ConfigError

__all__ = ["add_arguments", "check", "counts_of"]

SCHEMES = ("log_density", "paper")
_COUNTS = "500,1000,2000,5000,10000,20000"


def add_arguments(parser):
    """Add the options of `scaling`."""
    transient = "a transient scenario with a Gaussian start (default: van_der_pol)"
    parser.add_argument("scenario", nargs="?", default="van_der_pol", help=transient)
    schemes = "comma-separated (default: all)"
    parser.add_argument("--schemes", type=names_of, default=list(SCHEMES), help=schemes)
    parser.add_argument("--counts", default=_COUNTS, help=f"particles, comma-separated (default: {_COUNTS})")
    parser.add_argument("--interval", type=float, default=0.2, help="seconds to predict (default: 0.2)")
    parser.add_argument(
        "--samples", type=counted, default=3, help="samples a median is taken of (default: %(default)s)"
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("results/scaling"),
        help="folder for the table (default: %(default)s)",
    )


def check(args):
    """Raise what is wrong with scenario, schemes or numbers."""
    for name in args.schemes:
        if name not in SCHEMES:
            raise ConfigError(f"no scheme {name!r}; there are {', '.join(SCHEMES)}")
    if not args.interval > 0.0:
        raise ConfigError(f"scaling needs an --interval above 0, not {args.interval:g}")
    counts_of(args)
    if read_problem(args.scenario)[1].start.kind != "gaussian":
        raise ConfigError(f"{args.scenario} does not start from a Gaussian, which all schemes can carry")


def counts_of(args):
    """Numbers of particles that are asked for."""
    return numbers("--counts", args.counts, int, _COUNTS)
