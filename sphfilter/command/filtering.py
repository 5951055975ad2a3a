"""Filter a record: estimates as CSV, a summary, pictures."""

from argparse import ArgumentParser, Namespace
from pathlib import Path
from time import perf_counter

import numpy as np

from ..errors import SphfilterError
from ..files.csv_data import Measurements
from ..files.read_model import ModelOfFile, read_model
from ..files.write import write_estimates
from ..filter.results import FilterResult
from . import pictures
from .options import add_files, place
from .progress import Say, joined, through


def add_arguments(parser: ArgumentParser) -> None:
    """Add the options of ``filter``."""
    add_files(parser)
    formats = Path(__file__).parents[1] / "files" / "formats.txt"
    parser.epilog = formats.read_text(encoding="utf-8")


def main(args: Namespace, say: Say) -> str:
    """Run the command, and return what it found; what is finished is written when it stops."""
    file = read_model(args.model)
    data, folder = file.read(args.data), place(args)
    flt, parts, begin = file.filter(data), list[FilterResult](), perf_counter()
    try:
        for part in through(flt, data.times, data.z, data.inputs, say):
            parts.append(part)
    except (SphfilterError, KeyboardInterrupt) as stop:
        if not parts:
            raise
        done = len(_write(folder, file, data, parts).t)
        raise type(stop)(
            f"{str(stop) or 'stopped'}; estimates of the first {done} of {len(data.times)} lines are in "
            f"{folder / 'estimates.csv'}"
        ) from None
    result = _write(folder, file, data, parts)
    say("drawing")
    told = pictures.listed(
        folder,
        ["estimates.csv"],
        {
            "estimates.png": lambda: pictures.estimates(file, data, result),
            "density.png": lambda: pictures.density(file, data, flt),
        },
    )
    return "\n".join([*_summary(file, data, result, perf_counter() - begin), told])


def _write(folder: Path, file: ModelOfFile, data: Measurements, parts: list[FilterResult]) -> FilterResult:
    result = joined(parts)
    stamps, states = data.stamps[: len(result.t)], file.settings.model.states
    write_estimates(folder / "estimates.csv", result, states, data.heading, stamps)
    return result


def _summary(file: ModelOfFile, data: Measurements, result: FilterResult, seconds: float) -> list[str]:
    """Lines of at most eighty columns on a run."""
    missing = int(np.isnan(data.z).sum())
    lines = [f"{file.path.stem}: {len(data.times)} lines, {missing} values missing, in {seconds:.1f} s"]
    if data.dated and not file.settings.data.time_unit:
        lines.append("Dates are counted in seconds: rates in other units need data.time_unit.")
    evidence, error = float(result.log_evidence.sum()), float(result.total_evidence_error)
    lines.append(f"log-evidence {evidence:.3f} ± {error:.1g} nat")
    said = {"rejected": ~result.accepted, "flagged": result.flagged, "outlying": result.outlying}
    for name, which in said.items():
        first = f", the first at {data.stamps[int(np.argmax(which))]}" if which.any() else ""
        lines.append(f"lines {name}: {int(which.sum())}{first}")
    std = np.sqrt(np.diagonal(result.P, axis1=1, axis2=2))
    lines.append(f"{'state':24}{'last':>14}{'± std':>14}{'lowest':>14}{'highest':>14}")
    for label, x, s in zip(file.labels, result.x.T, std.T, strict=True):
        lines.append(f"{label[:23]:24}{x[-1]:14.5g}{s[-1]:14.3g}{x.min():14.5g}{x.max():14.5g}")
    return lines
