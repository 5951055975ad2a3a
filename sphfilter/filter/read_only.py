"""What a filter has found, as an array that says why it cannot be changed."""

from typing import Any

import numpy as np

from .._types import Floats
from ..errors import ModelError

_READ = "what a density filter has found is read-only; make a new filter with x0 and P0"


class _Found(np.ndarray):
    """A read-only array: ``flt.P *= 50`` would change a copy of what the density says, and nothing else.

    What is computed from it is a plain array, and its copies may be changed.
    """

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        """Compute with plain arrays."""
        into = options.get("out", ())
        if any(isinstance(array, _Found) and not array.flags.writeable for array in into):
            raise ModelError(_READ)
        if into:
            options["out"] = tuple(_plain(array) for array in into)
        result = getattr(ufunc, method)(*map(_plain, inputs), **options)
        return into[0] if len(into) == 1 else result

    def __setitem__(self, key: Any, value: Any) -> None:
        if not self.flags.writeable:
            raise ModelError(_READ)
        super().__setitem__(key, value)

    def __repr__(self) -> str:
        return repr(_plain(self))


def _plain(array: Any) -> Any:
    return array.view(np.ndarray) if isinstance(array, _Found) else array


def read_only(array: Floats) -> Floats:
    """A new array of the same numbers, to be read."""
    array = np.array(array).view(_Found)
    array.flags.writeable = False
    return array
