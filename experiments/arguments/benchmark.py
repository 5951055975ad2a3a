"""What `benchmark` takes."""

from pathlib import Path

from experiments.benchmark.families import FAMILIES, check_families
from experiments.scene.files import add_change_option, changes_of
from experiments.scene.reading import read_settings
from experiments.terminal.options import counted, names_of

__all__ = ["EXPENSIVE", "SCENARIOS", "add_arguments", "check"]

#: Those of the publication and the closed forms, then harder ones, then those never used in development, of
#: lattices first, and in the last row of the ladder either.
SCENARIOS = (
    "van_der_pol", "duffing", "cart", "linear_underdamped", "benes",
    "van_der_pol_sharp", "duffing_square", "lorenz",
    "pendulum", "bearing", "predator_prey", "vehicle", "fitzhugh_nagumo", "double_well", "falling_body",
    "tracking", "sharp_range", "bearings_only", "coordinated_turn", "three_oscillators", "volatility",
)  # fmt: skip
#: A name that is no scenario: what the rows of another one mean where the drift is expensive.
EXPENSIVE = "expensive"


def add_arguments(parser):
    """Add the options of `benchmark`."""
    names = f"names from `list` or paths of TOML files, or {EXPENSIVE} (default: all of them)"
    parser.add_argument("scenarios", nargs="*", metavar="NAME", help=names)
    families = f"comma-separated, of {', '.join(FAMILIES)}, sph:SCHEME (default: all that fit)"
    parser.add_argument("--filters", type=names_of, help=families)
    counts = "particles of the SPH and particle filters, comma-separated, instead of the usual ones"
    parser.add_argument("--counts", type=_counts, metavar="N,N", help=counts)
    parser.add_argument("--runs", type=counted, help="simulated runs (default: 5; 2 with --quick)")
    parser.add_argument(
        "--seed", type=int, default=1, help="seed of everything random (default: %(default)s)"
    )
    limit = "seconds a run may take; larger sizes are left out (default: 10)"
    parser.add_argument("--limit", type=float, help=limit)
    paths = "particles in all of a reference above two states; more of them later add to those on disk"
    parser.add_argument("--reference-paths", type=float, metavar="N", help=paths)
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("results/benchmark"),
        help="folder for results (default: %(default)s)",
    )
    size = parser.add_mutually_exclusive_group()
    size.add_argument("--quick", action="store_true", help="two runs, coarse references: does it work?")
    size.add_argument("--full", action="store_true", help="larger sizes and finer references: takes hours")
    add_change_option(parser)


def _counts(text):
    return tuple(sorted({counted(part) for part in names_of(text)}))


def check(args):
    """Raise what is wrong with scenarios or competitors."""
    for name in args.scenarios:
        if name != EXPENSIVE:
            read_settings(name, changes_of(args))
    check_families(args.filters or ())
