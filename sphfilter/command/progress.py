"""What goes on, in a line on standard error, and records put through filters in parts."""

import logging
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields
from time import perf_counter
from typing import TypeAlias

import numpy as np

from .._types import Floats
from ..core._compiling import PATIENCE
from ..filter.results import FilterResult
from ..filter.sph_filter import SPHFilter

Say: TypeAlias = Callable[[str], None]
_CLEAR = "\r\033[K"  # to the beginning of the line, which is wiped


class _Line(logging.Handler):
    """A line that changes at a terminal; elsewhere its first text alone. Warnings of the library go above."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self._changes, self._said, self._at = sys.stderr.isatty(), False, 0.0

    def say(self, text: str) -> None:
        """Show a text, unless the last one came just now; an empty one takes the line away."""
        if not text:
            self.clear()
        elif self._changes and perf_counter() - self._at > PATIENCE / 5:
            wide = shutil.get_terminal_size().columns - 1
            print(_CLEAR + text[:wide], end="", file=sys.stderr, flush=True)
            self._at = perf_counter()
        elif not self._said:
            print(text, file=sys.stderr)
        self._said = True

    def clear(self) -> None:
        """Take the line away."""
        print(_CLEAR if self._changes else "", end="", file=sys.stderr, flush=True)

    def emit(self, record: logging.LogRecord) -> None:
        """Print a warning on a line of its own."""
        self.clear()
        print(f"sphfilter: {record.getMessage()}", file=sys.stderr)


@contextmanager
def told() -> Iterator[Say]:
    """Yield a function that shows a text in a line, which is taken away in the end."""
    line, logger = _Line(), logging.getLogger("sphfilter")
    logger.addHandler(line)
    try:
        yield lambda text: line.say(text)  # no method: what holds it can be copied, which a handler cannot
    finally:
        logger.removeHandler(line)
        line.clear()


def through(
    flt: SPHFilter, times: Floats, z: Floats, inputs: Mapping[str, Floats], say: Say, name: str = ""
) -> Iterator[FilterResult]:
    """Put a filter through a record, and tell how far it is; yields results of parts of about a second."""
    done, size = 0, 1
    while done < len(times):
        say(f"{name}reading {done + 1} of {len(times)}")
        begin, part = perf_counter(), slice(done, done + size)
        given = {own: values[part] for own, values in inputs.items()}
        yield flt.run(times[part], z[part], inputs=given or None)
        done += size
        rate = size / max(perf_counter() - begin, 1e-9)
        size = max(1, min(2 * size, int(rate * PATIENCE)))


def joined(parts: Sequence[FilterResult]) -> FilterResult:
    """One result of parts that follow each other."""
    names = [field.name for field in fields(FilterResult)]
    return FilterResult(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})
