"""What `switching` takes."""

from experiments.switching.settings import NAMES, read_settings
from experiments.terminal.options import counted

__all__ = ["EPILOG", "add_arguments", "check"]

EPILOG = """\
Mode probabilities and means are held against those of the referee, means in its standard deviations, rms over
all epochs and runs. The referee is a grid where there are one or two states, with half the step the second
time; else particles, drawn anew the second time. Its two opinions are apart by what its row tells.
"""


def add_arguments(parser):
    """Add the options of `switching`."""
    names = f"{', '.join(NAMES)}, or a file of your own that ends in .toml (default: course)"
    parser.add_argument("scenario", nargs="?", default="course", help=names)
    parser.add_argument("--runs", type=counted, default=2, help="simulated runs (default: 2)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the first run (default: 1)")


def check(args):
    """Raise what is wrong with the scenario."""
    read_settings(args.scenario)
