"""Processes whose work has a time limit: what does not return is killed, the rest goes on.

Compiled code cannot be interrupted from within its process, and an executor cannot kill one of its workers:
each process has an executor of its own.
"""

import multiprocessing as mp
import os
import signal
import time
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from contextlib import contextmanager, suppress

#: Seconds a process may take to start and import.
_START = 300.0


class Lost:
    """Stands for the result of a task whose process was killed after the limit, or died."""

    def __init__(self, sentence, timeout):
        self.sentence, self.timeout = sentence, timeout


def run_tasks(function, tasks, n_jobs, limit, done):
    """Call function(task) for every task, in order, in separate processes, and done(task, result) here.

    After limit(task) seconds a task is given up, and done gets `Lost` in place of its result. What runs
    elsewhere can be imported by name, tasks can be pickled.
    """
    queue = list(tasks)[::-1]
    workers = [_Worker(function) for _ in range(min(n_jobs, len(queue)))]
    try:
        while workers:
            wait([w.future for w in workers], timeout=0.2, return_when=FIRST_COMPLETED)
            for worker in [w for w in workers if w.finished]:
                result = worker.result()
                if worker.task is not None:
                    done(worker.task, result)
                if not queue:
                    workers.remove(worker)
                    worker.stop()
                elif isinstance(result, Lost):
                    worker.start()
                else:
                    task = queue.pop()
                    worker.give(limit(task), function, task)
    finally:
        for worker in workers:
            worker.stop()


@contextmanager
def _single_threaded():
    """Let processes that start now use one thread: several of them share the machine."""
    names = ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.__setitem__(name, value)


class _Worker:
    """One process, and the task it has."""

    def __init__(self, function):
        self._function = function
        self.start()

    def start(self):
        """Begin a process; the first thing it does is to tell its number."""
        self._pool = ProcessPoolExecutor(1, mp.get_context("spawn"), _prepare, (self._function,))
        self._process = None
        with _single_threaded():
            self.give(_START, os.getpid)
        self.task = None

    def give(self, seconds, function, *task):
        """Let the process call a function, for so many seconds at most."""
        self._allowed, self._deadline = seconds, time.monotonic() + seconds
        self.task, self.future = task[0] if task else None, self._pool.submit(function, *task)

    @property
    def finished(self):
        """Whether there is a result, or will be none."""
        return self.future.done() or time.monotonic() > self._deadline

    def result(self):
        """The result, or `Lost`; a task past its limit costs the process."""
        try:
            found = self.future.result(timeout=0)
        except TimeoutError:
            found = Lost(f"stopped after {self._allowed:g} s", True)
        except Exception:
            found = Lost("the process died", False)
        if isinstance(found, Lost):
            if self._process is None:
                raise RuntimeError("a process of the campaign does not start")
            self.stop()
        self._process = found if self._process is None else self._process
        return found

    def stop(self):
        """End the process."""
        if self._process is not None:
            with suppress(ProcessLookupError):
                os.kill(self._process, signal.SIGTERM)
        self._pool.shutdown(wait=False)


def _prepare(function):
    """Begin a process, which imported `function` for this call; Ctrl-C is the parent's business."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
