"""The page of public names has all of them, in the words of their docstrings as they are today."""

import pytest

pytest.importorskip("stonesoup")

import api_page

import sphfilter as sf


def test_every_name_is_under_one_question():
    named = [name for names in api_page.QUESTIONS.values() for name in names.split()]
    assert sorted(named) == sorted(sf.__all__)


def test_the_page_is_current():
    said = "the page is not that of today's docstrings: python tests/package/api_page.py"
    assert api_page.PAGE.read_text(encoding="utf-8") == api_page.page(), said


def test_main_classes_are_told_whole():
    text = api_page.page()
    for kind in (sf.SPHFilter, sf.ParticleDensity, sf.SDE, sf.Sensors, sf.JumpMarkovFilter):
        block = text.split(f"- [`{kind.__name__}`]")[1].split("\n- ")[0]
        public = [name for name in dir(kind) if not name.startswith("_")]
        own = [name for name in public if api_page.is_member(getattr(kind, name))]
        assert len(own) > 10 and all(f"`.{name}`: " in block for name in own), kind
