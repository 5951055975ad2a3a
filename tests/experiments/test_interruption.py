"""Ctrl-C ends a program with one line and exit code 130, wherever it comes."""

import signal
import subprocess
import sys
from functools import partial

import pytest

#: A program that a terminal could stop: one that a script starts in the background does not see Ctrl-C.
run = partial(
    subprocess.run,
    capture_output=True,
    text=True,
    timeout=60,
    preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),
)

BEFORE = """
import ctypes, os, signal, sys, time
from experiments.terminal.interruption import stoppable

def interrupt():
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0.001)  # here it is answered

def wait():
    while True:
        time.sleep(0.01)

def until_stopped(work):
    def stopped():
        try:
            work()
        except KeyboardInterrupt:
            print("Stopped.", file=sys.stderr)
            return 130
    sys.exit(stoppable(lambda: None, stopped))
"""
CASES = {
    "while importing": """
def prepare():
    try:
        interrupt()
    except BaseException:  # as an import may say
        pass
    wait()
sys.exit(stoppable(prepare, wait))
""",
    "in a function that C calls": """
def _raw_object_cache_notify():
    interrupt()
    print("done what was to be done")
callback = ctypes.CFUNCTYPE(None)(_raw_object_cache_notify)
def work():
    callback()
    wait()
until_stopped(work)
""",
    "in a destructor": """
class Thing:
    def __del__(self):
        interrupt()
def work():
    Thing()
    wait()
until_stopped(work)
""",
    "while an object is made": """
class Thing:
    def __init__(self):
        interrupt()
        self.part = 1
    def __del__(self):
        self.part
until_stopped(Thing)
""",
    "in what catches everything": """
def work():
    try:
        interrupt()
    except BaseException:
        pass
    wait()
sys.exit(stoppable(lambda: None, work))
""",
    "answered slowly": """
def work():
    try:
        interrupt()
    except KeyboardInterrupt:
        time.sleep(2.5)
        print("done what was to be done")
        print("Stopped.", file=sys.stderr)
        return 130
sys.exit(stoppable(lambda: None, work))
""",
    "twice": """
def work():
    try:
        interrupt()
    except KeyboardInterrupt:
        print("Stopped.", file=sys.stderr)
        interrupt()
sys.exit(stoppable(lambda: None, work))
""",
}


NUMBA = """
import collections, numba
Pair = collections.namedtuple("Pair", "a b")
pair = numba.njit(lambda x: Pair(x, x))
pair(1.0)
def interrupt_there(frame, event, argument):
    if event == "call" and WHERE:
        sys.setprofile(None)
        interrupt()
def work():
    sys.setprofile(interrupt_there)
    print("done what was to be done", pair(2.0))
    wait()
until_stopped(work)
"""
for where, test in {
    "in a function of numba that compiled code calls": "frame.f_code.co_name == '_numba_unpickle'",
    "in a named tuple that compiled code calls": "frame.f_globals.get('__name__') == 'namedtuple_Pair'",
}.items():
    CASES[where] = NUMBA.replace("WHERE", test)


@pytest.mark.parametrize("case", CASES)
def test_one_line_and_an_exit_code(case):
    done = run([sys.executable, "-c", BEFORE + CASES[case]])
    assert (done.returncode, done.stderr) == (130, "Stopped.\n")
    assert ("done what" in done.stdout) is (" calls" in case or "slowly" in case)


def test_other_exceptions_of_destructors_are_told():
    code = """
class Thing:
    def __del__(self):
        raise RuntimeError("no such luck")
sys.exit(stoppable(lambda: None, lambda: Thing() and 3))
"""
    done = run([sys.executable, "-c", BEFORE + code])
    assert done.returncode == 3
    assert "no such luck" in done.stderr


@pytest.mark.parametrize(
    ("program", "while_importing"), [("experiments", "commands"), ("sphfilter", "config")]
)
def test_the_command_line_is_stopped_while_it_starts(program, while_importing):
    done = run([sys.executable, "-c", START, program, f"{program}.{while_importing}"])
    assert (done.returncode, done.stderr) == (130, "Stopped.\n")


def test_a_program_that_imports_the_library_has_its_own_interruption():
    code = "import signal, sphfilter; print(signal.getsignal(signal.SIGINT))"
    assert "default_int_handler" in run([sys.executable, "-c", code]).stdout


START = """
import os, runpy, signal, sys
_, program, module = sys.argv
class Interrupting:
    def find_spec(self, name, path=None, target=None):
        if name == module:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupting())
sys.argv = [program, "list"]
runpy.run_module(program, run_name="__main__", alter_sys=True)
"""
