"""A pool of processes whose work has a time limit: what does not return is killed, the rest goes on.

Compiled code cannot be interrupted from within its process, and executors of the standard library cannot
kill one worker.
"""

import multiprocessing as mp
import os
import signal
import time
from contextlib import contextmanager
from multiprocessing.connection import wait

__all__ = ["Lost", "run_tasks"]

#: Seconds a process may take to start and import.
_START = 300.0


class Lost:
    """Stands for the result of a task whose process was killed after the limit, or died."""

    def __init__(self, sentence, timeout):
        self.sentence, self.timeout = sentence, timeout


def run_tasks(function, tasks, n_jobs, limit, done):
    """Call function(task) for every task, in separate processes, and done(task, result) here.

    Parameters
    ----------
    function : callable, importable by name
    tasks : iterable
        Picklable; taken in order.
    n_jobs : int
    limit : callable
        limit(task) -> seconds after which it is given up.
    done : callable
        Gets `Lost` in place of the result of a task that was given up.
    """
    queue = list(tasks)[::-1]
    with _single_threaded():
        workers = [_Worker(function) for _ in range(min(n_jobs, len(queue)))]
    try:
        while workers:
            for worker in [w for w in workers if w.idle]:
                if queue:
                    worker.give(queue.pop(), limit)
                else:
                    workers.remove(worker)
                    worker.stop()
            wait([w.connection for w in workers], timeout=0.2) if workers else None
            for i, worker in enumerate(workers):
                finished = worker.result()
                if finished is None:
                    continue
                done(*finished)
                if isinstance(finished[1], Lost):
                    with _single_threaded():
                        workers[i] = _Worker(function)
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
    """One process, its pipe, and the task it has."""

    def __init__(self, function):
        context = mp.get_context("spawn")
        self.connection, other = context.Pipe()
        self.process = context.Process(target=_serve, args=(other, function), daemon=True)
        self.process.start()
        other.close()
        self.ready, self.task, self.deadline = False, None, time.monotonic() + _START

    @property
    def idle(self):
        return self.ready and self.task is None

    def give(self, task, limit):
        """Send a task."""
        self.task, self.allowed = task, limit(task)
        self.deadline = time.monotonic() + self.allowed
        self.connection.send(task)

    def result(self):
        """Return (task, result) if there is one, else None; a task past its limit costs the process."""
        try:
            if self.connection.poll():
                message = self.connection.recv()
                if not self.ready:
                    self.ready = True
                    return None
                task, self.task = self.task, None
                return task, message
        except EOFError:
            return self._lost("the process died", False)
        if time.monotonic() > self.deadline and not self.idle:
            return self._lost(f"stopped after {self.allowed:g} s", True)
        return None

    def _lost(self, sentence, timeout):
        if not self.ready:
            raise RuntimeError("a process of the campaign does not start")
        self.stop()
        return self.task, Lost(sentence, timeout)

    def stop(self):
        """End the process."""
        self.process.kill()
        self.process.join()
        self.connection.close()


def _serve(connection, function):
    """Work off what comes, in the process; an interruption is the parent's business."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    connection.send("ready")
    while True:
        try:
            task = connection.recv()
        except EOFError:
            return
        connection.send(function(task))
