"""What `converge` takes."""

from pathlib import Path

from experiments.scene.files import add_change_option, changes_of
from experiments.scene.reading import read_settings, scenario_names
from experiments.terminal.options import names_of, numbers
from experiments.transient.reading import problem_names, read_problem
from sphfilter.errors import ConfigError

__all__ = ["EPILOG", "FILTER", "add_arguments", "check", "counts_of", "sizes_of", "study_of"]

EPILOG = """\
What is studied:
  NAME of a filter scenario       the SPH filter against its exact filter, over particles
  [NAME,...] --over nodes         whether more nodes make the SPH filter worse: scenarios of one or two states
  [NAME,...] --sensors            ... on sensors of one state, such as cubic,Laplace
  NAME --over particles           a density without measurements (`list`), over particles, as its file says
  NAME --over scheme              ... of every scheme, with run times
  NAME --over step                ... of the published scheme, over time steps (or C_CFL) and integrators
"""
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


def add_arguments(parser):
    """Add the options of `converge`."""
    parser.add_argument(
        "scenario", nargs="?", metavar="NAME", help="default: linear_underdamped, or see below"
    )
    parser.add_argument("--over", choices=("particles", "scheme", "step", "nodes"), help="see below")
    parser.add_argument("--sensors", action="store_true", help="nodes doubled on sensors of one state")
    parser.add_argument("--counts", help="particles at most, comma-separated")
    parser.add_argument("--n-particles", type=int, help="particles of --over step, at most")
    parser.add_argument("--schemes", help="comma-separated (default: log_density,paper)")
    parser.add_argument("--steps", help="fixed time steps in seconds, comma-separated")
    parser.add_argument("--c-cfl", help="or values of C_CFL, comma-separated")
    parser.add_argument("--end", type=float, help="time at which a density is left alone, seconds")
    parser.add_argument("--limit", type=float, help="seconds one solution may take (default: 300)")
    parser.add_argument("--filter", choices=("sph", "sph_paper"), help="of a filter scenario (default: sph)")
    parser.add_argument("--runs", type=int, help="simulated runs of a filter for each count (default: 3)")
    parser.add_argument("--seed", type=int, help="seed of everything random, of a filter scenario")
    parser.add_argument("--out", type=Path, help="folder for table and picture (default: in results)")
    example = (
        "e.g. times.interval=3; scheme.kernel=gaussian of a filter, solver.config.scheme.kernel=gaussian"
    )
    add_change_option(parser, f"change a key of the scenario, {example} of a density; may be repeated")


def study_of(args):
    """Which of `_TAKES` is asked for; a name that filters do not know may be one of a density."""
    asked = [f"--{name}" for name in ("sensors",) if getattr(args, name)]
    asked += [f"--over {args.over}"] if args.over else []
    if len(asked) > 1:
        raise ConfigError(f"{' and '.join(asked)} are different studies: ask for one of them")
    if asked:
        return asked[0]
    return "--over particles" if args.scenario in _densities_only() else FILTER


def _densities_only():
    return set(problem_names()) - set(scenario_names())


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
