"""What `skips` takes."""

from pathlib import Path

from sphfilter.errors import ConfigError


def add_arguments(add):
    """Add the options of `skips`."""
    add("--samples", "samples a median is taken of", int, 7)
    add("--only", "shortcuts with this text in their name or scene", default="", metavar="TEXT")
    add("--out", "folder for the tables", Path, Path("results/skips"))


def check(args):
    """Raise what is wrong with the number of samples."""
    if args.samples < 5:
        raise ConfigError(f"--samples must be 5 at least for a median worth its name, not {args.samples}")
