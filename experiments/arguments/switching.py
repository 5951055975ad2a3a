"""What `switching` takes."""

from experiments.switching.settings import NAMES, read_settings
from experiments.terminal.options import counted


def add_arguments(add):
    """Add the options of `switching`."""
    names = f"{', '.join(NAMES)}, or a file of your own that ends in .toml"
    add("scenario", names, default="course", nargs="?")
    add("--runs", "simulated runs", counted, 2)
    add("--seed", "seed of the first run", int, 1)


def check(args):
    """Raise what is wrong with the scenario."""
    read_settings(args.scenario)
