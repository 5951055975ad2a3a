"""Compiled code: where it is kept, and a word to the user while it is made.

Numba compiles without a sound, for half a minute where nothing is kept yet. It tells listeners of every
function that it compiles; after a second of them the logger "sphfilter" has a WARNING, once a process.
"""

import gc
import logging
import os
import stat
import tempfile
from pathlib import Path
from time import monotonic

from numba import config, njit
from numba.core import event

_LOGGER = logging.getLogger("sphfilter")
PATIENCE = 1.0  # seconds that pass without a word: longer ones break a train of thought (Nielsen 1993, ch. 5)
_COMPILING = (
    "compiling: a minute or so the first time that a scheme is used, once for all models, and seconds for "
    "each model in text; kept in %s (elsewhere: set NUMBA_CACHE_DIR)"
)
_TEMPORARY = (
    "compiled code is kept in %s, as neither the installation nor the home can be written to; "
    "set NUMBA_CACHE_DIR to a folder that lasts"
)
_PACKAGE = __name__.partition(".")[0]
#: Of LLVM, 0 to 3. Measured by README's example on an empty cache, and the benchmark's scenes: 3 takes 1.2 to
#: 1.3 times as long to compile, and what it has compiled .94 to 1.05 times as long to run; 1 is as 2.
_LEVEL = 2


class _Listener(event.Listener):
    """Adds up the seconds in which functions of the package are compiled, and sets what makes them less.

    LLVM works at a level of the package's own, and no garbage is collected: numba makes millions of objects,
    next to none of them garbage before it is done (a tenth of the time).
    """

    def __init__(self):
        self.depth, self.ours, self.began, self.seconds, self.said = 0, False, 0.0, 0.0, False
        self.usual, self.collects = config.OPT, False

    def on_start(self, event):
        if self.depth == 0:
            self.began, self.ours = monotonic(), _is_ours(event.data["dispatcher"])
            self.usual, self.collects = config.OPT, self.ours and gc.isenabled()
            if self.ours:
                config.OPT = type(config.OPT)(min(config.OPT, _LEVEL))
            if self.collects:
                gc.disable()
        self.depth += 1
        stats = getattr(event.data["dispatcher"], "stats", None)  # which loops of Python's have not
        folder = config.CACHE_DIR or (stats and stats.cache_path)  # None of what is not kept
        late = self.ours and not self.said and self.seconds + monotonic() - self.began > PATIENCE
        if late and folder is not None:
            self.said = True
            _LOGGER.warning(_COMPILING, folder)

    def on_end(self, event):
        if self.depth == 0:  # it began before anybody listened
            return
        self.depth -= 1
        if self.depth == 0 and self.ours:
            config.OPT = self.usual
            self.seconds += monotonic() - self.began
        if self.depth == 0:
            self.collect()

    def collect(self):
        """Let garbage be collected again."""
        if self.collects:
            gc.enable()


def _is_ours(dispatcher):
    return (dispatcher.py_func.__module__ or "").partition(".")[0] == _PACKAGE


def listen():
    """Tell the user where compiling takes long."""
    listener = _Listener()
    event.register("numba:compile", listener)
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=listener.collect)  # what another thread compiles has no end there


def find_folder():
    """Let numba keep compiled code in a temporary folder, where it finds no other that it may write to.

    That is so in a read-only installation without a home. The folder is the user's alone: what is loaded from
    it is run.
    """
    if config.DISABLE_JIT:
        raise ImportError("sphfilter runs compiled code only: unset NUMBA_DISABLE_JIT")
    try:
        njit(cache=True)(_probe)
    except RuntimeError:  # no locator available
        config.CACHE_DIR = str(_own_folder())
        _LOGGER.warning(_TEMPORARY, config.CACHE_DIR)


def code_folder():
    """The folder in which numba keeps the compiled code of this one."""
    return Path(njit(cache=True)(_probe).stats.cache_path)


def _own_folder():
    """A temporary folder that later processes find again; another one where that is somebody else's."""
    user = getattr(os, "getuid", int)()  # zero where there are no such numbers
    folder = Path(tempfile.gettempdir()) / f"sphfilter-{user}"
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    mine = stat.S_ISDIR(found.st_mode) and found.st_uid == user and not found.st_mode & 0o022
    return folder if mine else Path(tempfile.mkdtemp(prefix="sphfilter-"))


def _probe():
    """Nothing."""
