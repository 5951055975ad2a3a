"""A second process: it compiles and draws while the first one does something else."""

import logging
import os
import signal
from collections import deque
from contextlib import contextmanager, suppress
from multiprocessing import get_context

import numpy as np

from sphfilter.campaign.one_run import put_through

__all__ = ["Second", "compiled_beside", "take_one"]

#: What a pipe raises whose other end has died.
_GONE = EOFError, OSError


class Second:
    """A process that starts when it is first asked for something, and ends with the `with` block.

    What it is asked for while it is busy is done here, when the answer is wanted; and so is all where there
    is one processor only, and what a process was to do that has died.
    """

    def __init__(self):
        self._process, self._pipe, self._asked = None, None, deque()

    def __enter__(self):
        return self

    def __exit__(self, *problem):
        if self._process is not None:
            self._process.terminate()

    def ask(self, function, *arguments):
        """Let it call a function that can be pickled."""
        given = self._is_free()
        if given:
            with suppress(*_GONE):
                self._pipe.send((function, arguments))
        self._asked.append((given, function, arguments))

    def answer(self):
        """Wait for what it was asked for first, and return what that returned; raises what it raised."""
        given, function, arguments = self._asked.popleft()
        found = None
        if given:
            with suppress(*_GONE):
                found = self._pipe.recv()
        if found is None:
            return function(*arguments)
        result, problem = found
        if problem is not None:
            raise problem
        return result

    def _is_free(self):
        if self._process is None and (os.cpu_count() or 1) > 1:
            context = get_context("spawn")
            self._pipe, theirs = context.Pipe()
            self._process = context.Process(target=_serve, args=(theirs,), daemon=True)
            self._process.start()
            theirs.close()  # or nobody would notice that the process has died
            return True
        return self._process is not None and (not any(row[0] for row in self._asked) or self._pipe.poll())


def _serve(pipe):
    """Do what is asked for, out of the user's sight: Ctrl-C is the parent's business, which ends this."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    logging.getLogger("sphfilter").addHandler(logging.NullHandler())
    with suppress(*_GONE):
        while True:
            function, arguments = pipe.recv()
            try:
                pipe.send((function(*arguments), None))
            except Exception as problem:
                pipe.send((None, problem))


class _Starter(logging.Handler):
    """Asks a second process to compile as soon as the library says that it does: nothing is on disk then."""

    def __init__(self, second, *task):
        super().__init__(logging.WARNING)
        self.second, self.task, self.started = second, task, False

    def emit(self, record):
        if not self.started:
            self.second.ask(*self.task)
            self.started = True

    def wait(self):
        """Wait for what was started; compiled code is on disk then."""
        if self.started:
            self.second.answer()


@contextmanager
def compiled_beside(second, scenario, filters):
    """Compile filters in a second process, if anything has to be compiled; yields what waits for it."""
    starter = _Starter(second, _compile, scenario, filters)
    logger = logging.getLogger("sphfilter")
    logger.addHandler(starter)
    try:
        yield starter.wait
    finally:
        logger.removeHandler(starter)


def take_one(make, case):
    """Let a filter take the first measurement of a case; returns what it raises."""
    try:
        put_through(make(case, np.random.default_rng(0)), case, first=1)
    except Exception as problem:
        return problem
    return None


def _compile(scenario, filters):
    case = scenario.draw(np.random.default_rng(0))
    for make in filters.values():
        take_one(make, case)  # what it raises the parent meets again
