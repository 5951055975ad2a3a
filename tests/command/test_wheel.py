"""The command as a user has it: a wheel in a fresh environment, without extras, far from the clone."""

import subprocess
import sys
import venv
from pathlib import Path

import pytest
from test_console import DATA, MODEL

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def command(tmp_path_factory):
    """Path of the command in the environment."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "build", "--wheel", "--outdir", str(folder), str(ROOT)]
    subprocess.run(build, check=True, capture_output=True)
    venv.create(folder / "venv", with_pip=True)
    (wheel,) = folder.glob("*.whl")
    install = [str(folder / "venv" / "bin" / "python"), "-m", "pip", "install", "--quiet", str(wheel)]
    subprocess.run(install, check=True)
    return folder / "venv" / "bin" / "sphfilter"


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="folders of environments are others there")
def test_a_stranger_filters_fits_and_forecasts(command, tmp_path, monkeypatch):
    monkeypatch.delenv("PYTHONPATH", raising=False)
    (tmp_path / "tank.toml").write_text(MODEL, encoding="utf-8")
    (tmp_path / "tank.csv").write_text(DATA, encoding="utf-8")

    def told(*words):
        done = subprocess.run([command, *words], cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout

    files = "--model", "tank.toml", "--data", "tank.csv", "--out", "out"
    assert "pictures need matplotlib" in told("filter", *files)
    assert "\n2024-03-02," in (tmp_path / "out" / "estimates.csv").read_text(encoding="utf-8")
    told("forecast", *files, "--until", "2024-03-06", "--steps", "2")
    assert "\n2024-03-06," in (tmp_path / "out" / "forecast.csv").read_text(encoding="utf-8")
    told("simulate", "--model", "tank.toml", "--times", "0:30:0.5", "--out", "sim.csv")
    fitted = told("fit", "--model", "tank.toml", "--data", "sim.csv", "--parameters", "a", "--out", "fit")
    assert "a = " in fitted and (tmp_path / "fit" / "fitted.toml").exists()
    assert "[model]" in told("filter", "--help")
    assert "matplotlib    not installed (optional)" in told("doctor")
