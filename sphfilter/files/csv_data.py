"""Measurements and inputs from a CSV file: a column of times, columns of what was measured, empty cells where
nothing was, and columns of what was done to the system.
"""

import csv
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from os import PathLike
from typing import TypeAlias

import numpy as np

from .._types import Floats
from ..errors import ConfigError, nearest

_Path: TypeAlias = str | PathLike[str]
_Cells: TypeAlias = list[tuple[int, str]]  # of a column: numbers of lines, and what stands there
#: Columns of measurements, of several sensors by name.
_Columns: TypeAlias = Sequence[str] | Mapping[str, Sequence[str]]


@dataclass(frozen=True)
class Measurements:
    """Columns of a file."""

    time_name: str
    names: tuple[str, ...]  # length k
    # shape (T,): Not decreasing. Dates are counted from the first, and `time_name` says so.
    times: Floats
    z: Floats  # shape (T, k): NaN where nothing was measured
    # shape (T,): values of inputs over the intervals that end at the times
    inputs: dict[str, Floats] = field(default_factory=dict)
    dates: tuple[datetime, ...] = ()  # length T: the times, where they are dates
    unit: str = ""  # in which dates are counted

    @property
    def dated(self) -> bool:
        """Whether the times are dates."""
        return bool(self.dates)

    @property
    def heading(self) -> str:
        """Name of the column of times, as the file has it."""
        return self.time_name.partition(_COUNTED)[0] if self.dates else self.time_name

    @property
    def stamps(self) -> list[float] | list[str]:
        """The times as the file has them: numbers, or dates as ISO writes them, length T."""
        return [self._iso(date) for date in self.dates] or self.times.tolist()

    def stamp(self, t: float) -> float | str:
        """Another time as the file would have it."""
        if not self.dates:
            return t
        return self._iso(self.dates[0] + timedelta(seconds=t * _UNITS[self.unit]))

    def number(self, text: str) -> float:
        """A time given as text: a number, or a date where the file has dates; raises `ConfigError`."""
        with suppress(ValueError):
            return float(text)
        with suppress(ValueError, TypeError, IndexError):
            return (datetime.fromisoformat(text) - self.dates[0]).total_seconds() / _UNITS[self.unit]
        raise ConfigError(f"{text!r} is no time as {self.heading!r} has them, such as {self.stamps[-1]}")

    def _iso(self, date: datetime) -> str:
        """A date as text, without the time of day where all dates of the file are midnights."""
        days = not any(d.tzinfo or d.hour or d.minute or d.second or d.microsecond for d in self.dates)
        midnight = date == datetime(date.year, date.month, date.day, tzinfo=date.tzinfo)
        return (date.date() if days and midnight else date).isoformat()


#: What stands in a cell where nothing was measured, in small letters.
_MISSING = frozenset({"", "n/a", "na", "nan", "null", "none", "-"})
#: What stands between the name of a column of dates and how they are counted.
_COUNTED = ", "
#: Seconds of the units in which dates are counted.
_UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0, "a": 31557600.0}
_UNITS |= {"": 1.0, "second": 1.0, "minute": 60.0, "hour": 3600.0, "day": 86400.0, "year": 31557600.0}
_UNITS |= {f"{word}s": value for word, value in _UNITS.items() if len(word) > 3}


def columns_of(path: _Path) -> list[str]:
    """Names of the columns of a CSV file."""
    return [*_read(path)]


def read_columns(path: _Path, names: Sequence[str | None]) -> list[Floats]:
    """Read columns of numbers from a CSV file, each shape (K,); None is the first column.

    Raises `ConfigError` as `read_measurements` does; of a cell that is empty, too.
    """
    cells = _read(path)
    own = [next(iter(cells)) if name is None else name for name in names]
    _check_names(path, own, cells)
    return [_full_column(path, name, cells[name], "a table") for name in own]


def read_measurements(
    path: _Path,
    n_columns: int | Mapping[str, int],
    time: str | None = None,
    columns: _Columns = (),
    unit: str = "",
    inputs: Mapping[str, str] | None = None,
) -> Measurements:
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
    cells = _read(path)
    time, inputs = time or next(iter(cells)), inputs or {}
    _check_names(path, [time, *inputs.values()], cells)
    if isinstance(n_columns, Mapping):
        names = _columns_of_each(path, n_columns, columns, cells)
    else:
        names = tuple(columns) or tuple(n for n in cells if n != time and n not in inputs.values())
    _check_names(path, names, cells)
    if not isinstance(n_columns, Mapping) and len(names) != n_columns:
        raise ConfigError(
            f"the sensor gives {n_columns} values, but {path} has {len(names)} columns of measurements "
            f"({', '.join(names)}): name those to use in data.columns of the model file"
        )
    times, dates = _times(path, time, cells[time], unit)
    values = [_column(path, name, cells[name]) for name in names]
    title = f"{time}{_COUNTED}{unit or 's'} from {dates[0].isoformat(' ')}" if dates else time
    held = "an input, held over the interval that ends at a line,"
    driving = {own: _full_column(path, name, cells[name], held) for own, name in inputs.items()}
    return Measurements(title, names, times, np.column_stack(values), driving, dates, unit)


def _times(path: _Path, name: str, cells: _Cells, unit: str) -> tuple[Floats, tuple[datetime, ...]]:
    """The column of times, and its dates, if it has some."""
    dates = _dates(path, name, cells) if _is_date(cells[0][1]) else ()
    times = _counted(path, dates, unit) if dates else _column(path, name, cells)
    for i, (line, _) in enumerate(cells):
        if not np.isfinite(times[i]):
            raise ConfigError(f"{path}, line {line}: there is no time in column {name!r}")
        if i and times[i] < times[i - 1]:
            raise ConfigError(
                f"{path}, line {line}: time {times[i]:g} is before {times[i - 1]:g} of the line above; "
                f"sort the file by {name!r}"
            )
    return times, dates


def _check_names(path: _Path, names: Iterable[str], heading: Iterable[str]) -> None:
    for name in names:
        if name not in heading:
            raise ConfigError(
                f"{path} has no column {name!r}{nearest(name, heading)}; there are {', '.join(heading)}"
            )


def usual_columns(name: str, count: int) -> tuple[str, ...]:
    """Columns of a sensor of so many readings, where a model file does not name them."""
    return (name,) if count == 1 else tuple(f"{name}.{k}" for k in range(count))


def _columns_of_each(
    path: _Path, counts: Mapping[str, int], columns: _Columns, heading: Iterable[str]
) -> tuple[str, ...]:
    """Columns of several sensors, in their order: those that are given, else those of their names."""
    if not isinstance(columns, Mapping):
        if columns:
            raise ConfigError(
                f"there are several sensors: give data.columns as a table, {{ {next(iter(counts))} = [...] }}"
            )
        columns = {}
    found: list[str] = []
    for name, count in counts.items():
        own = columns.get(name) or usual_columns(name, count)
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


def _read(path: _Path) -> dict[str, _Cells]:
    """Columns by name; empty lines are skipped."""
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
    return {name: [(line, row[k]) for line, row in rows] for k, name in enumerate(heading)}


def _with_point(cell: str) -> str:
    """A number with a decimal comma as Python writes it; other text as it is."""
    changed = cell.replace(",", ".")
    return changed if cell.count(",") == 1 and _is_value(changed) else cell


def _is_value(cell: str) -> bool:
    """Is it a number, a date, or the word for none: what is no name of a column?"""
    if cell.lower() in _MISSING or _is_date(cell):
        return True
    with suppress(ValueError):
        float(cell)
        return True
    return False


def _is_date(cell: str) -> bool:
    with suppress(ValueError):
        return "-" in cell[1:] and bool(datetime.fromisoformat(cell))
    return False


def _dates(path: _Path, name: str, cells: _Cells) -> tuple[datetime, ...]:
    found = []
    for line, cell in cells:
        try:
            found.append(datetime.fromisoformat(cell))
        except ValueError:
            raise ConfigError(
                f"{path}, line {line}, column {name!r}: {cell!r} is no date as in the first line, "
                "such as 2024-05-01 or 2024-05-01T12:30"
            ) from None
    return tuple(found)


def _counted(path: _Path, dates: Sequence[datetime], unit: str) -> Floats:
    """Dates as numbers, from the first one, in a unit."""
    if unit not in _UNITS:
        known = ", ".join(filter(None, _UNITS))
        raise ConfigError(f"{path} has dates: data.time_unit must be one of {known}, not {unit!r}")
    if len({date.utcoffset() is None for date in dates}) > 1:
        raise ConfigError(
            f"{path} has dates with a time zone and dates without: give all of them one, or none"
        )
    return np.array([(date - dates[0]).total_seconds() for date in dates]) / _UNITS[unit]


def _column(path: _Path, name: str, cells: _Cells) -> Floats:
    values = np.full(len(cells), np.nan)
    for i, (line, cell) in enumerate(cells):
        if cell.lower() in _MISSING:
            continue
        try:
            values[i] = float(cell)
        except ValueError:
            raise ConfigError(
                f"{path}, line {line}, column {name!r}: {cell!r} is not a number; "
                "leave the cell empty, or write n/a, where nothing was measured; dates of a first column are "
                "written as 2024-05-01 or 2024-05-01T12:30"
            ) from None
        if np.isinf(values[i]):
            raise ConfigError(f"{path}, line {line}, column {name!r}: an infinite value cannot be used")
    return values


def _full_column(path: _Path, name: str, cells: _Cells, what: str) -> Floats:
    """A column without empty cells; `what` it is, for errors."""
    values = _column(path, name, cells)
    for i in np.flatnonzero(np.isnan(values)):
        raise ConfigError(f"{path}, line {cells[i][0]}, column {name!r}: {what} needs a number in every line")
    return values
