"""Options that commands share, and values of options: names, counts and numbers."""

import argparse
from pathlib import Path

from sphfilter.errors import ConfigError

from ..scene.names import FILTERS

__all__ = ["add_run_options", "counted", "names_of", "numbers", "positive"]

_SCENARIO = "a name from `list`, or the path of a scenario's TOML file"


def add_run_options(parser, runs, folder, filters="the scenario's", more=""):
    """Add what commands take that run filters on a scenario.

    Parameters
    ----------
    parser : ArgumentParser
    runs, folder, filters : str
        The defaults of --runs, --out and --filters, in words.
    more : str
        What --runs counts, besides simulated runs.
    """
    parser.add_argument("scenario", help=_SCENARIO)
    parser.add_argument("--runs", type=counted, help=f"simulated runs{more} (default: {runs})")
    parser.add_argument("--jobs", type=counted, default=1, help="processes (default: 1)")
    seed = "seed of everything random (default: the scenario's, 1 unless its file says otherwise)"
    parser.add_argument("--seed", type=int, help=seed)
    names = f"comma-separated, of {', '.join(FILTERS)} (default: {filters})"
    parser.add_argument("--filters", type=names_of, help=names)
    parser.add_argument("--out", type=Path, help=f"folder for results (default: {folder})")


def names_of(text):
    """Names from a comma-separated list."""
    return [name.strip() for name in text.split(",")]


def counted(text):
    """A whole number of at least one."""
    if not text.isdigit() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"a whole number of at least 1 is needed, not {text!r}")
    return int(text)


def positive(text):
    """Different positive numbers from a comma-separated list, rising."""
    try:
        values = sorted({float(part) for part in text.split(",")})
    except ValueError:
        values = []
    if not values or not 0 < values[0] <= values[-1] < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is not a list of positive numbers like 0.5,1,2")
    return values


def numbers(option, text, kind, example=None):
    """Different numbers from a comma-separated list, rising; errors show an `example`."""
    try:
        found = sorted({kind(part) for part in text.split(",")})
    except ValueError:
        example = example or ("100,200,400" if kind is int else "0.1,0.05,0.025")
        raise ConfigError(f"{option} takes numbers such as {example}, not {text!r}") from None
    if found[0] <= 0:
        raise ConfigError(f"{option} takes numbers above zero, not {found[0]:g}")
    return found
