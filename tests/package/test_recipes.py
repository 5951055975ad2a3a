"""Every recipe runs as it stands on its page, is short, and prints what is written beside it."""

import io
import re
from contextlib import redirect_stdout
from pathlib import Path

import pytest

import sphfilter as sf

PAGE = (Path(sf.__file__).parent / "RECIPES.md").read_text(encoding="utf-8")
HEAD, *SECTIONS = PAGE.split("\n## ")
BEGIN, *_ = re.findall(r"^```python\n(.*?)^```", HEAD, re.MULTILINE | re.DOTALL)
RECIPES = {
    f"{section.splitlines()[0]} {k}": code
    for section in SECTIONS
    for k, code in enumerate(re.findall(r"^```python\n(.*?)^```", section, re.MULTILINE | re.DOTALL))
}
LONGEST = 12  # lines


@pytest.mark.parametrize("name", RECIPES)
def test_a_recipe(name):
    code, told = RECIPES[name], io.StringIO()
    with redirect_stdout(told):
        exec(BEGIN + code, {"__name__": "recipe"})
    written = re.findall(r"^print\(.*\)  # (.+)$", code, re.MULTILINE)
    assert written and told.getvalue().splitlines() == written


def test_recipes_are_short():
    assert len(RECIPES) >= len(SECTIONS) > 10
    for name, code in RECIPES.items():
        assert len([line for line in code.splitlines() if line]) <= LONGEST, name
        assert max(map(len, code.splitlines())) <= 110, name
