"""Tables and records as files: rows as CSV, plain values as JSON and TOML."""

import csv
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..filter.results import FilterResult


def write_csv(path: Path, heading: Sequence[str], rows: Iterable[Iterable[Any]]) -> None:
    """Write a line of names and the rows below it; the folder is made if it is not there."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([heading, *rows])


def write_json(path: Path, record: Any) -> None:
    """Write a record of plain values; numbers that are not finite become null."""
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps(_without_nan(record), indent=1, allow_nan=False)
    path.write_text(text, encoding="utf-8")


def _without_nan(tree: Any) -> Any:
    if isinstance(tree, dict):
        return {k: _without_nan(v) for k, v in tree.items()}
    if isinstance(tree, list | tuple):
        return [_without_nan(v) for v in tree]
    return None if isinstance(tree, float) and not np.isfinite(tree) else tree


def mean_and_std(states: Sequence[str], x: Any, P: Any) -> tuple[list[str], list[list[float]]]:
    """Columns of means (T, n) and standard deviations, of covariances (T, n, n): names, and a row a time."""
    std = np.sqrt(np.diagonal(P, axis1=1, axis2=2))
    names = [column for name in states for column in (name, f"{name}_std")]
    return names, np.stack([x, std], axis=2).reshape(len(x), -1).tolist()


def write_estimates(
    path: Path,
    result: FilterResult,
    states: Sequence[str],
    time_name: str = "t",
    stamps: Iterable[float | str] | None = None,
) -> None:
    """Write a line for every time: mean and standard deviation of each state after the update, and more.

    States are names, length n; `time_name` is the heading of the first column, in which the `stamps` stand,
    numbers or dates, or the times of the result.
    """
    names, pairs = mean_and_std(states, result.x, result.P)
    said = "accepted", "error", "flagged", "variance_error", "outlying"
    doubts = zip(*(getattr(result, name).tolist() for name in said), strict=True)
    times = result.t.tolist() if stamps is None else stamps
    each = zip(times, pairs, result.log_evidence.tolist(), doubts, strict=True)
    rows = ([t, *row, evidence, *(+d for d in doubt)] for t, row, evidence, doubt in each)
    write_csv(path, [time_name, *names, "log_evidence", *said], rows)
