"""What a function or object is known by: its code, and the values of all that the code refers to."""

import hashlib
import re
import sys
import sysconfig
from collections.abc import Iterable, Mapping, Set
from functools import cache, partial
from pathlib import Path
from types import CodeType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np

_LIBRARY = Path(__file__).parents[1]
_OF_OTHERS = tuple({sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib")} | {str(_LIBRARY)})
_ADDRESS = re.compile(r" at 0x[0-9a-fA-F]+")


def text_of(thing: Any) -> str:
    """The text of an object that tells about itself; else its name, and a digest of what it is and refers to.

    Modules and code of other packages are known by their names, for their versions are told elsewhere; that
    of a script is the same whatever name it is run by.
    """
    tells = type(thing).__repr__ is not object.__repr__  # type: ignore[comparison-overlap]
    if tells and not isinstance(thing, FunctionType | MethodType | partial):
        return _ADDRESS.sub("", repr(thing))
    name = getattr(thing, "__qualname__", type(thing).__qualname__)
    return f"{name} {_Known().digest(thing)}"


@cache  # what was loaded is what counts, though files may change while a campaign runs
def code_digest() -> str:
    """A digest of the library's own source."""
    return digest_of_files(sorted(_LIBRARY.rglob("*.py")))[:8]


def digest_of_files(files: Iterable[Path]) -> str:
    """Sixteen digits that the contents of files, one after the other, are known by."""
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]


def _foreign(thing: Any) -> bool:
    """Whether a function or class is of Python, of this library, or of another package."""
    if isinstance(thing, FunctionType):
        return thing.__code__.co_filename.startswith(_OF_OTHERS)
    module = sys.modules.get(thing.__module__)
    if thing.__module__ == "__main__" or module is None:
        return False
    return (getattr(module, "__file__", None) or _OF_OTHERS[0]).startswith(_OF_OTHERS)


class _Known:
    """A digest in the making, which goes into everything once."""

    def __init__(self) -> None:
        self._hash = hashlib.sha256()
        self._met: dict[int, tuple[int, Any]] = {}

    def digest(self, thing: Any) -> str:
        """Hexadecimal digest of a thing."""
        self._add(thing)
        return self._hash.hexdigest()[:16]

    def _say(self, *words: object) -> None:
        self._hash.update(repr(words).encode())

    def _add(self, thing: Any) -> None:
        """Go into a thing by its kind."""
        thing = getattr(thing, "py_func", thing)  # of what numba has compiled
        if id(thing) in self._met:
            self._say("again", self._met[id(thing)][0])
            return
        self._met[id(thing)] = len(self._met), thing  # kept: a number of one that is gone may be another's
        if thing is None or isinstance(thing, bool | int | float | complex | str | bytes | Path):
            self._say(thing)
        elif isinstance(thing, np.ndarray) and not thing.dtype.hasobject:
            self._say(thing.dtype.str, thing.shape, np.ascontiguousarray(thing).tobytes())
        elif isinstance(thing, Mapping):
            self._each("mapping", [part for pair in thing.items() for part in pair])
        elif isinstance(thing, Set):
            self._each("set", sorted(thing, key=repr))
        elif isinstance(thing, list | tuple):
            self._each(type(thing).__name__, thing)
        elif isinstance(thing, ModuleType):
            self._say("module", thing.__name__)
        elif isinstance(thing, CodeType):
            self._say(thing.co_code, thing.co_names, thing.co_varnames)
            self._each("constants", thing.co_consts)
        elif isinstance(thing, FunctionType | type):
            self._defined(thing)
        elif isinstance(thing, staticmethod | classmethod):
            self._each(type(thing).__name__, [thing.__func__])
        elif isinstance(thing, property):
            self._each("property", [thing.fget, thing.fset])
        else:
            self._object(thing)

    def _each(self, kind: str, parts: Any) -> None:
        self._say(kind, len(parts))
        for part in parts:
            self._add(part)

    def _defined(self, thing: Any) -> None:
        """A function, with what it refers to, or a class, with all that it defines."""
        self._say(thing.__qualname__)
        if _foreign(thing):
            self._say(thing.__module__)
        elif isinstance(thing, type):
            own = {k: part for k, part in vars(thing).items() if callable(part) or not k.startswith("__")}
            self._each("class", [*thing.__bases__, own])
        else:
            cells = [cell.cell_contents for cell in thing.__closure__ or ()]
            self._each("function", [thing.__code__, thing.__defaults__, thing.__kwdefaults__, cells])
            known = thing.__globals__
            self._add({name: known[name] for name in _names(thing.__code__) if name in known})

    def _object(self, thing: Any) -> None:
        """An object by its class and what it would be copied from; else by its text."""
        self._add(type(thing))
        try:
            self._add(thing.__reduce_ex__(2)[:3])
        except Exception:  # what cannot be copied, whatever it says
            self._say(_ADDRESS.sub("", repr(thing)))


def _names(code: CodeType) -> list[str]:
    """Names that a code and the codes within it use, in their order."""
    within = [name for part in code.co_consts if isinstance(part, CodeType) for name in _names(part)]
    return list(dict.fromkeys([*code.co_names, *within]))
