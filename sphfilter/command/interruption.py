"""Ctrl-C: a line and exit code 130, whatever the program is doing when it comes.

Python raises KeyboardInterrupt wherever it happens to be. In an import that is a page of traceback; inside
a function that C code calls it may be printed and forgotten, or crash what called; and some code catches all.
"""

import _thread
import os
import signal
import sys
import threading
from collections.abc import Callable
from enum import IntEnum
from pathlib import Path
from types import FrameType
from typing import NoReturn

#: Seconds after which an interruption comes again: one that could not be raised, and one that was, should
#: somebody have swallowed it. Measured: of eleven stops with them ten end in a sentence.
_SOON, _LATER = 0.02, 1.0
#: Functions that C or compiled code calls. What is raised in those of llvmlite is lost, with what they were
#: to do; those of numba must return something, or what called them may crash.
_CALLED_FROM_C = frozenset(
    (
        "_raw_object_cache_notify",
        "_raw_object_cache_getbuffer",
        "_numba_unpickle",
        "_get_wrapper_address",
        "_get_jit_address",
    )
)
#: How the name of a named tuple's own module begins: compiled code makes some, and crashes if it gets none.
_NAMED_TUPLE = "namedtuple_"
#: Set when an interruption comes that is not the user's, but one that is tried again.
_AGAIN = threading.Event()


class Exit(IntEnum):
    """Codes of programs that end early, as shells know them."""

    REFUSED = 2  # as of argparse, for wrong words
    STOPPED = 128 + signal.SIGINT


def stoppable(prepare: Callable[[], object], work: Callable[[], int]) -> int:
    """Call prepare(), then work(), and return what that returns: an exit code.

    An interruption ends the process at once while there is nothing to keep: in `prepare`, and after `work`.
    In `work` it is a KeyboardInterrupt, which comes again until it is answered.
    """
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as shells start what runs in the background
        prepare()
        return work()
    signal.signal(signal.SIGINT, _leave)
    prepare()
    signal.signal(signal.SIGINT, _raise)
    try:
        code = work()
    except KeyboardInterrupt as stop:
        code = Exit.STOPPED
        if not isinstance(stop.__context__, KeyboardInterrupt):  # else it came while one was answered
            print("Stopped.", file=sys.stderr)
    signal.signal(signal.SIGINT, lambda signum, frame: os._exit(code))
    sys.stdout.flush()
    return code


def _leave(signum: int, frame: FrameType | None) -> NoReturn:
    os.write(2, b"Stopped.\n")
    os._exit(Exit.STOPPED)


def _raise(signum: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt where it can be caught, and again unless it is being answered."""
    again, hidden = _AGAIN.is_set(), _called_from_c(frame)
    _AGAIN.clear()
    timer = threading.Timer(_SOON if hidden else _LATER, _try_again)
    timer.daemon = True
    timer.start()
    if not hidden and not (again and isinstance(sys.exc_info()[1], KeyboardInterrupt)):
        sys.unraisablehook = lambda problem: None  # only half-made objects complain from here on
        raise KeyboardInterrupt


def _try_again() -> None:
    if signal.getsignal(signal.SIGINT) is _raise:
        _AGAIN.set()
        _thread.interrupt_main()


def _called_from_c(frame: FrameType | None) -> bool:
    while frame is not None:
        module = str(frame.f_globals.get("__name__"))
        if frame.f_code.co_name in _CALLED_FROM_C or module.startswith(_NAMED_TUPLE):
            return True
        frame = frame.f_back
    return False


# The library is imported by its own command, which takes seconds, and there is nothing to keep.
_PROGRAM = sys.argv[0] if sys.argv else ""
_OWN = Path(_PROGRAM).stem == "sphfilter" or (_PROGRAM == "-m" and "sphfilter" in sys.orig_argv)
if _OWN and signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
    signal.signal(signal.SIGINT, _leave)
