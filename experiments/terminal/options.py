"""Options that commands share, and values of options: names, counts and numbers."""

import argparse
from pathlib import Path

from sphfilter.errors import ConfigError

from ..scene.files import changes_of
from ..scene.names import FILTERS, check_filters
from ..scene.reading import read_settings

_CHANGE = (
    "change a key of the scenario, e.g. times.interval=3, the scheme of the SPH filter, e.g. "
    "scheme=cloud, or a key of the published one, e.g. scheme.kernel=gaussian; may be repeated"
)


def adder(parser):
    """A function add(name, help, kind, default, **look) that adds an option or an argument to a parser.

    `kind` makes a value of the text; `bool` is a flag. The help tells the default, in the words `otherwise`
    where there are some; `look` is what argparse is told besides.
    """

    def add(name, help, kind=str, default=None, otherwise="", **look):
        if kind is bool:
            look["action"] = "store_true"
        else:
            look |= {"type": kind, "default": default}
            otherwise = otherwise or _text(default)
        parser.add_argument(
            *name.split(), help=f"{help} (default: {otherwise})" if otherwise else help, **look
        )

    return add


def _text(default):
    """A default for people; empty for none."""
    if isinstance(default, list):
        return ",".join(default)
    return "" if default is None else str(default)


def add_changes(add, help=_CHANGE):
    """Add the option --set, whose values `scene.files.changes_of` reads."""
    add("--set", help, dest="changes", action="append", default=[], metavar="KEY=VALUE")


def add_run(add, folder, runs=None, filters="the scenario's", counted_at=""):
    """Add what commands take that run filters on a scenario; `check_run` checks it.

    The `folder` is the default of --out, in words, `runs` that of --runs, the scenario's if None, and
    `filters` that of --filters, in words or as it is. Runs are made `counted_at` something, if not once.
    """
    own = "the scenario's, {} unless its file says otherwise"
    chosen = filters if isinstance(filters, list) else None
    add("scenario", "a name from `list`, or the path of a scenario's TOML file")
    add("--runs", f"simulated runs{counted_at}", counted, runs, "" if runs else own.format(5))
    add("--jobs", "processes", counted, 1)
    add("--seed", "seed of everything random", int, None, own.format(1))
    add("--filters", f"comma-separated, of {', '.join(FILTERS)}", names_of, chosen, "" if chosen else filters)
    add("--out", "folder for results", Path, None, folder)
    add_changes(add)


def check_run(args):
    """Raise what is wrong with the scenario, its changes or the filters."""
    read_settings(args.scenario, changes_of(args))
    check_filters(args.filters)


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
