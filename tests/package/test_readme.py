"""The README prints what it says, and names extras that can be installed."""

import io
import re
import tomllib
from contextlib import redirect_stdout
from pathlib import Path

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_an_index_page_has_no_link_that_leads_nowhere():
    """A package index shows the README without the files beside it."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    shown = README
    for change in project["tool"]["hatch"]["metadata"]["hooks"]["fancy-pypi-readme"]["substitutions"]:
        shown = re.sub(change["pattern"], change["replacement"], shown)
    assert shown != README and "`experiments/README.md` in the source" in shown
    assert not re.findall(r"\]\((?!https:)[^)]*\)", shown)


def test_what_the_snippets_print_is_what_stands_beside_them():
    code = "\n".join(re.findall(r"^```py\w*\n(.*?)^```", README, re.MULTILINE | re.DOTALL))
    told = io.StringIO()
    with redirect_stdout(told):
        exec(code.replace("axes = flt.density.plot()", "axes = None"), {})
    lines = told.getvalue().splitlines()
    after = re.findall(r"print\(.*  # (.+)$", code, re.MULTILINE)
    assert len(after) == 2 and lines[-2:] == after
    assert f"# {lines[-4].strip()}, and at last {lines[-3]}" in code


def test_it_is_short():
    assert len(README.splitlines()) <= 120


def test_extras_and_needs_are_those_of_the_project():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    needed, extras = project["dependencies"], project["optional-dependencies"]
    named = set(",".join(re.findall(r"-e \"\.\[([\w,]+)\]\"", README)).split(","))
    assert {"experiments", "test"} <= named <= extras.keys()
    paragraph = next(text for text in README.split("\n\n") if text.startswith("`pip install .`"))
    for line in needed + extras["experiments"]:
        assert re.match(r"[\w-]+", line)[0] in paragraph, line
    (own,) = (line for line in extras["test"] if line.startswith("sphfilter["))
    assert set(re.findall(r"\w+", own)[1:]) == extras.keys() - {"test"}
