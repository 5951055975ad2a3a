"""Build wheel and sdist, and use them as a stranger would: installed, without extras, far from this folder.

    python tests/package/wheel_check.py         # ends with an error at the first thing that is wrong

They go into a fresh virtual environment. The folder they are used from holds a package `experiments` of its
user's, as many do; the README's example and a small campaign have to work beside it.
"""

import os
import re
import subprocess
import sys
import tarfile
import tempfile
import venv
import zipfile
from email import message_from_bytes
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
NEEDED = {"joblib", "numba", "numpy", "pydantic", "scipy", "sympy", "tomli-w"}
#: What comes with extras, as modules.
NOT_NEEDED = "filterpy", "markdown_it", "matplotlib", "rich", "reference_filters"

USE = """
import importlib.util
from dataclasses import dataclass

import numpy as np

import experiments
import sphfilter as sf
import experiments.mine

assert experiments.WHOSE == experiments.mine.WHOSE == "the user's"
for name in {absent}:
    assert importlib.util.find_spec(name) is None, name
assert sf.FilterConfig.from_toml(sf.FilterConfig().to_toml()) == sf.FilterConfig()

model, sensor = sf.LinearSDE([[-1.0]], noise=[[1.0]]), sf.GaussianMeasurement([[1.0]], [[0.1]])

@dataclass
class Decay:
    name: str = "decay"

    def draw(self, rng):
        times, x0, P0 = np.arange(1.0, 4.0), np.zeros(1), np.eye(1)
        truth, z = sf.simulate(model, sensor, rng.normal(size=1), [0.0, *times], rng)
        return sf.Case(times, truth[1:], z[1:], x0, P0)

def sph(case, rng):
    return sf.SPHFilter(model, sensor, case.x0, case.P0)

for _ in range(2):  # the second time from the folder
    campaign = sf.run_campaign(Decay(), {{"sph": sph}}, n_runs=2, seed=1, folder="runs")
    assert not campaign.failures and campaign.results["sph"].x.shape == (2, 3, 1)
print(sf.report(campaign))
"""

SAME = """
from importlib.metadata import version
import experiments, sphfilter
assert experiments.WHOSE == "the user's" and version("sphfilter") == sphfilter.__version__
"""


def main():
    """Check both files; returns nothing, raises where something is wrong."""
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        call(sys.executable, "-m", "build", "--outdir", work, ROOT)
        (wheel,), (sdist,) = work.glob("*.whl"), work.glob("*.tar.gz")
        check_wheel(wheel)
        check_sdist(sdist)
        user = users_folder(work)
        python = new_environment(work / "venv")
        install = python, "-m", "pip", "install", "--quiet"
        call(*install, wheel)
        call(python, "example.py", cwd=user)
        call(python, "use.py", cwd=user)
        check_missing_extra(python)
        call(*install, "--force-reinstall", "--no-deps", sdist)
        call(python, "-c", SAME, cwd=user)


def call(*command, **options):
    """Run a command that has to succeed."""
    subprocess.run([str(part) for part in command], check=True, **options)


def check_wheel(path):
    """The wheel holds the library and its pages, and says what it needs."""
    with zipfile.ZipFile(path) as wheel:
        names = wheel.namelist()
        (metadata,) = (name for name in names if name.endswith(".dist-info/METADATA"))
        said = message_from_bytes(wheel.read(metadata))
    rooms = {name.partition("/")[0] for name in names}
    assert rooms == {"sphfilter", metadata.partition("/")[0]}, rooms
    for page in ("API.md", "CLOUD.md", "RECIPES.md", "FAILURES.md", "EXTENDING.md", "py.typed"):
        assert f"sphfilter/{page}" in names, page
    needed = [line for line in said.get_all("Requires-Dist") if "extra ==" not in line]
    assert {re.match(r"[\w-]+", line)[0] for line in needed} == NEEDED, needed
    text = said.get_payload(decode=True).decode()
    links = [link for link in re.findall(r"\]\(([^)]+)\)", text) if not link.startswith("https://")]
    assert "## What there is" in text and not links, links


def check_sdist(path):
    """The source distribution holds what a clone does, tests and experiments included."""
    with tarfile.open(path) as sdist:
        found = {name.partition("/")[2] for name in sdist.getnames()} - {"PKG-INFO"}
    kept = subprocess.run(["git", "ls-files"], cwd=ROOT, check=True, capture_output=True, text=True)
    assert found == set(kept.stdout.split()), found ^ set(kept.stdout.split())


def users_folder(work):
    """A folder with programs of a user's, and a package that is called as one of ours."""
    user = work / "user"
    (user / "experiments").mkdir(parents=True)
    for name in ("__init__.py", "mine.py"):
        (user / "experiments" / name).write_text('WHOSE = "the user\'s"\n', encoding="utf-8")
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    example = re.search(r"^```python\n(.*?)^```", readme, re.MULTILINE | re.DOTALL)[1]
    (user / "example.py").write_text(example, encoding="utf-8")
    (user / "use.py").write_text(USE.format(absent=NOT_NEEDED), encoding="utf-8")
    return user


def new_environment(folder):
    """The Python of a fresh virtual environment."""
    venv.create(folder, with_pip=True)
    return folder / ("Scripts" if os.name == "nt" else "bin") / "python"


def check_missing_extra(python):
    """A clone whose extra is not installed says so in a line."""
    command = [python, "-m", "experiments", "list"]
    said = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert said.returncode == 1 and said.stdout == "", said
    assert re.fullmatch(r'error: .*: pip install -e "\.\[experiments\]"\n', said.stderr), said.stderr


if __name__ == "__main__":
    main()
