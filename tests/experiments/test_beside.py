"""A second process compiles when the library says that it does; what becomes of it costs nothing."""

import logging
import os
from pathlib import Path

from experiments.terminal import beside


class Scene:
    """Tells which process draws from it, in a file; or ends that process."""

    def __init__(self, path, dies=False):
        self.path, self.dies, self.parent = path, dies, os.getpid()

    def draw(self, rng):
        if self.dies and os.getpid() != self.parent:
            os._exit(1)
        Path(self.path).write_text(str(os.getpid()))


def compiled(scene, says=True):
    with beside.compiled_beside(scene, {}) as wait:
        if says:
            logging.getLogger("sphfilter").warning("compiling")
            logging.getLogger("sphfilter").warning("and again")
        wait()


def test_what_is_compiled_beside_is_compiled_elsewhere(tmp_path):
    compiled(Scene(tmp_path / "who"))
    assert int((tmp_path / "who").read_text()) != os.getpid()
    assert not any(isinstance(h, beside._Starter) for h in logging.getLogger("sphfilter").handlers)


def test_where_nothing_has_to_be_compiled_nothing_is_started(tmp_path):
    compiled(Scene(tmp_path / "who"), says=False)
    assert not (tmp_path / "who").exists()


def test_without_a_second_processor_nothing_is_started(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    compiled(Scene(tmp_path / "who"))
    assert not (tmp_path / "who").exists()


def test_a_process_that_dies_is_not_waited_for(tmp_path):
    compiled(Scene(tmp_path / "who", dies=True))
    assert not (tmp_path / "who").exists()
