"""What `benchmark` takes."""

from pathlib import Path

from experiments.benchmark.families import FAMILIES, check_families
from experiments.scene.files import changes_of
from experiments.scene.reading import read_settings
from experiments.terminal.options import add_changes, counted, names_of
from sphfilter.errors import ConfigError

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


def add_arguments(add):
    """Add the options of `benchmark`."""
    names = f"names from `list` or paths of TOML files, or {EXPENSIVE}"
    add("scenarios", names, otherwise="all of them", nargs="*", metavar="NAME")
    add("--filters", f"comma-separated, of {', '.join(FAMILIES)}, sph:SCHEME", names_of, None, "all that fit")
    counts = "particles of the SPH and particle filters, comma-separated, instead of the usual ones"
    add("--counts", counts, _counts, metavar="N,N")
    add("--runs", "simulated runs", counted, None, "5; 2 with --quick")
    add("--seed", "seed of everything random", int, 1)
    add("--limit", "seconds a run may take, without compiling; larger sizes are left out", float, None, "10")
    paths = "particles in all of a reference above two states; more of them later add to those on disk"
    add("--reference-paths", paths, float, metavar="N")
    add("--out", "folder for results", Path, Path("results/benchmark"))
    add("--quick", "two runs, coarse references: does it work?", bool)
    add("--full", "larger sizes and finer references: takes hours", bool)
    add_changes(add)


def _counts(text):
    return tuple(sorted({counted(part) for part in names_of(text)}))


def check(args):
    """Raise what is wrong with sizes, scenarios or competitors."""
    if args.quick and args.full:
        raise ConfigError("--quick and --full are two sizes of a benchmark: give one of them")
    for name in args.scenarios:
        if name != EXPENSIVE:
            read_settings(name, changes_of(args))
    check_families(args.filters or ())
