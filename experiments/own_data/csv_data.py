"""Measurements from a CSV file: a column of times, columns of measurements, empty cells where none came."""

import csv
from dataclasses import dataclass

import numpy as np

from sphfilter.errors import ConfigError, nearest

__all__ = ["LEVELS", "Measurements", "read_measurements"]


@dataclass(frozen=True)
class Measurements:
    """Columns of a file.

    Attributes
    ----------
    time_name : str
    names : tuple of str, length k
    times : ndarray, shape (T,)
        Not decreasing.
    z : ndarray, shape (T, k)
        NaN where a cell is empty.
    """

    time_name: str
    names: tuple[str, ...]
    times: np.ndarray
    z: np.ndarray


def read_measurements(path, n_columns, time=None, columns=()):
    """Read times and measurements from a CSV file with a heading.

    Parameters
    ----------
    path : Path
    n_columns : int
        k, what the sensor gives.
    time : str, optional
        Column of times; the first if not given.
    columns : sequence of str, length k, optional
        Columns of measurements; if not given, all others in their order.

    Returns
    -------
    Measurements

    Raises
    ------
    ConfigError
        A file that cannot be read, a column that is not there, a cell that is no number, times that are
        missing or decrease; the sentence names file, line and column.
    """
    heading, rows = _read(path)
    time = time or heading[0]
    others = [name for name in heading if name != time]
    columns = tuple(columns) or tuple(others)
    for name in (time, *columns):
        if name not in heading:
            raise ConfigError(
                f"{path} has no column {name!r}{nearest(name, heading)}; there are {', '.join(heading)}"
            )
    if len(columns) != n_columns:
        raise ConfigError(
            f"the sensor gives {n_columns} values, but {path} has {len(columns)} columns of measurements "
            f"({', '.join(columns)}): name those to use in data.columns of the model file"
        )
    values = {name: _column(path, rows, heading.index(name), name) for name in (time, *columns)}
    times = values[time]
    for i, (line, _) in enumerate(rows):
        if not np.isfinite(times[i]):
            raise ConfigError(f"{path}, line {line}: there is no time in column {time!r}")
        if i and times[i] < times[i - 1]:
            raise ConfigError(
                f"{path}, line {line}: time {times[i]:g} is before {times[i - 1]:g} of the line above; "
                f"sort the file by {time!r}"
            )
    return Measurements(time, columns, times, np.column_stack([values[name] for name in columns]))


def _read(path):
    """Heading, and a list of (line number, cells); empty lines are skipped."""
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            lines = [(reader.line_num, [cell.strip() for cell in row]) for row in reader if any(row)]
    except OSError as problem:
        raise ConfigError(f"cannot read {path}: {problem.strerror}") from None
    except (UnicodeDecodeError, csv.Error) as problem:
        raise ConfigError(f"{path} is not a CSV file in UTF-8: {problem}") from None
    if len(lines) < 2:
        raise ConfigError(f"{path} needs a line of column names and a line of numbers at least")
    (_, heading), *rows = lines
    if len(set(heading)) < len(heading):
        raise ConfigError(f"{path}: the first line names a column twice: {', '.join(heading)}")
    for line, row in rows:
        if len(row) != len(heading):
            raise ConfigError(f"{path}, line {line}: {len(row)} cells under {len(heading)} column names")
    return heading, rows


def _column(path, rows, index, name):
    values = np.full(len(rows), np.nan)
    for i, (line, row) in enumerate(rows):
        if not row[index]:
            continue
        try:
            values[i] = float(row[index])
        except ValueError:
            raise ConfigError(
                f"{path}, line {line}, column {name!r}: {row[index]!r} is not a number; "
                "leave the cell empty where nothing was measured"
            ) from None
        if np.isinf(values[i]):
            raise ConfigError(f"{path}, line {line}, column {name!r}: an infinite value cannot be used")
    return values


#: Probabilities of the central intervals that are scored and drawn.
LEVELS = (0.5, 0.9, 0.95)
