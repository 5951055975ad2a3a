"""`python -m experiments filter`: data files, model files, and the command against a textbook recursion."""

import csv
import inspect
from types import SimpleNamespace

import numpy as np
import pytest
from cases.tank import TANK, textbook

from experiments.__main__ import main
from experiments.own_data import plots
from experiments.own_data.model_file import load_model
from experiments.scene.filters import Factory
from experiments.show.style import plt
from sphfilter.errors import ConfigError, ModelError, PropagationError, SphfilterError
from sphfilter.files.csv_data import read_measurements

TIMES = [0.0, 0.5, 0.5, 1.7, 3.0, 3.4]
READINGS = [1.2, 0.7, 1.1, None, -0.4, 0.1]


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "level.toml"
    path.write_text(TANK, encoding="utf-8")
    return path


@pytest.fixture
def data(tmp_path):
    path = tmp_path / "tank.csv"
    lines = [f"{t},{'' if z is None else z}" for t, z in zip(TIMES, READINGS, strict=True)]
    path.write_text("\n".join(["hour,level", *lines, ""]), encoding="utf-8")
    return path


def numbers(path):
    with open(path, newline="", encoding="utf-8") as file:
        heading, *rows = csv.reader(file)
    return heading, np.array(rows, dtype=float)


class TestCommand:
    def test_writes_the_exact_estimates(self, model, data, tmp_path, capsys):
        out = tmp_path / "out"
        assert main(["filter", "--model", str(model), "--data", str(data), "--filters", "kf,ekf",
                     "--out", str(out)]) == 0  # fmt: skip
        exact = textbook(TIMES, READINGS)
        for name in ("kf", "ekf"):
            heading, rows = numbers(out / f"{name}.csv")
            told = ["accepted", "error", "flagged", "variance_error", "outlying"]
            assert heading == ["hour", "x", "x_std", "log_evidence", *told]
            np.testing.assert_allclose(rows[:, :4], exact, rtol=1e-5, atol=1e-6)
        said = capsys.readouterr().out
        assert f"{exact[:, 3].sum():.2f}" in said and "1 value missing" in said
        assert (out / "estimates.png").stat().st_size > 10_000

    def test_density_filters_agree(self, model, data, tmp_path):
        out = tmp_path / "out"
        words = ["filter", "--model", str(model), "--data", str(data), "--filters", "sph,grid,pf"]
        assert main([*words, "--out", str(out)]) == 0
        exact = textbook(TIMES, READINGS)
        for name, allowed in (("sph", 0.02), ("grid", 1e-3), ("pf", 0.2)):
            _, rows = numbers(out / f"{name}.csv")
            assert np.max(np.abs(rows[:, 1:3] - exact[:, 1:3]) / exact[:, 2:3]) < allowed, name

    def test_doubts_of_a_filter_are_told(self, model, data, tmp_path, capsys):
        data.write_text("day,level\n2024-05-01,1.2\n2024-05-02,-9999\n2024-05-03,0.3\n", encoding="utf-8")
        words = ["filter", "--model", str(model), "--data", str(data), "--filters", "kf,sph"]
        assert main([*words, "--out", str(tmp_path)]) == 0
        said = " ".join(capsys.readouterr().out.split())
        assert "1 reading, the first at 86400, more than five standard deviations from what SPH" in said
        assert "Dates are counted in seconds" in said
        heading, rows = numbers(tmp_path / "sph.csv")
        assert heading[0] == "day, s from 2024-05-01 00:00:00"
        assert rows[:, heading.index("outlying")].tolist() == [0.0, 1.0, 0.0]
        assert np.isfinite(rows[:, heading.index("error")]).all()

    def test_start_before_the_first_measurement(self, model, data, tmp_path):
        model.write_text(TANK + "time = -2.0\n", encoding="utf-8")
        words = ["filter", "--model", str(model), "--data", str(data), "--filters", "kf"]
        assert main([*words, "--out", str(tmp_path)]) == 0
        _, rows = numbers(tmp_path / "kf.csv")
        np.testing.assert_allclose(rows[:, :4], textbook(TIMES, READINGS, t0=-2.0), rtol=1e-9)

    def test_all_filters_stop(self, model, data, tmp_path, capsys):
        data.write_text("hour,level\n0,1\n1,1e200\n", encoding="utf-8")
        words = ["filter", "--model", str(model), "--data", str(data), "--filters", "pf"]
        with np.errstate(over="ignore"):
            assert main([*words, "--out", str(tmp_path)]) == 1
        said = capsys.readouterr()
        assert "PF stopped" in said.out and "no filter came to the end" in said.err

    def test_one_filter_stops(self, model, data, tmp_path, capsys, monkeypatch):
        make = Factory.__call__

        def failing(self, case, rng):
            if self.name == "pf":
                raise PropagationError("no such luck")
            return make(self, case, rng)

        monkeypatch.setattr(Factory, "__call__", failing)
        words = ["filter", "--model", str(model), "--data", str(data), "--filters", "kf,pf"]
        assert main([*words, "--out", str(tmp_path)]) == 1
        said = capsys.readouterr().out
        assert "PF stopped: no such luck" in said and "Estimates are in" in said
        assert (tmp_path / "kf.csv").exists()

    def test_help_shows_both_files(self, tmp_path, capsys):
        with pytest.raises(SystemExit):
            main(["filter", "--help"])
        said = capsys.readouterr().out
        text = said[said.index("  [model]") : said.index("With inputs")]
        table = said[said.index("  t,position") : said.index("my.toml: ")]
        for name, lines in (("my.toml", text), ("my.csv", table)):
            (tmp_path / name).write_text(inspect.cleandoc("\n" + lines), encoding="utf-8")
        words = ["--model", str(tmp_path / "my.toml"), "--data", str(tmp_path / "my.csv")]
        assert main(["filter", *words, "--filters", "ekf", "--out", str(tmp_path)]) == 0
        assert len(numbers(tmp_path / "ekf.csv")[1]) == 3

    def test_unknown_filter(self, model, data, tmp_path, capsys):
        words = ["filter", "--model", str(model), "--data", str(data), "--out", str(tmp_path)]
        assert main([*words, "--filters", "spf"]) == 1
        assert "no filter 'spf'" in capsys.readouterr().err


class TestData:
    def test_columns_by_name_and_by_order(self, tmp_path):
        path = tmp_path / "d.csv"
        path.write_text("\ufeffa, t ,b\n1,10, \n\n3,20,4\n", encoding="utf-8")
        named = read_measurements(path, 2, time="t", columns=("b", "a"))
        np.testing.assert_array_equal(named.times, [10, 20])
        np.testing.assert_array_equal(named.z, [[np.nan, 1], [4, 3]])
        assert read_measurements(path, 2).names == ("t", "b")

    @pytest.mark.parametrize(
        "text",
        [
            "t,z\n0,1.5\n0.5,n/a\n1,-2\n",
            "0,1.5\n0.5,\n1,-2\n",
            "t;z\n0;1,5\n0,5;NA\n1;-2\n",
            "0\t1,5\n0,5\tnan\n1\t-2\n",
            "t;z\n0;1.5\n0.5;null\n1;-2\n",
            "t,z\n2024-02-28T12:00,1.5\n2024-02-29,-\n2024-02-29T12:00,-2\n",
            "2024-02-28T12:00Z;1,5\n2024-02-29T00:00Z;\n2024-02-29T13:00+01:00;-2\n",
        ],
    )
    def test_what_files_look_like(self, tmp_path, text):
        path = tmp_path / "d.csv"
        path.write_text(text, encoding="utf-8")
        found = read_measurements(path, 1, unit="d")
        np.testing.assert_allclose(found.times, [0.0, 0.5, 1.0])
        np.testing.assert_array_equal(found.z[:, 0], [1.5, np.nan, -2.0])
        assert found.names == (("z",) if "z" in text else ("column 2",))
        assert ("from 2024-02-28 12:00:00" in found.time_name) == ("2024" in text)

    @pytest.mark.parametrize(
        ("text", "settings", "sentence"),
        [
            ("t,depth\n0,1\n", {"columns": ("dept",)}, "no column 'dept' (did you mean 'depth'?)"),
            ("time,z\n0,1\n", {"time": "tme"}, "no column 'tme' (did you mean 'time'?)"),
            ("t,z\n0,1\n1,wet\n", {}, "line 3, column 'z': 'wet' is not a number"),
            ("t,z\n0,1\n\n1,inf\n", {}, "line 4, column 'z': an infinite value"),
            ("t,z\n0,1\n2,1\n1,1\n", {}, "line 4: time 1 is before 2"),
            ("t,z\n0,1\n,1\n", {}, "line 3: there is no time in column 't'"),
            ("t,z\n0,1\n1\n", {}, "line 3: 1 cells under 2 column names"),
            ("t,a,b\n0,1,2\n", {}, "the sensor gives 1 values, but"),
            ("t,z,z\n0,1,2\n", {}, "names a column twice"),
            ("t,z\n", {}, "needs a line of column names and a line of numbers"),
            ("", {}, "needs a line of column names and a line of numbers"),
            ("t,z\n2024-05-01,1\n2,1\n", {}, "line 3, column 't': '2' is no date as in the first line"),
            ("t,z\n2024-05-01,1\n", {"unit": "fortnight"}, "time_unit must be one of s, min, h, d, a"),
            ("t,z\n2024-05-01,1\n2024-05-02T00:00Z,1\n", {}, "give all of them one, or none"),
            ("t;z\n0,5;1.5\n", {}, "line 2, column 't': '0,5' is not a number"),
        ],
    )
    def test_bad_file(self, tmp_path, text, settings, sentence):
        path = tmp_path / "d.csv"
        path.write_text(text, encoding="utf-8")
        with pytest.raises(ConfigError) as problem:
            read_measurements(path, 1, **settings)
        assert sentence in str(problem.value) and str(path) in str(problem.value)

    def test_no_file_and_no_text(self, tmp_path):
        with pytest.raises(ConfigError, match=r"cannot read .*No such file"):
            read_measurements(tmp_path / "none.csv", 1)
        (tmp_path / "d.csv").write_bytes(b"t,z\n\xff\xfe,1\n")
        with pytest.raises(ConfigError, match="not a CSV file in UTF-8"):
            read_measurements(tmp_path / "d.csv", 1)


class TestModelFile:
    @pytest.mark.parametrize(
        ("old", "new", "sentence"),
        [
            ("[sensor]", "[sensr]", "unknown key sensr (did you mean 'sensor'?)"),
            ("mean = [1.0]", "", "start.mean is missing"),
            ("mean = [1.0]", "mean = [1.0, 0.0]", "the model has 1 states, but sensor.h has 1 columns and"),
            ("cov = [[2.0]]", "cov = [[-2.0]]", "positive definite"),
            ("-a*x", "-a*y", "unknown name 'y'. The names here are x, a, t, pi"),
            ("[start]", "[start", "is not valid TOML"),
        ],
    )
    def test_bad_file(self, model, old, new, sentence):
        model.write_text(TANK.replace(old, new), encoding="utf-8")
        with pytest.raises(SphfilterError) as problem:
            load_model(model)
        assert sentence in str(problem.value)
        assert str(problem.value).startswith(str(model))

    def test_sensor_in_text(self, model):
        model.write_text(TANK.replace("h = [[1.0]]", 'h = ["x**2"]'), encoding="utf-8")
        assert load_model(model).measurement.H is None

    def test_errors_have_their_class(self, model, tmp_path):
        with pytest.raises(ConfigError, match="cannot read"):
            load_model(tmp_path / "none.toml")
        model.write_text(TANK.replace("h = [[1.0]]", "h = [[1.0, 0.0]]"), encoding="utf-8")
        with pytest.raises(ModelError, match="2 columns"):
            load_model(model)


@pytest.mark.parametrize(("h", "seen"), [("[[1.0]]", True), ('["x**2"]', False)])
def test_the_picture_speaks_of_dots_where_there_are_some(model, data, tmp_path, monkeypatch, h, seen):
    model.write_text(TANK.replace("h = [[1.0]]", f"h = {h}"), encoding="utf-8")
    scenario, found, titles = load_model(model), read_measurements(data, 1), []
    monkeypatch.setattr(plots, "save", lambda figure, path: titles.append(figure.get_suptitle()))
    x = np.zeros((len(found.times), 1))
    results = {"ekf": SimpleNamespace(t=found.times, x=x, P=x[:, None])}
    plots.draw(tmp_path / "x.png", scenario, found, results)
    plt.close("all")
    assert ("measurements (dots)" in titles[0]) == seen
