"""Compiled code of models in text, kept on disk: a process that prints the same code again loads it.

Numba keeps the code of functions that stand in files. So what is printed is written to a file, which is named
by what it says, below the compiled code of the library.
"""

import os
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from time import time_ns
from typing import Any

from numba import njit

from .._types import BatchFunction
from ..core._compiling import code_folder
from ..core._jit import BATCH, fingerprint, jit_for
from .compile import batch

_MOST = 3000  # functions of some 30 kB each with their code: 3000 · 30 kB = 90 MB


def kept(source: str, words: Mapping[str, Any]) -> BatchFunction:
    """Compile a batch function, or load its code if the same source was compiled before.

    The source is that of a function ``fill``, printed by this package; nothing that stands in a file is run.
    `words` are the compiled functions of the core that it calls, by name.
    """
    name = sha256((fingerprint(__name__.partition(".")[0]) + source).encode()).hexdigest()[:32]
    try:
        path = _folder() / f"{name}.txt"
        new, fill = _write(path, source), _function(source, name, words, path)
    except (OSError, RuntimeError):  # a full disk, a folder that has gone
        return batch(_function(source, name, words, Path(name)))
    try:
        compiled = jit_for(BATCH, fill)
    except Exception:  # code that was not written to its end cannot be loaded, or the disk is full now
        _delete({name}, _code_folder(fill))
        return batch(fill)
    if new:
        _forget(path.parent, _code_folder(fill))
    return compiled


def _function(source: str, name: str, words: Mapping[str, Any], path: Path) -> Any:
    """The function of a source, under a name of its own: addresses are looked up by name."""
    namespace = {"__name__": __name__, **words}  # numba looks for the module when it loads code
    exec(compile(source, path, "exec"), namespace)
    namespace["fill"].__name__ += f"_{name}"
    return namespace["fill"]


@cache
def _folder() -> Path:
    return code_folder() / "models"


def _code_folder(fill: Any) -> Path:
    return Path(njit(cache=True)(fill).stats.cache_path)


def _write(path: Path, source: str) -> bool:
    """Write a file unless it is there, note that it is used now, and tell whether it is new."""
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with path.open("x") as file:
            file.write(source)
    except FileExistsError:
        with suppress(PermissionError):  # of another user's
            os.utime(path, ns=(time_ns(), path.stat().st_mtime_ns))  # numba compiles anew what was modified
        return False
    return True


def _forget(texts: Path, code: Path) -> None:
    """Delete the half that was used longest ago, once there are too many."""
    with suppress(OSError):  # another process deletes, too
        used = {path.stem: path.stat().st_atime_ns for path in texts.glob("*.txt")}
        if len(used) > _MOST:
            _delete(set(sorted(used, key=used.__getitem__)[: len(used) // 2]), texts, code)


def _delete(names: set[str], *folders: Path) -> None:
    for folder in folders:
        for path in folder.glob("*"):
            if path.name.partition(".")[0] in names:
                path.unlink(missing_ok=True)
