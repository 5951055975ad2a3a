"""`python -m experiments transient`: files are readable, solutions agree with closed forms, runs resume."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from csv_rows import csv_rows

import sphfilter as sf
from experiments.__main__ import main
from experiments.transient import plots, tables
from experiments.transient import solution as solving
from experiments.transient.problem import load_problem, problem_names
from experiments.transient.references import reference_of
from experiments.transient.solution import folder_of, solve
from experiments.transient.tables import comparison

OWN = """
[model]
states = ["x"]
drift = ["-x"]
noise = [[1.0]]
spectral_density = [[0.5]]
[start]
mean = [1.0]
cov = [[0.2]]
[times]
at = [0.5, 1.0]
[solver]
n_particles = 60
[statistics]
moments = [[4]]
exceedance = ["abs(x) > 1.5 or x < -1"]
[reference]
kind = "linear"
"""


@pytest.fixture
def own(tmp_path):
    def write(**changes):
        text = OWN
        for old, new in changes.values():
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / "own.toml"
        path.write_text(text)
        return path

    return write


@pytest.mark.parametrize("name", problem_names())
def test_every_problem_of_the_project_can_be_read(name):
    problem = load_problem(name)
    assert problem.settings.description and problem.settings.source
    assert problem.times[0] > problem.settings.start.time
    assert len(problem.quantities) >= problem.model.dim


@pytest.mark.parametrize(
    ("name", "most"),
    [
        ("oscillator_critical", 1e-3),
        pytest.param("cart_linear", 2e-3, marks=pytest.mark.slow),
        ("brownian_drift", 2e-3),
    ],
)
def test_solutions_agree_with_closed_forms(name, most, tmp_path):
    changes = {"times.end": 1.0 if name == "brownian_drift" else 4.0, "times.drawn": []}
    problem = load_problem(name, changes)
    found = comparison(problem, solve(problem, tmp_path), reference_of(problem))
    assert found[1:].max() < most


def test_a_grid_and_paths_are_references_too():
    changes = {"times.end": 2.0, "times.drawn": [], "statistics.exceedance": ["x > 5"], "reference.size": 96}
    grid = reference_of(load_problem("duffing", changes))
    changes |= {"reference.kind": "monte_carlo", "reference.n_paths": 100_000}
    paths = reference_of(load_problem("duffing", changes))
    assert grid.values.shape == paths.values.shape
    assert np.all(np.abs(grid.values - paths.values) < 4 * paths.half_width + grid.half_width + 1e-3)


def test_the_command_writes_numbers_and_pictures(tmp_path, capsys, own):
    out = tmp_path / "out"
    gif = tmp_path / "a.gif"
    assert main(["transient", "--config", str(own()), "--out", str(out), "--animate", str(gif)]) == 0
    told = capsys.readouterr().out
    assert "closed form" in told and "E[x]" in told and "log_density" in told
    pictures = {"densities.png", "moments.png", "exceedance.png"}
    files = {"trajectory.npz", "statistics.csv", "run.json", "transient.toml"}
    assert {p.name for p in out.iterdir()} == files | pictures
    assert gif.read_bytes().startswith(b"GIF")
    way = sf.Trajectory.load(out / "trajectory.npz")
    rows = csv_rows(out / "statistics.csv")
    assert [float(row["t"]) for row in rows] == list(way.times) == [0.5, 1.0]
    assert float(rows[1]["E[x^4]"]) == pytest.approx(float(rows[1]["E[x^4] reference"]), rel=1e-3)
    assert json.loads((out / "run.json").read_text())["settings"]["solver"]["n_particles"] == 60
    assert main(["transient", "--config", str(out / "transient.toml"), "--out", str(tmp_path / "b")]) == 0
    again = sf.Trajectory.load(tmp_path / "b" / "trajectory.npz")
    assert np.array_equal(again.densities[-1].x, way.densities[-1].x)


def test_a_stopped_run_goes_on(tmp_path, monkeypatch, capsys, own, ctrl_c_after):
    propagate = ctrl_c_after(0.6)
    command = ["transient", "--config", str(own()), "--out", str(tmp_path / "out")]
    assert main(command) == 130
    assert "1 of 2 times" in capsys.readouterr().err
    folder = folder_of(tmp_path / "out", load_problem(own()))
    assert (folder / "density_0000.npz").exists()

    def late(density, model, times, config, **options):
        assert times[0] > 0.6
        return propagate(density, model, times, config, **options)

    monkeypatch.setattr(solving.sf, "propagate", late)
    assert main(command) == 0
    assert not folder.exists()


def test_rules_for_new_lattices_side_by_side(tmp_path, capsys, own):
    path = own(a=("n_particles = 60", 'n_particles = 60\nconfig = { scheme = "paper" }'))
    command = ["transient", "--config", str(path), "--out", str(tmp_path / "out"), "--remesh"]
    assert main([*command, "never,0.5"]) == 0
    told = capsys.readouterr().out
    rows = {line.split("  ")[0]: line.split()[1:] for line in reversed(told.splitlines())}
    assert rows["never"][0] == "0" and "every 0.5 s: 1 new lattices on the way" in told
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"remesh_clouds.png", "remesh_variances.png"}
    assert main([*command, "never,oftne"]) == 1
    assert "solver.config.remesh" in capsys.readouterr().err
    assert main([*command, ","]) == 1
    assert "never, health, or seconds" in capsys.readouterr().err


def test_a_rule_for_new_lattices_is_a_setting(tmp_path, capsys, own):
    out = tmp_path / "out"
    command = ["transient", "--config", str(own()), "--out", str(out)]
    change = ["--set", "solver.config.scheme=paper", "--set", "solver.config.remesh=0.2"]
    assert main([*command, *change]) == 0
    assert "4 new lattices on the way" in capsys.readouterr().out
    assert sum(info.n_regrids for info in sf.Trajectory.load(out / "trajectory.npz").infos) == 4


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (("exceedance", "exceedence"), "did you mean 'exceedance'"),
        (('"abs(x) > 1.5 or x < -1"', '"abs(y) > 1"'), r"statistics.exceedance\[0\].*y"),
        (('"abs(x) > 1.5 or x < -1"', '"__import__(1)"'), r"statistics.exceedance\[0\]"),
        (("at = [0.5, 1.0]", "end = 1.0"), "give either at, or end and interval"),
        (("at = [0.5, 1.0]", "at = [1.0, 0.5]"), "must not decrease"),
        (("mean = [1.0]", "mean = [1.0, 2.0]"), "mean"),
        (("mean = [1.0]\n", ""), 'kind = "gaussian" needs mean'),
        (("cov = [[0.2]]", "cov = [[-0.2]]"), "positive definite"),
        (("moments = [[4]]", "moments = [[4, 0]]"), "needs 1 entries"),
        (('kind = "linear"', 'kind = "linaer"'), "reference.kind"),
        (('drift = ["-x"]', 'drift = ["-x**3"]'), "needs a linear model"),
        (("n_particles = 60", "n_particles = 0"), "solver.n_particles"),
        (("[solver]", 'domain = [["ring", 0, 1]]\n[solver]'), "domain"),
    ],
)
def test_errors_name_the_key(change, sentence, own, capsys, tmp_path):
    assert main(["transient", "--config", str(own(a=change)), "--out", str(tmp_path / "out")]) == 1
    message = capsys.readouterr().err
    import re

    assert re.search(sentence, message), message


def test_a_name_or_a_file(capsys):
    assert main(["transient"]) == 1
    assert main(["transient", "oscilator"]) == 1
    message = capsys.readouterr().err
    assert "one of them" in message and "did you mean 'oscillator'" in message
    assert main(["transient", "oscillator", "--animate", "a.avi"]) == 1
    assert "GIF" in capsys.readouterr().err


def test_a_table_shows_what_was_asked_for_beside_the_reference(own, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    words = ["transient", "--config", str(own()), "--out", str(tmp_path / "out")]
    assert main(words) == 0
    said = capsys.readouterr().out
    for text in ("E[x]", "std x", "E[x^4]", "P(abs(x) > 1.5 or x < -1)", "0.5  SPH", "     reference"):
        assert text in said
    assert "E[x^2]" not in said and "…" not in said
    row = csv_rows(tmp_path / "out" / "statistics.csv")[0]
    assert float(row["std x"]) == pytest.approx(float(row["std x reference"]), rel=1e-3)
    assert main([*words, "--columns", "all"]) == 0
    assert "E[x^2]" in capsys.readouterr().out


def test_numbers_of_statuses_are_told_as_ranges():
    texts = ["on 20 points: good to 0.006", "on 20 points: good to 0.0081", "on a log_density"]
    assert list(tables._grouped(texts)) == [
        ("on 20 points: good to 0.006 to 0.0081", 2),
        ("on a log_density", 1),
    ]


def test_moments_begin_at_the_start_and_nothing_is_drawn_where_no_particle_lies(own):
    problem = load_problem(own())
    solution = SimpleNamespace(start=problem.begin(), values=np.zeros((2, len(problem.quantities))))
    t, mean = plots._history(problem, solution, 0)
    assert t.tolist() == [0.0, 0.5, 1.0] and mean[0] == pytest.approx(1.0, abs=1e-3)
    solution.values[0, -1] = 0.3
    ax = plots._exceedances(problem, solution, None).axes[0]
    p = ax.lines[0].get_ydata()
    assert p[0] > 0.0 and p[1] == 0.3 and np.isnan(p[2])
    assert "no line where no particle lies" in ax.get_title(loc="left")
