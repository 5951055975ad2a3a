"""What `realtime` takes."""

from pathlib import Path

from experiments.scene.reading import read_settings
from experiments.terminal.options import counted, names_of, numbers

__all__ = ["EPILOG", "add_arguments", "budgets_of", "check"]

_SCENARIOS = "van_der_pol,duffing,cart,lorenz"
_BUDGETS = "5,10,20,50"
EPILOG = """\
Times are of a machine and its load. On one that does other things, steps are late that would not have been.
"""


def add_arguments(parser):
    """Add the options of `realtime`."""
    names = f"names from `list`, comma-separated (default: {_SCENARIOS})"
    own = {"type": names_of, "default": names_of(_SCENARIOS), "metavar": "NAME,NAME"}
    parser.add_argument("scenarios", nargs="?", help=names, **own)
    budgets = f"milliseconds a predict and update may take, comma-separated (default: {_BUDGETS})"
    parser.add_argument("--budgets", default=_BUDGETS, help=budgets)
    parser.add_argument("--runs", type=counted, default=3, help="simulated runs (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the runs (default: %(default)s)")
    clock = "processor: what other processes take does not count (default: wall)"
    parser.add_argument("--clock", choices=("wall", "processor"), default="wall", help=clock)
    folder = "folder of the references, which are the benchmark's (default: %(default)s)"
    parser.add_argument("--out", type=Path, default=Path("results/benchmark"), help=folder)


def check(args):
    """Raise what is wrong with scenarios or budgets."""
    for name in args.scenarios:
        read_settings(name)
    budgets_of(args)


def budgets_of(args):
    """Milliseconds that are asked for."""
    return numbers("--budgets", args.budgets, float, _BUDGETS)
