"""Results told on one line."""

from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

_SHOWN = 9  # numbers of an array that stand on a line


def in_a_line(thing: Any) -> str:
    """Return what a dataclass or named tuple holds, on one line: of large arrays their shapes only."""
    names = [f.name for f in fields(thing) if f.repr] if is_dataclass(thing) else thing._fields
    return f"{type(thing).__name__}({', '.join(f'{name}={_brief(getattr(thing, name))}' for name in names)})"


def _brief(value: Any) -> str:
    if not isinstance(value, np.ndarray):
        return " ".join(repr(value).split())
    return repr(value.tolist()) if value.size <= _SHOWN else f"array of shape {value.shape}"
