"""The files for whoever carries the project on say what the project is."""

import re
import tomllib
from pathlib import Path

import pytest
import yaml

import sphfilter as sf

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PAGES = "ARCHITECTURE.md", "CONTRIBUTING.md"


def text(name):
    return (ROOT / name).read_text(encoding="utf-8")


def parsed(name):
    return yaml.safe_load(text(name))


def test_the_citation_is_of_this_version():
    cited = parsed("CITATION.cff")
    assert cited["cff-version"] == "1.2.0" and cited["message"]
    assert cited["version"] == sf.__version__
    assert cited["title"] == PROJECT["project"]["name"]
    assert cited["license"] == PROJECT["project"]["license"]
    assert cited["authors"] == PROJECT["project"]["authors"]


def test_references_are_the_readmes_sources():
    sources = " ".join(text("README.md").split("## Sources")[1].split())
    references = parsed("CITATION.cff")["references"]
    assert [one["notes"][:3] for one in references] == ["002", "001", "000"]
    for one in references:
        assert {"type", "title", "authors"} <= one.keys()
        said = sources.split(f"{one['notes'][:3]} is ")[1].split("; 0")[0]
        names = [author["family-names"] for author in one["authors"]]
        told = [str(one[key]) for key in ("year", "volume", "start", "end", "journal") if key in one]
        titles = [one["title"]] if one["type"] == "article" else []
        assert all(word in said for word in [*names, *told, *titles]), (one, said)


@pytest.mark.parametrize("name", PAGES)
def test_pages_name_files_that_are_there(name):
    named = re.findall(r"[\w./-]+/[\w.-]*\w\.(?:py|md|toml|json|yml)\b|\.ci/run", text(name))
    assert len(named) > 10
    for path in named:
        assert (ROOT / path).exists() or (ROOT / "sphfilter" / path).exists(), path


@pytest.mark.parametrize("name", PAGES)
def test_the_readme_leads_to_the_page(name):
    assert f"]({name})" in text("README.md")


def test_marks_on_the_page_are_there():
    known = [line.partition(":")[0] for line in PROJECT["tool"]["pytest"]["ini_options"]["markers"]]
    named = re.findall(r"pytest [^`\n]*-m \"?(?:not )?([a-z]+)", text("CONTRIBUTING.md"))
    assert {"quick", "slow"} <= set(named) <= set(known)
    assert all(f"`{mark}`" in text("CONTRIBUTING.md") for mark in known)


def test_the_floors_on_the_page_are_those_that_are_held():
    (layers,) = (
        contract["layers"]
        for contract in PROJECT["tool"]["importlinter"]["contracts"]
        if contract.get("containers") == ["sphfilter"]
    )
    drawing = text("ARCHITECTURE.md").split("```text\n")[1].split("```")[0].splitlines()
    assert [" ".join(re.split(r"\s{2,}", line.strip())[0].split()) for line in drawing] == layers


def test_the_workflow_runs_what_the_project_supports():
    jobs = parsed(".github/workflows/tests.yml")["jobs"]
    pythons = jobs["quick"]["strategy"]["matrix"]["python"]
    assert PROJECT["project"]["requires-python"] == f">={pythons[0]}"
    tried = {one["which"]: one["python"] for one in jobs["versions"]["strategy"]["matrix"]["include"]}
    tox = PROJECT["tool"]["tox"]
    assert list(tried) == tox["env_list"] and tox["env"]["oldest"]["base_python"] == [tried["oldest"]]
    assert tried["oldest"] == pythons[0]
    commands = {name: [step.get("run", "") for step in job["steps"]] for name, job in jobs.items()}
    assert any("-m quick" in line for line in commands["quick"])
    assert any("tox run -e ${{ matrix.which }}" in line for line in commands["versions"])
    assert ".ci/run" in commands["whole"]


def test_what_is_asked_before_a_commit_is_asked_by_ci():
    ci = text(".ci/run").replace('"$work/venv/bin/python"', "python").replace('"$work/venv/bin/', "")
    (repo,) = parsed(".pre-commit-config.yaml")["repos"]
    entries = [hook["entry"] for hook in repo["hooks"]]
    assert len(entries) == 5
    for entry in entries:
        command, *options = entry.replace(" --force-exclude", "").split()
        assert re.search(rf"{re.escape(command)}\"? {re.escape(' '.join(options))}", ci), entry
