"""What `transient` takes."""

from pathlib import Path
from shutil import which

from experiments.scene.files import add_change_option, changes_of
from experiments.transient.help import EPILOG
from experiments.transient.reading import read_problem
from sphfilter.errors import ConfigError

__all__ = ["EPILOG", "add_arguments", "check"]


def add_arguments(parser):
    """Add the options of `transient`."""
    parser.add_argument("name", nargs="?", help="a name from `list`")
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="a TOML file of your own instead of a name"
    )
    parser.add_argument("--out", type=Path, help="folder for results (default: results/transient/NAME)")
    parser.add_argument("--n-particles", type=int, help="particles, at most")
    parser.add_argument(
        "--remesh",
        metavar="RULES",
        help="solve with each rule for new lattices on the way, e.g. never,health,2 (seconds), and compare",
    )
    columns = (
        "of the printed table: means and standard deviations of six states at most, and what the file asks "
        "for; or all moments, as in statistics.csv (default: %(default)s)"
    )
    parser.add_argument("--columns", choices=("states", "all"), default="states", help=columns)
    parser.add_argument("--no-reference", action="store_true", help="do not compute the reference")
    parser.add_argument("--animate", metavar="FILE", help="write the densities as a film, .gif or .mp4")
    parser.add_argument("--live", action="store_true", help="show the densities in a window as they come")
    example = "e.g. solver.config.scheme=paper or times.end=10"
    add_change_option(parser, f"change a key of the file, {example}; may be repeated")


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
