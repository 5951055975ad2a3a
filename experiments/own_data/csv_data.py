"""Measurements and inputs from a CSV file: a column of times, columns of what was measured, empty cells where
nothing was, and columns of what was done to the system.
"""

import csv
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime

import numpy as np

from sphfilter.errors import ConfigError, nearest

__all__ = ["Measurements", "columns_of", "read_columns", "read_measurements"]


@dataclass(frozen=True)
class Measurements:
    """Columns of a file."""

    time_name: str
    names: tuple[str, ...]  # length k
    # shape (T,): Not decreasing. Dates are counted from the first, and `time_name` says so.
    times: np.ndarray
    z: np.ndarray  # shape (T, k): NaN where nothing was measured
    # shape (T,): values of inputs over the intervals that end at the times
    inputs: dict[str, np.ndarray] = field(default_factory=dict)
    dated: bool = False  # whether the times were dates


#: What stands in a cell where nothing was measured, in small letters.
_MISSING = frozenset({"", "n/a", "na", "nan", "null", "none", "-"})
#: Seconds of the units in which dates are counted.
_UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0, "a": 31557600.0}
_UNITS |= {"": 1.0, "seconds": 1.0, "minutes": 60.0, "hours": 3600.0, "days": 86400.0, "years": 31557600.0}


def columns_of(path):
    """Names of the columns of a CSV file."""
    return _read(path)[0]


def read_columns(path, names):
    """Read columns of numbers from a CSV file, each shape (K,); None is the first column.

    Raises `ConfigError` as `read_measurements` does; of a cell that is empty, too.
    """
    heading, rows = _read(path)
    names = [heading[0] if name is None else name for name in names]
    _check_names(path, names, heading)
    return [_full_column(path, rows, heading.index(name), name, "a table") for name in names]


def read_measurements(path, n_columns, time=None, columns=(), unit="", inputs=None):
    """Read times, measurements and inputs from a CSV file: commas, semicolons or tabs between the cells.

    A file of semicolons or tabs may have decimal commas. Without a line of names its columns are called
    "column 1" and so on.

    The sensor gives `n_columns` numbers; of several sensors these are a dict by name. `time` is the column of
    times, the first if None; ISO dates such as 2024-05-01 or 2024-05-01T12:30 are counted in `unit` from the
    first one. `columns` are those of the measurements, all others in their order if empty; of several
    sensors, by name: a sensor "gps" has the column "gps" if none is given, or "gps.0", "gps.1" ... of several
    readings. `inputs` are columns by the names of the model's inputs.

    Raises `ConfigError` for a file that cannot be read, a column that is not there, a cell that is no number,
    times that are missing or decrease; the sentence names file, line and column.
    """
    heading, rows = _read(path)
    time, inputs = time or heading[0], inputs or {}
    _check_names(path, [time, *inputs.values()], heading)
    if isinstance(n_columns, dict):
        columns = _columns_of_each(path, n_columns, columns, heading)
    else:
        columns = tuple(columns) or tuple(n for n in heading if n != time and n not in inputs.values())
    _check_names(path, columns, heading)
    if not isinstance(n_columns, dict) and len(columns) != n_columns:
        raise ConfigError(
            f"the sensor gives {n_columns} values, but {path} has {len(columns)} columns of measurements "
            f"({', '.join(columns)}): name those to use in data.columns of the model file"
        )
    dated = _is_date(next((row[heading.index(time)] for _, row in rows), ""))
    times = (_dates if dated else _column)(path, rows, heading.index(time), time)
    if dated:
        first, times = times[0], _counted(path, times, unit)
    values = [_column(path, rows, heading.index(name), name) for name in columns]
    for i, (line, _) in enumerate(rows):
        if not np.isfinite(times[i]):
            raise ConfigError(f"{path}, line {line}: there is no time in column {time!r}")
        if i and times[i] < times[i - 1]:
            raise ConfigError(
                f"{path}, line {line}: time {times[i]:g} is before {times[i - 1]:g} of the line above; "
                f"sort the file by {time!r}"
            )
    title = f"{time}, {unit or 's'} from {first.isoformat(' ')}" if dated else time
    driving = {
        own: _full_column(
            path, rows, heading.index(name), name, "an input, held over the interval that ends at a line,"
        )
        for own, name in inputs.items()
    }
    return Measurements(title, columns, times, np.column_stack(values), driving, dated)


def _check_names(path, names, heading):
    for name in names:
        if name not in heading:
            raise ConfigError(
                f"{path} has no column {name!r}{nearest(name, heading)}; there are {', '.join(heading)}"
            )


def _columns_of_each(path, counts, columns, heading):
    """Columns of several sensors, in their order: those that are given, else those of their names."""
    if not isinstance(columns, dict):
        if columns:
            raise ConfigError(
                f"there are several sensors: give data.columns as a table, {{ {next(iter(counts))} = [...] }}"
            )
        columns = {}
    found = []
    for name, count in counts.items():
        own = columns.get(name) or ((name,) if count == 1 else tuple(f"{name}.{k}" for k in range(count)))
        if len(own) != count:
            raise ConfigError(
                f"sensor {name!r} gives {count} values, but data.columns names {', '.join(own)}"
            )
        if name not in columns and not set(own) <= set(heading):
            raise ConfigError(
                f"{path} has no column {' and '.join(map(repr, own))} for sensor {name!r}; there are "
                f"{', '.join(heading)}: name its columns in data.columns, {{ {name} = [...] }}"
            )
        found += own
    return tuple(found)


def _read(path):
    """Heading, and a list of (line number, cells); empty lines are skipped."""
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            first = file.readline()
            file.seek(0)
            between = next((sign for sign in ";\t" if sign in first), ",")
            reader = csv.reader(file, delimiter=between)
            lines = [(reader.line_num, [cell.strip() for cell in row]) for row in reader if any(row)]
    except OSError as problem:
        raise ConfigError(f"cannot read {path}: {problem.strerror}") from None
    except (UnicodeDecodeError, csv.Error) as problem:
        raise ConfigError(f"{path} is not a CSV file in UTF-8: {problem}") from None
    if between != "," and not any("." in cell for _, row in lines for cell in row):
        lines = [(line, [_with_point(cell) for cell in row]) for line, row in lines]
    if lines and all(_is_value(cell) for cell in lines[0][1]):
        lines.insert(0, (0, [f"column {k}" for k in range(1, len(lines[0][1]) + 1)]))
    if len(lines) < 2:
        raise ConfigError(f"{path} needs a line of column names and a line of numbers at least")
    (_, heading), *rows = lines
    if len(set(heading)) < len(heading):
        raise ConfigError(f"{path}: the first line names a column twice: {', '.join(heading)}")
    for line, row in rows:
        if len(row) != len(heading):
            raise ConfigError(f"{path}, line {line}: {len(row)} cells under {len(heading)} column names")
    return heading, rows


def _with_point(cell):
    """A number with a decimal comma as Python writes it; other text as it is."""
    changed = cell.replace(",", ".")
    return changed if cell.count(",") == 1 and _is_value(changed) else cell


def _is_value(cell):
    """Is it a number, a date, or the word for none: what is no name of a column?"""
    if cell.lower() in _MISSING or _is_date(cell):
        return True
    with suppress(ValueError):
        float(cell)
        return True
    return False


def _is_date(cell):
    with suppress(ValueError):
        return "-" in cell[1:] and bool(datetime.fromisoformat(cell))
    return False


def _dates(path, rows, index, name):
    found = []
    for line, row in rows:
        try:
            found.append(datetime.fromisoformat(row[index]))
        except ValueError:
            raise ConfigError(
                f"{path}, line {line}, column {name!r}: {row[index]!r} is no date as in the first line, "
                "such as 2024-05-01 or 2024-05-01T12:30"
            ) from None
    return found


def _counted(path, dates, unit):
    """Dates as numbers, from the first one, in a unit."""
    if unit not in _UNITS:
        known = ", ".join(filter(None, _UNITS))
        raise ConfigError(f"{path} has dates: data.time_unit must be one of {known}, not {unit!r}")
    if len({date.utcoffset() is None for date in dates}) > 1:
        raise ConfigError(
            f"{path} has dates with a time zone and dates without: give all of them one, or none"
        )
    return np.array([(date - dates[0]).total_seconds() for date in dates]) / _UNITS[unit]


def _column(path, rows, index, name):
    values = np.full(len(rows), np.nan)
    for i, (line, row) in enumerate(rows):
        if row[index].lower() in _MISSING:
            continue
        try:
            values[i] = float(row[index])
        except ValueError:
            raise ConfigError(
                f"{path}, line {line}, column {name!r}: {row[index]!r} is not a number; "
                "leave the cell empty, or write n/a, where nothing was measured; dates of a first column are "
                "written as 2024-05-01 or 2024-05-01T12:30"
            ) from None
        if np.isinf(values[i]):
            raise ConfigError(f"{path}, line {line}, column {name!r}: an infinite value cannot be used")
    return values


def _full_column(path, rows, index, name, what):
    """A column without empty cells; `what` it is, for errors."""
    values = _column(path, rows, index, name)
    for i in np.flatnonzero(np.isnan(values)):
        raise ConfigError(f"{path}, line {rows[i][0]}, column {name!r}: {what} needs a number in every line")
    return values
