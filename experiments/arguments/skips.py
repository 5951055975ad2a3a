"""What `skips` takes."""

from pathlib import Path

from sphfilter.errors import ConfigError

__all__ = ["add_arguments", "check"]


def add_arguments(parser):
    """Add the options of `skips`."""
    parser.add_argument(
        "--samples", type=int, default=7, help="samples a median is taken of (default: %(default)s)"
    )
    only = "shortcuts with this text in their name or scene"
    parser.add_argument("--only", default="", metavar="TEXT", help=only)
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("results/skips"),
        help="folder for the tables (default: %(default)s)",
    )


def check(args):
    """Raise what is wrong with the number of samples."""
    if args.samples < 5:
        raise ConfigError(f"--samples must be 5 at least for a median worth its name, not {args.samples}")
