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

from .._types import BatchFunction
from ..core._compiling import code_folder
from ..core._jit import BATCH, jit_for
from .compile import batch

__all__ = ["kept"]

_MOST = 3000  # functions of some 30 kB each with their code, below 100 MB of them


def kept(source: str, words: Mapping[str, Any]) -> BatchFunction:
    """Compile a batch function, or load its code if the same source was compiled before.

    Parameters
    ----------
    source : str
        Source of a function ``fill``, printed by this package; nothing that stands in a file is run.
    words : mapping
        The compiled functions of the core that it calls, by name.
    """
    namespace = {"__name__": __name__, **words}  # numba looks for the module when it loads code
    name = sha256(source.encode()).hexdigest()[:32]
    path = _folder() / f"{name}.txt"
    exec(compile(source, path, "exec"), namespace)
    fill = namespace["fill"]
    fill.__name__ += f"_{name}"  # code of two processes is linked by name and a count of each process
    try:
        new = _write(path, source)
        compiled = jit_for(BATCH, fill)
    except (OSError, RuntimeError):  # a full disk, a folder that has gone
        return batch(fill)
    if new:
        with suppress(OSError):  # another process deletes, too
            _forget(path.parent, Path(compiled.stats.cache_path))
    return compiled


@cache
def _folder() -> Path:
    return code_folder() / "models"


def _write(path: Path, source: str) -> bool:
    """Write a file unless it is there, note that it is used now, and tell whether it is new."""
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with path.open("x") as file:
            file.write(source)
    except FileExistsError:
        os.utime(path, ns=(time_ns(), path.stat().st_mtime_ns))  # numba compiles anew what was modified
        return False
    return True


def _forget(texts: Path, code: Path) -> None:
    """Delete the half that was used longest ago, once there are too many."""
    used = {path.stem: path.stat().st_atime_ns for path in texts.glob("*.txt")}
    if len(used) <= _MOST:
        return
    old = set(sorted(used, key=used.__getitem__)[: len(used) // 2])
    for path in (*texts.glob("*.txt"), *code.iterdir()):
        if path.name.partition(".")[0] in old:
            path.unlink(missing_ok=True)
