"""What `realtime` takes."""

from pathlib import Path

from experiments.scene.reading import read_settings
from experiments.terminal.options import counted, names_of, numbers

_SCENARIOS = ["van_der_pol", "duffing", "cart", "lorenz"]
_BUDGETS = "5,10,20,50"


def add_arguments(add):
    """Add the options of `realtime`."""
    names = "names from `list`, comma-separated"
    add("scenarios", names, names_of, _SCENARIOS, nargs="?", metavar="NAME,NAME")
    add("--budgets", "milliseconds a predict and update may take, comma-separated", default=_BUDGETS)
    add("--runs", "simulated runs", counted, 3)
    add("--seed", "seed of the runs", int, 1)
    clock = "processor: what other processes take does not count"
    add("--clock", clock, default="wall", choices=("wall", "processor"))
    folder = "folder of the references, which are the benchmark's"
    add("--out", folder, Path, Path("results/benchmark"))


def check(args):
    """Raise what is wrong with scenarios or budgets."""
    for name in args.scenarios:
        read_settings(name)
    budgets_of(args)


def budgets_of(args):
    """Milliseconds that are asked for."""
    return numbers("--budgets", args.budgets, float, _BUDGETS)
