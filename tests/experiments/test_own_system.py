"""A user's own transient system: the file that help prints, all that the thesis' input file offers, films."""

import inspect
import json
import sys
import tomllib

import numpy as np
import pytest
import tomli_w
from csv_rows import csv_rows
from scipy import stats
from transient_help import EXAMPLE, KEYS

import sphfilter as sf
from experiments.__main__ import main
from experiments.transient import command, film, solution
from experiments.transient.problem import load_problem
from experiments.transient.references import reference_of
from experiments.transient.settings import TransientSettings
from reference_filters.closed_forms import linear_moments

A, D22 = np.array([[0.0, 1.0], [-1.0, -0.4]]), 0.5
#: An oscillator in every word that the tests change.
TREE = {
    "model": {
        "states": ["x", "v"],
        "drift": ["v", "-x - c*v"],
        "diffusion": [["0", "0"], ["0", "0.5"]],
        "parameters": {"c": 0.4},
    },
    "start": {"mean": [1.0, 0.0], "cov": [[0.09, 0.0], [0.0, 0.09]]},
    "times": {"end": 1.0, "interval": 0.25},
    "solver": {"n_particles": 300},
}
GRID = {"origin": [-1.0, -1.0], "size": [2.0, 2.0], "spacing": 0.25}


def told(tree, **changes):
    """A tree with keys changed, as a file's text; None takes a key away."""
    tree = json.loads(json.dumps(tree))
    for key, value in changes.items():
        at = tree
        *above, last = key.split(".")
        for part in above:
            at = at.setdefault(part, {})
        at[last] = value
        if value is None:
            del at[last]
    return tomli_w.dumps(tree)


@pytest.fixture
def own(tmp_path):
    def write(changes=None, text=None):
        path = tmp_path / "own.toml"
        path.write_text(told(TREE, **(changes or {})) if text is None else text, encoding="utf-8")
        return path

    return write


@pytest.fixture
def undrawn(monkeypatch):
    """A command that makes no pictures, for tests that look at its numbers or films."""
    monkeypatch.setattr(command.plots, "draw", lambda *given: [])
    monkeypatch.setattr(command, "probe_picture", lambda path, *given: path)


def rows(path):
    return [{k: float(v) for k, v in row.items()} for row in csv_rows(path)]


def exact(t):
    """Mean and covariance of `TREE` in closed form."""
    intensity = np.diag([0.0, 2 * D22])
    return linear_moments(A, np.zeros(2), intensity, TREE["start"]["mean"], TREE["start"]["cov"], t)


@pytest.mark.usefixtures("undrawn")
def test_the_example_of_the_help_runs_as_printed(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main(["transient", "--help"])
    said = capsys.readouterr().out
    text = said[said.index("  [model]") : said.index("Results are in")]
    (tmp_path / "my.toml").write_text(inspect.cleandoc("\n" + text), encoding="utf-8")
    out, gif = tmp_path / "out", tmp_path / "my.gif"
    words = ["--config", str(tmp_path / "my.toml"), "--out", str(out), "--animate", str(gif)]
    assert main(["transient", *words]) == 0
    table = csv_rows(out / "statistics.csv")
    assert [float(row["t"]) for row in table] == list(np.arange(1, 9) / 4)
    for row in table:  # a coarse lattice and the published scheme against 20 000 paths
        ours, paths = (float(row[f"E[x^2]{end}"]) for end in ("", " reference"))
        assert ours == pytest.approx(paths, rel=0.05)
        late, theirs = (float(row[f"P(x + t*v <= 0 and v > 0){end}"]) for end in ("", " reference"))
        assert late == pytest.approx(theirs, abs=0.02)
    kept = [f"{k:04d}" for k in (0, 2, 4, 6, 8)]
    assert sorted(p.name for p in (out / "probe").iterdir()) == sorted(
        f"{k}{end}" for k in kept for end in (".npz", ".csv")
    )
    assert sorted(p.stem for p in (out / "particles").iterdir()) == kept
    assert list(sf.Trajectory.load(out / "trajectory.npz").times) == [0.5, 1.0, 1.5, 2.0]
    assert gif.read_bytes().startswith(b"GIF")


def test_every_key_of_the_thesis_has_an_answer():
    """000 sections 5.2.1 to 5.2.8."""
    theirs = {
        "output": "filename csvExport refreshRate",
        "time": "interval stepping integration",
        "particles": "origin size spacing",
        "kernel": "type coupling maxNeighbors adaptiveSmoothing iterativeSolver iterationsMax "
        "discardNotConverged initialCondition",
        "domain": "nDimensions origin size type cellScale maxParticlesPerCell",
        "statistics": "moments exceedance",
        "probing": "data save fps origin size spacing",
        "dynamics": "drift diffusion",
    }
    named = " ".join(KEYS)
    for group, keys in theirs.items():
        lines = [key for key in KEYS if key.startswith(f"{group}.")]
        for key in keys.split():
            assert any(key in line for line in lines), f"{group}.{key} is not in {named}"


def test_the_thesis_own_input_in_our_words(own):
    """000 appendix B: 1789 particles, h = 1.2 spacings, steps of .005 s, one iteration of the fixed point."""
    inside, gauss = "x**2 + v**2 < (4*0.3)**2", "exp(-0.5*(x**2 + v**2)/0.3**2)"
    scheme = {
        "name": "paper", "kernel": "gaussian", "support_range": [3.6, 3.6], "cfl": "fixed", "dt_max": 0.005,
        "smoothing": "fixed_point", "smoothing_iterations": 1, "integrator": "euler",
    }  # fmt: skip
    lattice = {"origin": [-1.5, -1.5], "size": [3.0, 3.0], "spacing": 0.05}
    start = {"kind": "expression", "pdf": f"where({inside}, {gauss}, 0)", "lattice": lattice}
    problem = load_problem(own({"start": start, "solver": {"config": {"scheme": scheme}}}))
    begin = problem.begin()
    assert begin.n_particles == 1789 and begin.h == pytest.approx(0.06)
    _, info = sf.predict(begin, problem.model, 0.05, problem.settings.solver.config)
    assert info.n_steps == 10 and info.n_discarded == 0
    parameters = {"start.kind": "uniform", "start.pdf": None, "start.lattice.spacing": [0.5, 0.3]}
    even = load_problem(own({"start": start} | parameters)).begin()
    assert even.n_particles == 7 * 11 and np.unique(even.mass).size == 1


class TestProbe:
    @pytest.mark.usefixtures("undrawn")
    def test_arrays_are_the_closed_form(self, own, tmp_path):
        data = ["density", "log_density", "density_gradient", "velocity", "smoothing_length"]
        path = own({"probe": GRID | {"data": data, "origin": [0.0, -1.0]}, "output": {"every": 3}})
        assert main(["transient", "--config", str(path), "--out", str(tmp_path / "out")]) == 0
        found = np.load(tmp_path / "out" / "probe" / "0003.npz")
        assert found["t"] == 0.75
        assert np.array_equal(found["x"], np.linspace(0, 2, 9)) and len(found["v"]) == 9
        mean, cov = exact(0.75)
        X = np.stack(np.meshgrid(found["x"], found["v"], indexing="ij"), axis=-1)
        p = stats.multivariate_normal(mean, cov).pdf(X)
        slope = -np.linalg.solve(cov, (X - mean)[..., None])[..., 0]
        assert found["density"] == pytest.approx(p, rel=2e-3)
        assert found["log_density"] == pytest.approx(np.log(p), abs=2e-3)
        assert found["density_gradient"] == pytest.approx(slope * p[..., None], abs=2e-3)
        velocity = X @ A.T - [0.0, D22] * slope
        assert found["velocity"] == pytest.approx(velocity, abs=2e-2)
        h = found["smoothing_length"]
        assert np.nanmax(h) == pytest.approx(np.nanmin(h)) and np.isfinite(h[4, 4])

    @pytest.mark.usefixtures("undrawn")
    def test_csv_is_the_same_line_by_line(self, own, tmp_path):
        path = own({"probe": GRID | {"data": ["density", "density_gradient"]}, "output": {"csv": True}})
        assert main(["transient", "--config", str(path), "--out", str(tmp_path / "out")]) == 0
        arrays = np.load(tmp_path / "out" / "probe" / "0004.npz")
        lines = rows(tmp_path / "out" / "probe" / "0004.csv")
        assert [line["density"] for line in lines] == arrays["density"].ravel().tolist()
        slopes = arrays["density_gradient"][..., 1].ravel().tolist()
        assert [line["density_gradient_v"] for line in lines] == slopes
        particles = rows(tmp_path / "out" / "particles" / "0004.csv")
        density = sf.Trajectory.load(tmp_path / "out" / "trajectory.npz").densities[-1]
        assert [p["mass"] for p in particles] == density.mass.tolist()
        assert [p["smoothing_length"] for p in particles] == density.h.tolist()
        assert [[p["x"], p["v"]] for p in particles] == density.x.tolist()
        assert [p["velocity_x"] for p in particles] == pytest.approx(density.x[:, 1])
        assert sum(p["mass"] for p in particles) == pytest.approx(1.0)

    def test_a_slice_and_a_line_are_drawn_too(self, own, tmp_path):
        for size in ([2.0, 0.0], [2.0, 2.0]):
            every = ["density", "log_density", "smoothing_length", "density_gradient", "velocity"]
            path = own({"probe": GRID | {"size": size, "data": every}, "times.end": 0.25})
            assert main(["transient", "--config", str(path), "--out", str(tmp_path / "out")]) == 0
            assert (tmp_path / "out" / "probe.png").read_bytes().startswith(b"\x89PNG")
            shape = np.load(tmp_path / "out" / "probe" / "0001.npz")["velocity"].shape
            assert shape == (9, 1 if size[1] == 0 else 9, 2)

    @pytest.mark.usefixtures("undrawn")
    def test_a_stopped_run_probes_everything(self, own, tmp_path, monkeypatch, ctrl_c_after):
        propagate, command = ctrl_c_after(0.6), ["transient", "--config", str(own({"probe": GRID}))]
        command += ["--out", str(tmp_path / "out")]
        assert main(command) == 130
        assert len(list((tmp_path / "out" / "probe").glob("*.npz"))) == 3
        monkeypatch.setattr(solution.sf, "propagate", propagate)
        assert main(command) == 0
        assert len(list((tmp_path / "out" / "probe").glob("*.npz"))) == 5


@pytest.mark.parametrize(
    ("output", "kept"),
    [
        ({}, range(8)),
        ({"every": 3}, [2, 5, 7]),
        ({"every": 4}, [3, 7]),
        ({"every": 99}, [7]),
        ({"interval": 0.5}, [1, 3, 5, 7]),
        ({"interval": 0.7}, [2, 5, 7]),  # at .75, 1.5 and the end
    ],
)
def test_output_rate(own, output, kept):
    problem = load_problem(own({"times.end": 2.0, "output": output}))
    assert problem.kept.tolist() == list(kept)


class TestText:
    def test_conditions_read_time_and_parameters(self, own):
        """P(x - c t v > 1) in closed form: a Gaussian along one direction."""
        text = "x - c*t*v > 1"
        problem = load_problem(own({"statistics": {"exceedance": [text]}, "reference": {"kind": "grid"}}))
        quantity = problem.quantities[-1]
        way = sf.propagate(problem.begin(), problem.model, problem.times)
        for density in way.densities:
            mean, cov = exact(density.t)
            along = np.array([1.0, -0.4 * density.t])
            p = stats.norm.sf(1.0, along @ mean, np.sqrt(along @ cov @ along))
            assert quantity.of(density) == pytest.approx(p, abs=3e-3)
        paths = load_problem(
            own({"statistics": {"exceedance": ["v > 0", text]}, "reference": {"kind": "none"}}),
            {"reference.kind": "monte_carlo", "reference.n_paths": 200_000},
        )
        found = reference_of(paths)
        for k, t in enumerate(paths.times):
            mean, cov = exact(t)
            along = np.array([[0.0, 1.0], [1.0, -0.4 * t]])
            p = stats.norm.sf([0.0, 1.0], along @ mean, np.sqrt(np.einsum("ki,ij,kj->k", along, cov, along)))
            assert np.all(np.abs(found.values[k, -2:] - p) < 2.5 * found.half_width[k, -2:] + 1e-4)

    def test_a_start_in_text_can_be_drawn_from(self, own):
        pdf = "where(x**2 + v**2 < 1, 1 + x/2, 0)"
        start = {"kind": "expression", "pdf": pdf, "box": [[-1, 1], [-1, 1]], "mean": None, "cov": None}
        drawn = load_problem(own({f"start.{k}": v for k, v in start.items()})).distribution.draw(
            np.random.default_rng(1), 200_000
        )
        assert drawn.shape == (200_000, 2) and np.all((drawn**2).sum(axis=1) < 1.0)
        assert drawn.mean(axis=0) == pytest.approx([1 / 8, 0.0], abs=4 * 0.5 / np.sqrt(200_000))
        assert (drawn**2).mean(axis=0) == pytest.approx([1 / 4, 1 / 4], abs=4 * 0.25 / np.sqrt(200_000))


class TestFilms:
    def test_mp4_without_ffmpeg_is_refused_at_once(self, own, tmp_path, monkeypatch, capsys):
        monkeypatch.setenv("PATH", str(tmp_path))
        command = ["transient", "--config", str(own()), "--out", str(tmp_path / "out"), "--animate"]
        assert main([*command, str(tmp_path / "a.mp4")]) == 1
        assert "needs the program ffmpeg" in capsys.readouterr().err
        assert main([*command, str(tmp_path / "nowhere" / "a.gif")]) == 1
        assert "does not exist" in capsys.readouterr().err
        assert not (tmp_path / "out").exists()

    @pytest.mark.usefixtures("undrawn")
    def test_mp4_gives_ffmpeg_a_frame_for_each_density(self, own, tmp_path, monkeypatch):
        """A program in ffmpeg's place counts what it is given: frames of width times height, four bytes."""
        fake = tmp_path / "bin" / "ffmpeg"
        fake.parent.mkdir()
        lines = (
            f"#!{sys.executable}",
            "import json, sys",
            "n = len(sys.stdin.buffer.read())",
            "json.dump([sys.argv, n], open(sys.argv[-1], 'w'))",
        )
        fake.write_text("\n".join(lines))
        fake.chmod(0o755)
        monkeypatch.setenv("PATH", str(fake.parent))
        made = tmp_path / "a.mp4"
        path = own({"probe": GRID | {"data": ["density", "log_density"], "fps": 7}, "output": {"every": 2}})
        command = ["transient", "--config", str(path), "--out", str(tmp_path / "out"), "--animate", str(made)]
        assert main(command) == 0
        words, n_bytes = json.loads(made.read_text())
        width, height = map(int, words[words.index("-s") + 1].split("x"))
        assert n_bytes == 3 * width * height * 4  # the start, and two of four times
        assert "7.0" in words and width > 1.8 * height

    def test_the_window_needs_a_display(self, own, tmp_path, monkeypatch, capsys):
        monkeypatch.setattr(film, "TOOLKITS", ["no_such_toolkit"])
        monkeypatch.setattr(film.plt, "switch_backend", unavailable)
        command = ["transient", "--config", str(own()), "--out", str(tmp_path / "out"), "--live"]
        assert main(command) == 1
        assert "--live needs a display" in capsys.readouterr().err
        assert not (tmp_path / "out").exists()

    @pytest.mark.usefixtures("undrawn")
    @pytest.mark.parametrize("closed", [pytest.param(False, marks=pytest.mark.slow), True])
    def test_the_window_shows_every_density_until_it_is_closed(self, own, tmp_path, monkeypatch, closed):
        """Windows without a screen: what is drawn into them is there to be looked at."""
        shown, waited = [], []

        def show(self, figure, density):
            draw(self, figure, density)
            shown.append((density.t, len(figure.axes)))
            if closed and density.t > 0.3:
                film.plt.close(figure)

        draw = film.Views.show
        monkeypatch.setattr(film, "TOOLKITS", ["agg"])
        monkeypatch.setattr(film.Views, "show", show)
        monkeypatch.setattr(film.plt, "show", lambda: waited.append(True))
        path = own({"probe": GRID | {"data": ["density", "velocity"]}})
        assert main(["transient", "--config", str(path), "--out", str(tmp_path / "out"), "--live"]) == 0
        assert [t for t, _ in shown] == ([0.0, 0.25, 0.5] if closed else [0.0, 0.25, 0.5, 0.75, 1.0])
        assert {n for _, n in shown} == {4}  # two panels with their colour bars
        assert bool(waited) is not closed


def unavailable(name):
    raise ImportError(name)


@pytest.mark.usefixtures("undrawn")
def test_what_was_discarded_is_told(own, tmp_path, capsys):
    steps = {"cfl": "fixed", "dt_max": 0.05}
    scheme = {"name": "paper", "smoothing": "newton", "discard_unconverged": True} | steps
    changes = {
        "model.parameters": {},
        "model.drift": ["where(x > 1.5, 20*(x - 1.5), 0)", "0"],
        "model.diffusion": [["0", "0"], ["0", "0"]],
        "start.lattice": {"origin": [0.0, -1.0], "size": [2.0, 2.0], "spacing": 0.1},
        "solver": {"config": {"scheme": scheme}},
        "times": {"at": [0.5]},
    }
    assert main(["transient", "--config", str(own(changes)), "--out", str(tmp_path / "out")]) == 0
    assert "whose smoothing lengths did not converge were" in " ".join(capsys.readouterr().out.split())
    way = sf.Trajectory.load(tmp_path / "out" / "trajectory.npz")
    assert way.densities[0].n_particles == 441 - way.infos[0].n_discarded < 441


def test_the_example_names_every_table():
    about = {"description", "source", "published", "steady", "axes"}
    assert set(TransientSettings.__dataclass_fields__) - about == set(tomllib.loads(EXAMPLE))


@pytest.mark.parametrize("line", ["# domain", "# box", "# n_particles", "# config.exact_linear"])
def test_what_the_example_leaves_out_may_be_taken_in(own, line):
    assert EXAMPLE.count(line) == 1
    text = EXAMPLE.replace(line, line[2:])
    if line == "# box":
        text = "\n".join(row for row in text.splitlines() if not row.startswith("lattice"))
    problem = load_problem(own(text=text))
    assert problem.begin().n_particles <= (problem.n_particles or 437)
    assert problem.model.domain.walled.any() == (line == "# domain")


def test_a_probe_of_three_states_is_written_but_not_drawn(own, tmp_path):
    eye = np.eye(3).tolist()
    changes = {
        "model": {"states": ["x", "y", "z"], "drift": ["-x", "-y", "-z"], "noise": eye},
        "start": {"mean": [0.0] * 3, "cov": eye},
        "times": {"at": [0.1]},
        "probe": {"origin": [-1.0] * 3, "size": [2.0] * 3, "spacing": [1.0, 0.5, 2.0]},
    }
    out, gif = tmp_path / "out", tmp_path / "a.gif"
    assert main(["transient", "--config", str(own(changes)), "--out", str(out), "--animate", str(gif)]) == 0
    found = np.load(out / "probe" / "0001.npz")
    X = np.stack(np.meshgrid([-1, 0, 1], [-1, -0.5, 0, 0.5, 1], [-1, 1], indexing="ij"), axis=-1)
    variance = np.exp(-0.2) + 0.5 * (1 - np.exp(-0.2))
    exact = stats.multivariate_normal(np.zeros(3), variance * np.eye(3)).pdf(X)
    assert found["density"] == pytest.approx(exact, rel=5e-3)
    assert not (out / "probe.png").exists() and gif.stat().st_size > 1000


def test_tables_and_inputs_of_a_transient_model(own, tmp_path):
    """A table of t that pushes, an input at its own value, and a condition that names both."""
    (tmp_path / "push.csv").write_text("t,push\n0,0\n0.5,2\n1,2\n", encoding="utf-8")
    path = own(
        {
            "model.drift": ["v", "-x - c*v + a + table('push', t)"],
            "model.inputs": {"a": 0.5},
            "model.tables": {"push": {"file": "push.csv", "values": "push", "kind": "previous"}},
            "statistics.exceedance": ["x + a > table('push', t)"],
        }
    )
    problem = load_problem(path)
    assert list(problem.model.events) == [0.0, 0.5, 1.0]
    last = solution.solve(problem, tmp_path / "out").trajectory.densities[-1]
    moments = TREE["start"]["mean"], TREE["start"]["cov"]
    for force in (0.5, 2.5):
        moments = linear_moments(A, np.array([0.0, force]), np.diag([0.0, 2 * D22]), *moments, 0.5)
    mean, cov = moments
    np.testing.assert_allclose(last.mean(), mean, atol=2e-3)
    beyond = stats.norm.sf(2.0 - 0.5, mean[0], np.sqrt(cov[0, 0]))
    assert problem.quantities[-1].of(last) == pytest.approx(beyond, abs=5e-3)
