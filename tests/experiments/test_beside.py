"""A second process: what it is asked for it does, or else it is done here."""

import os
import time

import pytest

from experiments.terminal import beside
from sphfilter.errors import ConfigError


def fails(text):
    raise ConfigError(text)


def test_answers_come_from_elsewhere_one_after_the_other():
    with beside.Second() as second:
        second.ask(os.getpid)
        assert second.answer() != os.getpid()
        second.ask(fails, "no such luck")
        with pytest.raises(ConfigError, match="no such luck"):
            second.answer()


def test_what_a_busy_process_is_asked_is_done_here():
    with beside.Second() as second:
        second.ask(time.sleep, 0.5)
        second.ask(os.getpid)
        assert second.answer() is None
        assert second.answer() == os.getpid()


def test_without_a_second_processor_the_answer_is_found_here(monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    with beside.Second() as second:
        second.ask(os.getpid)
        assert second.answer() == os.getpid()


def test_what_a_dead_process_was_asked_is_done_here():
    with beside.Second() as second:
        second.ask(_die_elsewhere, os.getpid())
        second.ask(divmod, 7, 2)
        assert second.answer() == "alive"
        assert second.answer() == (3, 1)


def _die_elsewhere(parent):
    if os.getpid() != parent:
        os._exit(1)
    return "alive"
