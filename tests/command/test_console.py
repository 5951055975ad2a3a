"""`sphfilter`: every verb on a small record, dates kept, what is wrong in a sentence, stopping."""

import json
import os
import signal
import subprocess
import sys
import time
import tomllib
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from cases.tank import TANK, textbook
from csv_rows import csv_rows

import sphfilter as sf
from sphfilter.command import doctor, filtering, fitting, progress
from sphfilter.command.main import main
from sphfilter.errors import PropagationError

MODEL = (
    TANK
    + """
[data]
time_unit = "d"
"""
)
DAYS = ["2024-02-27", "2024-02-28", "2024-03-01", "2024-03-02"]
DATA = "day,level\n" + "".join(
    f"{day},{z}\n" for day, z in zip(DAYS, ("1.2", "", "-0.4", "0.1"), strict=True)
)


@pytest.fixture
def files(tmp_path, monkeypatch):
    """Options that name the files; results go to the folder of the test."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tank.toml").write_text(MODEL, encoding="utf-8")
    (tmp_path / "tank.csv").write_text(DATA, encoding="utf-8")
    return ["--model", "tank.toml", "--data", "tank.csv"]


def fitted():
    return json.loads(Path("fit.json").read_text(encoding="utf-8"))


def exact():
    """Means and standard deviations (4, 2), days from the first."""
    return textbook([0, 1, 3, 4], (1.2, None, -0.4, 0.1))[:, 1:3]


def test_filter_keeps_dates_and_is_exact(files, tmp_path, capsys):
    assert main(["filter", *files]) == 0
    found = csv_rows("results/tank/estimates.csv")
    assert [row["day"] for row in found] == DAYS
    told = [(float(row["x"]), float(row["x_std"])) for row in found]
    np.testing.assert_allclose(told, exact(), rtol=1e-9)
    said = capsys.readouterr()
    assert "4 lines, 1 values missing" in said.out and "level (m)" in said.out
    assert max(map(len, said.out.splitlines())) <= 80
    assert [line for line in said.err.splitlines() if "compiling" not in line] == ["sphfilter filter"]
    assert all(
        (tmp_path / "results/tank" / name).stat().st_size > 5000 for name in ("estimates.png", "density.png")
    )


def test_without_matplotlib_it_says_so(files, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)
    assert main(["filter", *files]) == 0
    assert "pictures need matplotlib: pip install sphfilter[plots]" in capsys.readouterr().out


def test_forecast_keeps_dates(files, tmp_path):
    ahead = ["--until", "2024-03-06", "--steps", "2", "--quantiles", ".1,.9", "--out", "out"]
    assert main(["forecast", *files, *ahead]) == 0
    found = csv_rows("out/forecast.csv")
    assert [row["day"] for row in found] == ["2024-03-04", "2024-03-06"]
    m, s = exact()[-1]
    mean, std = m * np.exp(-1.6), np.sqrt(s**2 * np.exp(-3.2) + 0.625 * (1 - np.exp(-3.2)))
    told = [float(found[-1][name]) for name in ("x", "x_std", "x_q0.1", "x_q0.9")]
    np.testing.assert_allclose(told, [mean, std, mean - 1.2816 * std, mean + 1.2816 * std], atol=2e-4)
    assert (tmp_path / "out/forecast.png").stat().st_size > 5000


def test_simulate_fit_compare(files, capsys):
    assert main(["simulate", "--model", "tank.toml", "--times", "0:30:0.5", "--out", "sim.csv"]) == 0
    assert len(csv_rows("sim.csv")) == len(csv_rows("sim_truth.csv")) == 61
    data = ["--data", "sim.csv"]
    assert (
        main(["fit", "--model", "tank.toml", *data, "--parameters", "a", "--bounds", "a=0:", "--out", "."])
        == 0
    )
    fit, tree = fitted(), tomllib.loads(Path("fitted.toml").read_text(encoding="utf-8"))
    assert abs(fit["estimate"]["a"] - 0.4) < 3 * fit["standard_error"]["a"] < 1.5
    assert tree["model"]["parameters"] == fit["estimate"] and sf.read_model("fitted.toml").x0 == [1.0]
    assert main(["compare", "--models", "tank.toml", "fitted.toml", *data]) == 0
    said = capsys.readouterr().out
    assert said.index("fitted  ") < said.index("tank  ") and "the best" in said


def test_doctor(capsys, monkeypatch):
    assert main(["doctor"]) == 0
    said = capsys.readouterr().out
    assert f"sphfilter     {sf.__version__}" in said and "numba " in said and "compiled code in " in said
    assert main(["doctor"]) == 0 and "all was compiled before" in capsys.readouterr().out
    monkeypatch.setattr(doctor.os, "access", lambda *args: False)
    assert main(["doctor"]) == 2 and "set NUMBA_CACHE_DIR" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("old", "new", "line", "sentence"),
    [
        ("[sensor]", "[sensr]", ["filter"], "tank.toml: unknown key sensr (did you mean 'sensor'?)"),
        ("mean = [1.0]", "mean = [1.0, 2.0]", ["filter"], "start.mean 2 values"),
        ("time_unit", "time_units", ["filter"], "unknown key data.time_units (did you mean 'time_unit'?)"),
        ('"d"', '"fortnight"', ["filter"], "data.time_unit must be one of s, min"),
        ("-a*x", "-b*x", ["filter"], "unknown name 'b'"),
        ("", "", ["fit", "--parameters", "b"], "'b' is none of the parameters"),
        ("", "", ["fit", "--parameters", "a", "--bounds", "a=1"], "bounds such as a=0:2"),
        ("", "", ["fit", "--parameters", "a", "--guess", "1"], "--guess takes NAME=VALUE"),
        ("", "", ["forecast", "--until", "soon"], "'soon' is no time as 'day' has them, such as 2024-03-02"),
        ("", "", ["forecast", "--until", "2024-03-01"], "--until must be after the last time, 2024-03-02"),
    ],
)
def test_what_is_wrong_is_one_sentence(files, old, new, line, sentence, tmp_path, capsys):
    (tmp_path / "tank.toml").write_text(MODEL.replace(old, new) if old else MODEL, encoding="utf-8")
    assert main([line[0], *files, *line[1:]]) == 2
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 2 and said[1].startswith("sphfilter: ") and sentence in said[1]
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize(("stop", "code"), [(KeyboardInterrupt(), 130), (PropagationError("no luck"), 2)])
def test_what_is_finished_is_written(files, stop, code, monkeypatch, capsys):
    def half(*args):
        for k, part in enumerate(progress.through(*args)):
            if k == 2:
                raise stop
            yield part

    monkeypatch.setattr(filtering, "through", half)
    assert main(["filter", *files]) == code
    assert 1 < len(csv_rows("results/tank/estimates.csv")) < 4
    assert f"sphfilter: {str(stop) or 'stopped'}; estimates of the first" in capsys.readouterr().err


def test_a_stopped_fit_keeps_the_best(files, monkeypatch, capsys):
    def stopped(*args, report, **options):
        for run, (a, value) in enumerate(((0.1, -5.0), (0.2, -4.0), (0.3, -6.0)), start=1):
            report(run, {"a": a}, value)
        raise KeyboardInterrupt

    monkeypatch.setattr(fitting, "fit_parameters", stopped)
    assert main(["fit", *files, "--parameters", "a", "--out", "."]) == 130
    assert fitted()["estimate"] == {"a": 0.2} and sf.read_model("fitted.toml")
    assert "stopped after 3 runs" in capsys.readouterr().err


def test_parts_of_a_record_are_the_record(files):
    file = sf.read_model("tank.toml")
    data = file.read("tank.csv")
    whole = file.filter(data).run(data.times, data.z)
    parts = list(progress.through(file.filter(data), data.times, data.z, {}, lambda text: None))
    assert len(parts) > 1
    np.testing.assert_allclose(progress.joined(parts).P, whole.P, rtol=1e-12)


def test_a_terminal_has_a_line_that_changes(capsys, monkeypatch):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    with progress.told() as say:
        say("one")
        say("two, at once: too soon to be read")
    assert capsys.readouterr().err == "\r\033[Kone\r\033[K"


def test_help_has_the_files(capsys):
    with pytest.raises(SystemExit):
        main(["filter", "--help"])
    assert "[model]" in capsys.readouterr().out


def test_a_folder_that_cannot_be_made(files, capsys):
    assert main(["filter", *files, "--out", "tank.csv/out"]) == 2
    assert "sphfilter: cannot write tank.csv/out: Not a directory" in capsys.readouterr().err


@pytest.mark.slow
def test_ctrl_c_ends_the_program_with_a_sentence(files):
    ahead = ["--until", "2024-03-06", "--steps", "200000"]
    words = [sys.executable, "-m", "sphfilter", "forecast", *files, *ahead]
    natural = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)  # scripts in the background ignore it
    root = {"PYTHONPATH": str(Path(sf.__file__).parents[1])}
    with subprocess.Popen(
        words, stderr=subprocess.PIPE, text=True, preexec_fn=natural, env=os.environ | root
    ) as program:
        assert program.stderr.readline() == "sphfilter forecast\n"
        time.sleep(4.0)
        program.send_signal(signal.SIGINT)
        told = program.stderr.read().splitlines()
    assert program.returncode == 130 and told[-1] == "sphfilter: stopped"
