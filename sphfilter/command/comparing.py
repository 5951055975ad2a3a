"""Compare model files by the evidence of one record."""

from argparse import ArgumentParser, Namespace
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import ConfigError
from ..files.csv_data import Measurements
from ..files.read_model import read_model
from ..filter.results import FilterResult
from ..filter.sph_filter import SPHFilter
from ..inference.model_comparison import compare_models
from .progress import Say, joined, through


def add_arguments(parser: ArgumentParser) -> None:
    """Add the options of ``compare``."""
    parser.add_argument("--models", type=Path, nargs="+", required=True, help="TOML files")
    parser.add_argument("--data", type=Path, required=True, help="CSV file: a time and measurements a line")


@dataclass
class _Watched:
    """A filter whose run tells how far it is."""

    flt: SPHFilter
    name: str
    say: Say

    def __post_init__(self) -> None:
        self.model, self.measurement = self.flt.model, self.flt.measurement

    def run(self, times: Any, z: Any, inputs: Any = None) -> FilterResult:
        """Put the filter through a record."""
        given = self.flt, np.asarray(times), np.asarray(z, dtype=float), inputs or {}
        return joined(list(through(*given, self.say, f"{self.name}: ")))


def main(args: Namespace, say: Say) -> str:
    """Run the command, and return what it found."""
    files = [read_model(path) for path in args.models]
    stems = [path.stem for path in args.models]
    names = stems if len(set(stems)) == len(stems) else [str(path) for path in args.models]
    data = [file.read(args.data) for file in files]
    for path, other in zip(args.models, data, strict=True):
        if not _same(data[0], other):
            raise ConfigError(
                f"{path} takes other columns of {args.data} than {args.models[0]}: evidence compares models "
                "of the same times, readings and inputs"
            )
    each = zip(names, files, data, strict=True)
    filters: Any = {name: _Watched(file.filter(own), name, say) for name, file, own in each}
    return str(compare_models(filters, data[0].times, data[0].z, data[0].inputs or None))


def _same(one: Measurements, other: Measurements) -> bool:
    """Whether two files have the same record."""
    pairs = [(one.times, other.times), (one.z, other.z)]
    pairs += [(one.inputs[k], other.inputs[k]) for k in one.inputs if k in other.inputs]
    return all(np.array_equal(a, b, equal_nan=True) for a, b in pairs)
