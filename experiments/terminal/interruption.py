"""Ctrl-C: a line and exit code 130, whatever the program is doing when it comes.

Python raises KeyboardInterrupt wherever it happens to be. In an import that is a page of traceback; inside
a function that C code calls it may be printed and forgotten, or crash what called; and some code catches all.
"""

import _thread
import os
import signal
import sys
import threading

__all__ = ["STOPPED", "stoppable"]

#: Exit code of a program that Ctrl-C ended.
STOPPED = 130
#: Seconds after which an interruption is tried again: one that could not be raised, and one that was, should
#: somebody have swallowed it.
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


def stoppable(prepare, work):
    """Call prepare(), then work(), and return what that returns: an exit code.

    An interruption ends the process at once while there is nothing to keep: in `prepare`, and after `work`.
    In `work` it is a KeyboardInterrupt, which comes again until it is answered.
    """
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as shells start what runs in the background
        prepare()
        return work()
    signal.signal(signal.SIGINT, _leave)
    prepare()
    interruptions = _Interruptions()
    sys.unraisablehook = interruptions.unraised
    signal.signal(signal.SIGINT, interruptions.answer)
    try:
        code = work()
    except KeyboardInterrupt as stop:
        code = STOPPED
        if not isinstance(stop.__context__, KeyboardInterrupt):  # else it came while one was answered
            print("Stopped.", file=sys.stderr)
    signal.signal(signal.SIGINT, lambda signum, frame: os._exit(code))
    interruptions.end()
    sys.stdout.flush()
    return code


def _leave(signum, frame):
    os.write(2, b"Stopped.\n")
    os._exit(STOPPED)


class _Interruptions:
    """Raises KeyboardInterrupt where it can be caught, and again if it was not."""

    def __init__(self):
        self._timer, self._again, self._raised = None, False, False

    def answer(self, signum, frame):
        """Handle a signal of the user's, or one that is tried again."""
        again, self._again = self._again, False
        if _called_from_c(frame):
            return self._try_again(_SOON)
        self._try_again(_LATER)
        if again and isinstance(sys.exc_info()[1], KeyboardInterrupt):
            return None  # not swallowed: it is being answered
        self._raised = True
        raise KeyboardInterrupt

    def unraised(self, problem):
        """What Python calls for exceptions that nobody can catch, as those of destructors.

        After an interruption only half-made objects complain, which nobody wants to know.
        """
        if issubclass(problem.exc_type, KeyboardInterrupt):
            self._try_again(_SOON)
        elif not self._raised:
            sys.__unraisablehook__(problem)

    def end(self):
        """Stop trying again."""
        if self._timer is not None:
            self._timer.cancel()

    def _try_again(self, seconds):
        self.end()
        self._timer = threading.Timer(seconds, self._interrupt)
        self._timer.daemon = True
        self._timer.start()

    def _interrupt(self):
        self._again = True
        _thread.interrupt_main()


def _called_from_c(frame):
    while frame is not None:
        module = str(frame.f_globals.get("__name__"))
        if frame.f_code.co_name in _CALLED_FROM_C or module.startswith(_NAMED_TUPLE):
            return True
        frame = frame.f_back
    return False
