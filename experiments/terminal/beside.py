"""Compiling in a second process, while the first one compiles something else."""

import logging
import os
import signal
from contextlib import contextmanager
from multiprocessing import get_context

import numpy as np

__all__ = ["compiled_beside", "take_one"]


class _Starter(logging.Handler):
    """Starts a process as soon as the library says that it compiles: then there is nothing on disk yet."""

    def __init__(self, process):
        super().__init__(logging.WARNING)
        self.process, self.started = process, False

    def emit(self, record):
        if not self.started and (os.cpu_count() or 1) > 1:
            self.process.start()
            self.started = True

    def wait(self):
        """Wait for what was started; compiled code is on disk then."""
        if self.started:
            self.process.join()


@contextmanager
def compiled_beside(scenario, filters):
    """Compile filters in a process of its own, if anything has to be compiled; yields what waits for it."""
    starter = _Starter(get_context("spawn").Process(target=_alone, args=(scenario, filters), daemon=True))
    logger = logging.getLogger("sphfilter")
    logger.addHandler(starter)
    try:
        yield starter.wait
    finally:
        logger.removeHandler(starter)
        if starter.started and starter.process.is_alive():
            starter.process.terminate()


def take_one(make, case):
    """Let a filter take the first measurement of a case; returns what it raises."""
    try:
        make(case, np.random.default_rng(0)).run(case.times[:1], case.z[:1])
    except Exception as problem:
        return problem
    return None


def _alone(scenario, filters):
    """The same in a process that the user does not see: Ctrl-C is its parent's, which ends it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    logging.getLogger("sphfilter").addHandler(logging.NullHandler())
    case = scenario.draw(np.random.default_rng(0))
    for make in filters.values():
        take_one(make, case)  # what it raises the parent meets again
