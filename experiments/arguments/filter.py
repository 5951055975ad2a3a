"""What `filter` takes."""

from pathlib import Path

from experiments.own_data.model_settings import read_model
from experiments.scene.names import FILTERS, check_filters
from experiments.terminal.options import names_of
from sphfilter.files.model_file import read_data


def add_arguments(add):
    """Add the options of `filter`."""
    add("--model", "TOML file with model, sensor and start", Path, required=True)
    add("--data", "CSV file: a time and measurements a line", Path, required=True)
    add("--filters", f"comma-separated, of {', '.join(FILTERS)}", names_of)
    add("--seed", "seed of the particle filter", int, 1)
    add("--out", "folder for results", Path, None, "results/NAME of the data")


def check(args):
    """Raise what is wrong with one of the files, or with the filters."""
    settings = read_model(args.model)
    read_data(settings, args.data)
    check_filters(args.filters)
