"""What `transient` takes."""

from pathlib import Path
from shutil import which

from experiments.scene.files import changes_of
from experiments.terminal.options import add_changes
from experiments.transient.settings import read_problem
from sphfilter.errors import ConfigError


def add_arguments(add):
    """Add the options of `transient`."""
    add("name", "a name from `list`", nargs="?")
    add("--config", "a TOML file of your own instead of a name", Path, metavar="FILE")
    add("--out", "folder for results", Path, None, "results/transient/NAME")
    add("--n-particles", "particles, at most", int)
    rules = "solve with each rule for new lattices on the way, e.g. never,health,2 (seconds), and compare"
    add("--remesh", rules, metavar="RULES")
    columns = (
        "of the printed table: means and standard deviations of six states at most, and what the file asks "
        "for; or all moments, as in statistics.csv"
    )
    add("--columns", columns, default="states", choices=("states", "all"))
    add("--no-reference", "do not compute the reference", bool)
    add("--animate", "write the densities as a film, .gif or .mp4", metavar="FILE")
    add("--live", "show the densities in a window as they come", bool)
    example = "e.g. solver.config.scheme=paper or times.end=10"
    add_changes(add, f"change a key of the file, {example}; may be repeated")


def check(args):
    """Raise what is wrong with the file, or with options that do not go together."""
    if (args.name is None) == (args.config is None):
        raise ConfigError("transient takes a name from `list`, or --config FILE, one of them")
    if args.remesh and (args.animate or args.live):
        raise ConfigError("--remesh compares several solutions: --animate and --live are for one")
    if args.animate:
        _check_film(args.animate)
    read_problem(args.config or args.name, changes_of(args))


def _check_film(name):
    path = Path(name)
    if path.suffix.lower() not in (".gif", ".mp4"):
        raise ConfigError(f"--animate writes GIF and MP4 files: {name} ends in neither .gif nor .mp4")
    if not path.parent.is_dir():
        raise ConfigError(f"--animate: the folder {path.parent} does not exist")
    if path.suffix.lower() == ".mp4" and which("ffmpeg") is None:
        raise ConfigError(
            f"--animate {name} needs the program ffmpeg, which is not installed: install it, or write a .gif"
        )
