"""The examples in the docstrings of all public names run, and print what they say."""

import doctest
import io

import pytest

import sphfilter as sf

#: What an example needs not be given for.
_WITHOUT = {"__version__", "consistency"}
PUBLIC = {name: getattr(sf, name) for name in sf.__all__ if name not in _WITHOUT}
PUBLIC |= {f"consistency.{name}": getattr(sf.consistency, name) for name in sf.consistency.__all__}


@pytest.mark.parametrize("name", PUBLIC)
def test_examples(name):
    found = doctest.DocTestFinder(exclude_empty=True).find(PUBLIC[name], name, globs={})
    examples = [test for test in found if test.examples]
    assert examples, f"{name} has no example"
    told = io.StringIO()
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    for test in examples:
        runner.run(test, out=told.write, clear_globs=True)
    assert runner.failures == 0, told.getvalue()


def test_no_example_is_skipped():
    for name, thing in PUBLIC.items():
        assert "doctest: +SKIP" not in (thing.__doc__ or ""), name
