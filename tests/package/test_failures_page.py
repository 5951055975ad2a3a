"""The page of failures and the library agree: what is on it is said, and what is provoked is on it."""

import re
from pathlib import Path

import pytest
from failure_cases import COMMANDS, SAID, surprised

import sphfilter as sf
from experiments.commands import main
from sphfilter.filter import budget

PAGE = (Path(sf.__file__).parent / "FAILURES.md").read_text(encoding="utf-8")
#: First cells of the rows of tables that begin with a sentence.
SENTENCES = re.findall(r"^\| `(.+?)` \|", PAGE, re.MULTILINE)


def is_in(sentence, text):
    """Does a text hold a sentence of the page, whose gaps are …?"""
    return re.search(".*?".join(map(re.escape, sentence.split("…"))), text, re.DOTALL)


def told(call):
    try:
        return str(call())
    except sf.SphfilterError as problem:
        return str(problem)


def without_time(monkeypatch):
    """What a filter says that has half a second for a step, on a clock that ticks by seconds."""
    ticks = iter(range(10**6))
    with monkeypatch.context() as patched:
        patched.setattr(budget, "clock", lambda: float(next(ticks)))
        return surprised(time_budget=0.5)


def refused(line, capsys):
    """What a command prints that ends with an error."""
    assert main(line.split()) == 1
    text = capsys.readouterr().err
    assert text.count("\n") == 1, text
    return text


@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
def test_the_page_and_the_library_agree(monkeypatch, capsys):
    said = [told(call) for call in SAID] + [refused(line, capsys) for line in COMMANDS]
    said.append(without_time(monkeypatch))
    missing = [text for text in said if not any(is_in(sentence, text) for sentence in SENTENCES)]
    assert not missing, "not on the page"
    silent = [sentence for sentence in SENTENCES if not any(is_in(sentence, text) for text in said)]
    assert not silent, "on the page, but never said"


def test_sentences_are_more_than_gaps():
    assert len(SENTENCES) > 50
    for sentence in SENTENCES:
        assert len(sentence.replace("…", "")) >= 15, sentence
