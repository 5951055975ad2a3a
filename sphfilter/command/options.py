"""Options that commands share, and lists in options: names, numbers by name, bounds."""

from argparse import ArgumentParser
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from ..errors import ConfigError

Value = TypeVar("Value")


def add_files(parser: ArgumentParser) -> None:
    """Add what commands take that filter a record."""
    parser.add_argument("--model", type=Path, required=True, help="TOML file with model, sensor and start")
    parser.add_argument("--data", type=Path, required=True, help="CSV file: a time and measurements a line")
    parser.add_argument("--out", type=Path, help="folder for results (default: results/NAME of the data)")


def place(args: Any) -> Path:
    """The folder for results."""
    return args.out or Path("results") / args.data.stem


def number(option: str, text: str) -> float:
    """A number; raises `ConfigError`."""
    try:
        return float(text)
    except ValueError:
        raise ConfigError(f"{option} takes numbers, not {text!r}") from None


def numbers(option: str, text: str, between: str = ",") -> list[float]:
    """Numbers from a list; raises `ConfigError`."""
    return [number(option, part) for part in text.split(between)]


def bound(option: str, text: str) -> tuple[float | None, float | None]:
    """Lowest and highest value, "0:2", either of which may be left out; raises `ConfigError`."""
    low, colon, high = text.partition(":")
    if not colon:
        raise ConfigError(f"{option} takes bounds such as a=0:2 or a=0:, not {text!r}")
    return tuple(number(option, end) if end.strip() else None for end in (low, high))  # type: ignore


def by_name(option: str, text: str, kind: Callable[[str, str], Value]) -> dict[str, Value]:
    """Values by name, from a list "a=...,b=..."; empty for an empty text; raises `ConfigError`."""
    found = {}
    for part in filter(None, text.split(",")):
        name, equals, value = part.partition("=")
        if not equals:
            raise ConfigError(f"{option} takes NAME=VALUE, comma-separated, not {part!r}")
        found[name.strip()] = kind(option, value)
    return found
