"""What `converge` takes."""

from pathlib import Path

from experiments.scene.files import changes_of
from experiments.scene.reading import read_settings, scenario_names
from experiments.terminal.options import add_changes, names_of, numbers
from experiments.transient.settings import problem_names, read_problem
from sphfilter.errors import ConfigError

FILTER = "a filter scenario"
_DEFAULTS = {"filter": "sph", "runs": 3, "seed": 0, "limit": 300.0}
#: Options that each study takes besides NAME, --out and --set; the others are refused.
_TAKES = {
    FILTER: {"filter", "counts", "runs", "seed"},
    "--over nodes": {"counts", "runs", "seed"},
    "--sensors": {"counts", "runs", "seed"},
    "--over particles": {"counts", "end", "limit"},
    "--over scheme": {"counts", "schemes", "end", "limit"},
    "--over step": {"n_particles", "steps", "c_cfl", "end", "limit"},
}
_COUNTS = {FILTER: "100,200,400,800,1600", "--over particles": "200,400,800,1600"}
_COUNTS["--over scheme"] = _COUNTS["--over particles"]
_COUNTS["--over nodes"] = _COUNTS["--sensors"] = "50,100,200,400,800,1600"


def add_arguments(add):
    """Add the options of `converge`."""
    add(
        "scenario", "what is studied", otherwise="linear_underdamped, or see below", nargs="?", metavar="NAME"
    )
    add("--over", "see below", choices=("particles", "scheme", "step", "nodes"))
    add("--sensors", "nodes doubled on sensors of one state", bool)
    add("--counts", "particles at most, comma-separated")
    add("--n-particles", "particles of --over step, at most", int)
    add("--schemes", "comma-separated", otherwise="log_density,paper")
    add("--steps", "fixed time steps in seconds, comma-separated")
    add("--c-cfl", "or values of C_CFL, comma-separated")
    add("--end", "time at which a density is left alone, seconds", float)
    add("--limit", "seconds one solution may take", float, None, "300")
    add("--filter", "of a filter scenario", otherwise="sph", choices=("sph", "sph_paper"))
    add("--runs", "simulated runs of a filter for each count", int, None, "3")
    add("--seed", "seed of everything random, of a filter scenario", int)
    add("--out", "folder for table and picture", Path, None, "in results")
    example = "times.interval=3; scheme.kernel=gaussian of a filter, solver.config.scheme.kernel=gaussian"
    add_changes(add, f"change a key of the scenario, e.g. {example} of a density; may be repeated")


def study_of(args):
    """Which of `_TAKES` is asked for; a name that filters do not know may be one of a density."""
    if args.sensors and args.over:
        raise ConfigError(f"--sensors and --over {args.over} are different studies: ask for one of them")
    if args.sensors or args.over:
        return "--sensors" if args.sensors else f"--over {args.over}"
    alone = set(problem_names()) - set(scenario_names())
    return "--over particles" if args.scenario in alone else FILTER


def _refuse_others(args, study):
    every = set().union(*_TAKES.values())
    for name in sorted(every - _TAKES[study]):
        if getattr(args, name):
            option = "--" + name.replace("_", "-")
            known = ", ".join("--" + key.replace("_", "-") for key in sorted(_TAKES[study]))
            raise ConfigError(f"{option} has no meaning for {study}, which takes {known}, --out and --set")


def sizes_of(args):
    """The rule of `--over step` and its values, None if none are given."""
    if args.steps and args.c_cfl:
        raise ConfigError("--steps and --c-cfl are two ways to choose time steps: give one of them")
    if args.c_cfl:
        return "c_cfl", numbers("--c-cfl", args.c_cfl, float)
    return "step", numbers("--steps", args.steps, float) if args.steps else None


def counts_of(args, study):
    """Numbers of particles that are asked for."""
    counts = numbers("--counts", args.counts or _COUNTS[study], int)
    if len(counts) < 2:
        raise ConfigError(f"--counts: two different counts at least are needed, not {args.counts}")
    return counts


def check(args):
    """Raise what is wrong with scenario or numbers, or with options of other studies; sets what is open."""
    study = study_of(args)
    _refuse_others(args, study)
    for key, value in _DEFAULTS.items():
        if getattr(args, key) is None:
            setattr(args, key, value)
    if study == "--sensors" and args.changes:
        raise ConfigError("--set has no meaning for --sensors")
    if study == "--over step":
        sizes_of(args)
    elif study in _COUNTS:
        counts_of(args, study)
    readers = {FILTER: read_settings, "--over nodes": read_settings, "--sensors": None}
    read = readers.get(study, read_problem)
    for name in names_of(args.scenario) if args.scenario and read else ():
        read(name, changes_of(args))
