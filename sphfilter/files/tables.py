"""Tables that a TOML file keeps in CSV files beside it."""

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Literal

from ..settings import from_table, settings
from .csv_data import read_columns


@settings
class TableFile:
    """Where a table's columns are."""

    file: str  # relative to the folder of the file that names it
    # columns; the arguments are the first one if `at` is None
    values: str
    at: str | None = None
    kind: Literal["linear", "previous"] = "linear"


def with_tables(tree: dict[str, Any], path: str | PathLike[str]) -> dict[str, Any]:
    """A TOML tree in which the numbers of tables stand in the place of the files that have them.

    Files are looked for beside `path`, that of the tree, which is not changed. Raises `ConfigError` for a CSV
    file that cannot be read, or a column that is not there; the nearest is named.
    """
    for place in _places(tree):
        found = _at(tree, place).items()
        tree = _replaced(tree, place, {name: _read(t, path, ".".join([*place, name])) for name, t in found})
    return tree


def _places(tree: dict[str, Any]) -> list[tuple[str, ...]]:
    """Keys under which there are tables by name."""
    sensors = tree.get("sensors")
    names = sensors if isinstance(sensors, dict) else ()
    places: list[tuple[str, ...]] = [("inputs",), ("model", "tables"), ("sensor", "tables")]
    places += [("sensors", name, "tables") for name in names]
    return [place for place in places if isinstance(_at(tree, place), dict)]


def _at(tree: Any, keys: Sequence[str]) -> Any:
    for key in keys:
        tree = tree.get(key) if isinstance(tree, dict) else None
    return tree


def _replaced(tree: Any, keys: Sequence[str], value: Any) -> Any:
    """A tree with another value at some keys."""
    if not keys:
        return value
    return tree | {keys[0]: _replaced(tree[keys[0]], keys[1:], value)}


def _read(table: Any, path: str | PathLike[str], key: str) -> Any:
    """A table with its numbers; anything else as it is."""
    if not isinstance(table, dict) or not ("file" in table or isinstance(table.get("values"), str)):
        return table
    place = from_table(TableFile, table, f"{path}: {key}")
    at, values = read_columns(Path(path).parent / place.file, (place.at, place.values))
    return {"at": at.tolist(), "values": values.tolist(), "kind": place.kind}
