"""Results of late, kept by what they were computed from."""

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any


class Recent(OrderedDict[Hashable, Any]):
    """The last `size` results by their keys, which are values, never objects that can change.

    Copies and pickles begin empty.
    """

    def __init__(self, size: int) -> None:
        super().__init__()
        self._size = size

    def result(self, key: Hashable, make: Callable[[], Any]) -> Any:
        """The result of a key, made where it is not known."""
        if key not in self:
            self[key] = make()
            if len(self) > self._size:
                self.popitem(last=False)
        return self[key]

    def __reduce__(self) -> tuple[Any, ...]:
        return Recent, (self._size,)
