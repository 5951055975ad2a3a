"""What `run sunspots` takes."""

from pathlib import Path

from experiments.own_data.model_settings import read_model
from experiments.scene.names import FILTERS, check_filters
from experiments.terminal.options import names_of

__all__ = ["DATA", "add_arguments", "check"]

DATA = Path(__file__).parents[1] / "data"


def add_arguments(add):
    """Add the options of `run sunspots`."""
    names = ", ".join(name for name in FILTERS if name not in ("kf", "benes"))
    add("--filters", f"comma-separated, of {names}", names_of)
    add("--model", "another model file", Path, DATA / "sunspots.toml")
    add("--fit", "fit the model again first (about ten minutes)", bool)
    add("--seed", "seed of the particle filter", int, 1)
    add("--out", "folder for results", Path, Path("results/sunspots"))


def check(args):
    """Raise what is wrong with model file or filters."""
    read_model(args.model)
    check_filters(args.filters)
