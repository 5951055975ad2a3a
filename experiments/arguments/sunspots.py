"""What `sunspots` takes."""

from pathlib import Path

from experiments.own_data.model_settings import read_model
from experiments.scene.names import FILTERS, check_filters
from experiments.terminal.options import names_of

__all__ = ["DATA", "add_arguments", "check"]

DATA = Path(__file__).parents[1] / "data"


def add_arguments(parser):
    """Add the options of `run sunspots`."""
    names = ", ".join(name for name in FILTERS if name not in ("kf", "benes"))
    parser.add_argument("--filters", type=names_of, help=f"comma-separated, of {names}")
    parser.add_argument("--model", type=Path, default=DATA / "sunspots.toml", help="another model file")
    parser.add_argument("--fit", action="store_true", help="fit the model again first (about ten minutes)")
    parser.add_argument(
        "--seed", type=int, default=1, help="seed of the particle filter (default: %(default)s)"
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("results/sunspots"),
        help="folder for results (default: %(default)s)",
    )


def check(args):
    """Raise what is wrong with model file or filters."""
    read_model(args.model)
    check_filters(args.filters)
