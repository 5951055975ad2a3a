"""Ctrl-C: a line and exit code 130, whatever the program is doing when it comes.

Python raises KeyboardInterrupt wherever it happens to be. Inside an import that is a page of traceback, and
inside a function that C code calls (llvmlite tells numba of compiled code so) it is printed and forgotten.
"""

import _thread
import os
import signal
import sys
import threading
from contextlib import suppress

__all__ = ["STOPPED", "stoppable"]

#: Exit code of a program that Ctrl-C ended.
STOPPED = 130
_AGAIN = 0.02  # seconds after which an interruption that could not be raised is tried again
#: Functions that C or compiled code calls. What is raised in those of llvmlite is lost, with what they were
#: to do; those of numba are expected to return something, and what called them may crash if they do not.
_CALLED_FROM_C = frozenset(
    (
        "_raw_object_cache_notify",
        "_raw_object_cache_getbuffer",
        "_numba_unpickle",
        "_get_wrapper_address",
        "_get_jit_address",
    )
)
_interrupted = threading.Event()


def stoppable(prepare, work):
    """Call prepare(), then work(), and return what that returns: an exit code.

    An interruption ends the process at once while there is nothing to keep: in `prepare`, and after `work`.
    In `work` it is a KeyboardInterrupt.
    """
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as shells start what runs in the background
        prepare()
        return work()
    signal.signal(signal.SIGINT, _leave)
    prepare()
    sys.unraisablehook = _unraised
    signal.signal(signal.SIGINT, _interrupt)
    code = STOPPED
    with suppress(KeyboardInterrupt):  # a second one, while the first was answered
        code = work()
    sys.stdout.flush()
    signal.signal(signal.SIGINT, lambda signum, frame: os._exit(code))
    return code


def _leave(signum, frame):
    os.write(2, b"Stopped.\n")
    os._exit(STOPPED)


def _interrupt(signum, frame):
    """Raise KeyboardInterrupt, but not where it would be lost."""
    while frame is not None:
        if frame.f_code.co_name in _CALLED_FROM_C:
            return _interrupt_soon()
        frame = frame.f_back
    _interrupted.set()
    raise KeyboardInterrupt


def _unraised(problem):
    """What Python calls for exceptions that nobody can catch, as those of destructors.

    After an interruption only half-made objects complain, which nobody wants to know.
    """
    if issubclass(problem.exc_type, KeyboardInterrupt):
        _interrupt_soon()
    elif not _interrupted.is_set():
        sys.__unraisablehook__(problem)


def _interrupt_soon():
    timer = threading.Timer(_AGAIN, _thread.interrupt_main)
    timer.daemon = True
    timer.start()
