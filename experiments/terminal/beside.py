"""A second process: it compiles while the first one compiles something else."""

import logging
import os
import signal
from contextlib import contextmanager
from multiprocessing import get_context

import numpy as np

from sphfilter.campaign.one_run import put_through


class _Starter(logging.Handler):
    """Starts a second process as soon as the library says that it compiles: nothing is on disk then."""

    def __init__(self, *filters):
        super().__init__(logging.WARNING)
        self.process = get_context("spawn").Process(target=_compile, args=filters, daemon=True)

    def emit(self, record):
        if self.process.pid is None and (os.cpu_count() or 1) > 1:
            self.process.start()

    def wait(self):
        """Wait for what was started; compiled code is on disk then."""
        if self.process.pid is not None:
            self.process.join()


@contextmanager
def compiled_beside(scenario, filters):
    """Compile filters in a second process, if anything has to be compiled; yields what waits for it.

    What that does not come to, for it died or there is one processor only, is compiled when it is used.
    """
    starter = _Starter(scenario, filters)
    logger = logging.getLogger("sphfilter")
    logger.addHandler(starter)
    try:
        yield starter.wait
    finally:
        logger.removeHandler(starter)
        if starter.process.pid is not None:
            starter.process.terminate()


def take_one(make, case):
    """Let a filter take the first measurement of a case; returns what it raises."""
    try:
        put_through(make(case, np.random.default_rng(0)), case, first=1)
    except Exception as problem:
        return problem
    return None


def _compile(scenario, filters):
    """Compile filters out of the user's sight: Ctrl-C is the parent's business, which ends this."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    logging.getLogger("sphfilter").addHandler(logging.NullHandler())
    case = scenario.draw(np.random.default_rng(0))
    for make in filters.values():
        take_one(make, case)  # what it raises the parent meets again
