"""`python -m experiments filter` with inputs, tables, sensors' parameters and several sensors."""

import csv
import inspect
from types import SimpleNamespace

import numpy as np
import pytest

import sphfilter as sf
from experiments.__main__ import main
from experiments.own_data import plots
from experiments.own_data.command import case_of
from experiments.own_data.model_file import load_model
from experiments.scene.filters import factories
from experiments.show.histories import readings
from experiments.show.style import plt
from sphfilter.errors import ConfigError, SphfilterError
from sphfilter.files.model_file import read_data

A, Q = 0.4, 0.5
MODEL = f"""
[model]
states = ["x"]
drift = ["-a*x + u + table('wind', t)"]
noise = [["1"]]
spectral_density = [[{Q}]]
parameters = {{ a = {A} }}
inputs = ["u"]

[model.tables.wind]
file = "records/wind.csv"
at = "hour"
values = "speed"
kind = "previous"

[sensors.level]
h = ["s*x"]
noise_cov = [["r"]]
parameters = {{ s = 2.0, r = 0.3 }}

[sensors.pair]
h = [[1.0], [1.0]]
noise_cov = [[0.5, 0.0], [0.0, 0.9]]

[start]
mean = [1.0]
cov = [[2.0]]
time = -1.0
"""
WIND = "speed;hour\n0,5;-2\n-0,25;1\n"
DATA = "t,u,level,pair.0,pair.1\n0,0.2,2.5,,\n1,-0.1,,0.7,0.1\n1,9,1.1,,0.3\n3,0.4,,,\n"


@pytest.fixture
def model(tmp_path):
    (tmp_path / "records").mkdir()
    (tmp_path / "records" / "wind.csv").write_text(WIND, encoding="utf-8")
    path = tmp_path / "tank.toml"
    path.write_text(MODEL, encoding="utf-8")
    return path


@pytest.fixture
def data(tmp_path):
    path = tmp_path / "tank.csv"
    path.write_text(DATA, encoding="utf-8")
    return path


def textbook():
    """Mean, standard deviation and log-evidence by the scalar recursion, reading after reading."""
    m, P, now, rows = 1.0, 2.0, -1.0, []
    epochs = [(0.0, 0.2, 0.5, [(2.0, 0.3, 2.5)]), (1.0, -0.1, 0.5, [(1.0, 0.5, 0.7), (1.0, 0.9, 0.1)]),
              (1.0, 9.0, 0.0, [(2.0, 0.3, 1.1), (1.0, 0.9, 0.3)]), (3.0, 0.4, -0.25, [])]  # fmt: skip
    for t, u, wind, read in epochs:
        decay = np.exp(-A * (t - now))
        m = decay * m + (u + wind) / A * (1 - decay)
        P, now, evidence = decay**2 * P + Q / (2 * A) * (1 - decay**2), t, 0.0
        for h, R, z in read:
            S = h * P * h + R
            evidence -= 0.5 * ((z - h * m) ** 2 / S + np.log(2 * np.pi * S))
            m, P = m + P * h / S * (z - h * m), P - (P * h) ** 2 / S
        rows.append((t, m, np.sqrt(P), evidence))
    return np.array(rows)


def estimates(path):
    with open(path, newline="", encoding="utf-8") as file:
        return np.array([row[:4] for row in list(csv.reader(file))[1:]], dtype=float)


def test_every_filter_gets_inputs_tables_and_readings_of_each_sensor(model, data, tmp_path, capsys):
    words = ["filter", "--model", str(model), "--data", str(data), "--filters", "ekf,ukf,sph,grid,pf"]
    assert main([*words, "--out", str(tmp_path / "out")]) == 0
    exact = textbook()
    for name, allowed in (("ekf", 1e-5), ("ukf", 1e-5), ("sph", 0.02), ("grid", 1e-3), ("pf", 0.2)):
        found = estimates(tmp_path / "out" / f"{name}.csv")
        assert np.max(np.abs(found[:, 1:3] - exact[:, 1:3]) / exact[:, 2:3]) < allowed, name
        np.testing.assert_allclose(found[:, 3], exact[:, 3], atol=30 * allowed)
    assert "7 values missing" in capsys.readouterr().out


def test_the_kalman_filter_takes_inputs(model, data):
    text = MODEL.replace("+ table('wind', t)", "+ 0.5").replace('h = ["s*x"]', "h = [[2.0]]")
    text = text.replace('[["r"]]', "[[0.3]]").replace("parameters = { s = 2.0, r = 0.3 }", "")
    model.write_text(text[: text.index("[model.tables")] + text[text.index("[sensors.level") :])
    scenario = load_model(model)
    case = case_of(scenario, read_data(scenario.settings, data))
    assert case.inputs.ravel().tolist() == [0.2, -0.1, 9.0, 0.4] and case.z.shape == (4, 3)
    filt = filter_of("kf", scenario, case)
    found = filt.run(case.times, case.z, inputs=case.inputs)
    np.testing.assert_allclose(found.x[:3, 0], textbook()[:3, 1], rtol=1e-10)


def filter_of(name, scenario, case):
    return factories([name], scenario)[name](case, np.random.default_rng(0))


def test_the_model_file_is_the_librarys_model(model):
    scenario = load_model(model)
    own = sf.SDE.from_expressions(
        ["x"], ["-a*x + u + table('wind', t)"], [["1"]], [[Q]], {"a": A}, inputs=["u"],
        tables={"wind": sf.Table([-2.0, 1.0], [0.5, -0.25], "previous")},
    )  # fmt: skip
    X = np.array([[0.3], [-2.0]])
    for t in (-1.5, 2.0):
        driven = (found.with_inputs([0.7]).drift(X, t) for found in (own, scenario.model))
        np.testing.assert_array_equal(*driven)
    assert list(scenario.model.events) == list(own.events) == [-2.0, 1.0]
    sensor = scenario.measurement
    assert dict(sensor.parameters) == {"s": 2.0, "r": 0.3} and list(sensor) == ["level", "pair"]
    assert sensor.with_parameters(s=3.0).predict(X)[0].tolist() == pytest.approx([0.9, 0.3, 0.3])


def test_columns_and_defaults_may_have_other_names(model, data):
    data.write_text("when,volt,deep,a,b,c\n1,0.5,2,3,4,5\n", encoding="utf-8")
    columns = '\n[data.columns]\nlevel = ["deep"]\npair = ["b", "a"]\n'
    model.write_text(MODEL + '\n[data]\ninputs = { u = "volt" }\n' + columns, encoding="utf-8")
    found = read_data(load_model(model).settings, data)
    assert found.z.tolist() == [[2.0, 4.0, 3.0]] and found.inputs["u"].tolist() == [0.5]
    with_default = (MODEL + columns).replace('inputs = ["u"]', "inputs = { u = 0.25 }")
    model.write_text(with_default, encoding="utf-8")
    scenario = load_model(model)
    assert case_of(scenario, read_data(scenario.settings, data)).inputs.tolist() == [[0.25]]


def test_one_sensor_has_all_columns_but_those_of_inputs(model, tmp_path):
    text = MODEL[: MODEL.index("[sensors.level")] + "[sensor]\nh = [[1.0]]\nnoise_cov = [[0.5]]\n"
    model.write_text(text + MODEL[MODEL.index("\n[start]") :], encoding="utf-8")
    path = tmp_path / "d.csv"
    path.write_text("t,u,deep\n0,1,2\n", encoding="utf-8")
    found = read_data(load_model(model).settings, path)
    assert found.names == ("deep",) and found.z.tolist() == [[2.0]] and found.inputs["u"].tolist() == [1.0]


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("inputs = ", "input = ", "unknown key model.input (did you mean 'inputs'?)"),
        ('inputs = ["u"]', "", "unknown name 'u'"),
        ('inputs = ["u"]', 'inputs = ["u", "w"]', "The input 'w' is used by no expression"),
        ('values = "speed"', 'valus = "speed"', "unknown key valus (did you mean 'values'?)"),
        ('values = "speed"', 'values = "sped"', "no column 'sped' (did you mean 'speed'?)"),
        ("records/wind", "records/wnd", "wnd.csv: No such file"),
        ("model.tables", "model.table", "unknown key model.table (did you mean 'tables'?)"),
        ("table('wind'", "table('wnd'", "'wnd'"),
        ('kind = "previous"', 'kind = "cubic"', "kind = 'cubic' is not valid"),
        ("sensors.level", "sensor", "give one [sensor], or several as [sensors.NAME]; both are there"),
        ("[sensors.level]", "[sensors.level]\nnois = 1", "unknown key sensors.level.nois (did you mean"),
        ("s = 2.0, r = 0.3", "s = 2.0, r = 0.3, q = 1.0", "The parameter 'q' is used by no expression"),
        ("s = 2.0", "s = 'big'", "sensors.level.parameters.s = 'big' is not valid"),
        ('h = ["s*x"]', 'h = ["s*__import__(1)"]', "'s*__import__(1)'"),
        ('h = ["s*x"]', 'h = ["s*x*v"]\ninputs = ["v"]', "names 'v', which is no input of the model"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_model_file_is_told(model, old, new, sentence):
    assert old in MODEL
    model.write_text(MODEL.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(SphfilterError) as problem:
        load_model(model)
    assert sentence in str(problem.value)


@pytest.mark.parametrize(
    ("text", "settings", "sentence"),
    [
        (DATA.replace("t,u,", "t,v,"), "", "no column 'u'"),
        (DATA.replace("1,-0.1,", "1,,"), "", "line 3, column 'u': an input, held over the interval"),
        (DATA.replace("pair.1", "pair_1"), "", "no column 'pair.0' and 'pair.1' for sensor 'pair'"),
        (DATA, "[data]\ncolumns = ['level']", "there are several sensors: give data.columns as a table"),
        (DATA, "[data.columns]\npair = ['pair.0']", "'pair' gives 2 values, but data.columns names pair.0"),
        (DATA, "[data.columns]\npiar = ['a']", "names 'piar', which is no sensor (did you mean 'pair'"),
        (DATA, "[data.inputs]\nv = 'a'", "data.inputs names 'v', which is no input of the model"),
        (DATA, "[data.inputs]\nu = 'a'", "no column 'a'"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_the_columns_is_told(model, data, text, settings, sentence):
    data.write_text(text, encoding="utf-8")
    model.write_text(MODEL + settings, encoding="utf-8")
    with pytest.raises(ConfigError) as problem:
        read_data(load_model(model).settings, data)
    assert sentence in str(problem.value)


@pytest.mark.parametrize(
    ("table", "sentence"),
    [
        ("at = [0.0, 1.0]\nvalues = [1.0]", "needs as many values as arguments"),
        ("at = [0.0, 0.0]\nvalues = [1.0, 2.0]", "must rise, 0 is followed by 0"),
        ("at = []\nvalues = []", "and some"),
        ("values = [1.0]", "model.tables.wind.at is missing"),
    ],
)
def test_a_table_in_the_file_itself(model, table, sentence):
    start, end = MODEL.index('file = "rec'), MODEL.index("[sensors.level")
    model.write_text(MODEL[:start] + "at = [0.0, 2.0]\nvalues = [0.0, 1.0]\n" + MODEL[end:], encoding="utf-8")
    assert load_model(model).model.drift([[0.0]], 1.0).tolist() == [[0.5]]
    model.write_text(MODEL[:start] + table + "\n" + MODEL[end:], encoding="utf-8")
    with pytest.raises(ConfigError) as problem:
        load_model(model)
    assert "model.tables.wind" in str(problem.value) and sentence in str(problem.value)


def test_the_example_of_the_help_runs_as_printed(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main(["filter", "--help"])
    said = capsys.readouterr().out
    assert "The input in a line is held over the interval that ends at that line" in " ".join(said.split())
    table = said[said.index("  t,throttle") : said.index("driven.toml:")]
    for name, lines in (("driven.toml", said[said.rindex("  [model]\n") :]), ("driven.csv", table)):
        (tmp_path / name).write_text(inspect.cleandoc("\n" + lines), encoding="utf-8")
    words = ["--model", str(tmp_path / "driven.toml"), "--data", str(tmp_path / "driven.csv")]
    assert main(["filter", *words, "--filters", "ekf", "--out", str(tmp_path)]) == 0
    assert len(estimates(tmp_path / "ekf.csv")) == 3


def test_the_picture_shows_inputs_and_dots_of_each_sensor(model, data, tmp_path, monkeypatch):
    text = MODEL.replace('h = ["s*x"]', "h = [[2.0]]").replace('[["r"]]', "[[0.3]]")
    model.write_text(text.replace("parameters = { s = 2.0, r = 0.3 }\n", ""), encoding="utf-8")
    scenario, kept = load_model(model), []
    found = read_data(scenario.settings, data)
    assert np.isnan(readings(scenario.measurement, found.z, 0)).tolist() == [False, True, False, True]
    monkeypatch.setattr(plots, "save", lambda figure, path: kept.append(figure))
    x = np.zeros((4, 1))
    results = {"ekf": SimpleNamespace(t=found.times, x=x, P=x[:, None])}
    plots.draw(tmp_path / "x.png", scenario, found, results)
    line = kept[0].axes[1].get_lines()[0]
    assert line.get_ydata().tolist() == [0.2, -0.1, 9.0, 0.4] and line.get_drawstyle() == "steps-pre"
    assert kept[0].axes[1].get_xlabel() == "t" and "measurements (dots)" in kept[0].get_suptitle()
    plt.close("all")
