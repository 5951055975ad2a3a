"""What `stress` takes."""

import argparse
from pathlib import Path

from experiments.terminal.options import counted, names_of
from sphfilter.errors import ConfigError, nearest

#: What begins the names of filters that choose their particles by their error, .01 or .03; and all on trial.
AUTO = "auto"
FILTERS = ("default", "paper", "pf1e3", "pf1e4", AUTO, f"{AUTO}.03")


def add_arguments(add):
    """Add the options of `stress`."""
    add("--quick", "a reduced grid, that the tests walk too", bool)
    only = "cells to run: a family, or FAMILY/SYSTEM/LEVEL with * and ?; may be repeated"
    add("--only", only, action="append", default=[], metavar="CELL")
    usual = f"all but {AUTO} on the grid, default on random problems"
    add("--filters --methods", f"comma-separated, of {', '.join(FILTERS)}", names_of, None, usual)
    add("--seed", "seed of everything random", int, 1)
    add("--limit", "seconds a run may take", _seconds, 60.0)
    add("--out", "folder for results", Path, Path("results/stress"))
    add("--jobs", "processes", counted, 1)
    add("--random", "N random problems instead of the grid", counted, metavar="N")
    again = "random problem number K of seed S alone, as S:K; may be repeated"
    add("--random-case", again, _pair, [], action="append", metavar="S:K")
    auto = f"--filters {AUTO}: the default filter, which chooses its particles by its error"
    add("--auto", auto, bool)
    add("--list", "print the names of the cells and stop", bool)


def _seconds(text):
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not value > 0:
        raise argparse.ArgumentTypeError(f"a number of seconds above zero is needed, not {text!r}")
    return value


def _pair(text):
    """Seed and number of a random problem."""
    parts = text.split(":")
    if len(parts) != 2 or not all(part.isdigit() for part in parts):
        raise argparse.ArgumentTypeError(f"a seed and a number such as 1:20 are needed, not {text!r}")
    return int(parts[0]), int(parts[1])


def check(args):
    """Raise what is wrong with filters, or with options that do not go together; fill in the filters."""
    random = args.random or args.random_case
    given = [name for name in FILTERS if not name.startswith(AUTO)]
    usual = [] if args.auto else ["default"] if random else given
    args.filters = list(dict.fromkeys([*(args.filters or usual), *([AUTO] if args.auto else [])]))
    for name in args.filters:
        if name not in FILTERS:
            raise ConfigError(f"no filter {name!r}{nearest(name, FILTERS)}; there are {', '.join(FILTERS)}")
    if random and (args.only or args.quick):
        raise ConfigError(
            "--random and --random-case go without --only and --quick, which choose from the grid"
        )
