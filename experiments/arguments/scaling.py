"""What `scaling` takes."""

from pathlib import Path

from experiments.terminal.options import counted, names_of, numbers
from experiments.transient.settings import read_problem
from sphfilter.errors import ConfigError

SCHEMES = ("log_density", "paper")
_COUNTS = "500,1000,2000,5000,10000,20000"


def add_arguments(add):
    """Add the options of `scaling`."""
    add("scenario", "a transient scenario with a Gaussian start", default="van_der_pol", nargs="?")
    add("--schemes", "comma-separated", names_of, list(SCHEMES), "all")
    add("--counts", "particles, comma-separated", default=_COUNTS)
    add("--interval", "seconds to predict", float, 0.2)
    add("--samples", "samples a median is taken of", counted, 3)
    add("--out", "folder for the table", Path, Path("results/scaling"))


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
