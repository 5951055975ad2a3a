"""`sf.read_model`: what a file gives, starts, discrete time, dates, the other filters of the experiments."""

import numpy as np
import pytest

import sphfilter as sf
from sphfilter.errors import ConfigError, ModelError
from sphfilter.files.csv_data import read_measurements

STEPS = """
[model]
states = ["x", "v"]
transition = ["x + v", "0.9*v + u"]
noise = [["0"], ["1"]]
covariance = [[0.1]]
period = 0.5
inputs = ["u"]
[sensor]
h = ["x"]
noise_cov = [[0.3]]
[start]
mean = [1.0, 0.0]
cov = [[2.0, 0.0], [0.0, 1.0]]
[filters]
default = ["ekf"]
pf = { n_particles = 2000 }
sph = { n_particles = 300 }
"""


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "steps.toml"
    path.write_text(STEPS, encoding="utf-8")
    return path


def test_a_model_in_discrete_time(path):
    file = sf.read_model(path)
    assert isinstance(file.model, sf.DiscreteModel) and file.model.period == 0.5 and file.t0 is None
    own = sf.DiscreteModel.from_matrices([[1, 1], [0, 0.9]], [[0, 0], [0, 0.1]], [[0], [1]], period=0.5)
    for mine, theirs in zip(file.model.discretize(1.0), own.discretize(1.0), strict=True):
        np.testing.assert_allclose(mine, theirs)
    assert "steps.toml: x, v" in repr(file) and file.labels == ["x", "v"]


def test_the_filter_has_the_files_settings_and_start(path, tmp_path):
    (tmp_path / "d.csv").write_text("t,u,z\n2,0.5,1.0\n2.5,0.1,\n3,0,2.0\n", encoding="utf-8")
    file = sf.read_model(path)
    data = file.read(tmp_path / "d.csv")
    assert data.names == ("z",) and data.inputs["u"].tolist() == [0.5, 0.1, 0.0]
    flt = file.filter(data)
    assert (flt.t, flt.n_particles) == (2.0, 300) and file.filter(t0=1.0, n_particles=99).n_particles == 99
    assert np.isfinite(flt.run(data.times, data.z, inputs=data.inputs).x).all()
    with pytest.raises(ModelError, match=r"steps.toml: give start.time, or filter\(data\)"):
        file.filter()


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("covariance", "spectral_density", "spectral_density does not go with a transition"),
        ("transition = ", 'drift = ["v", "0"]\ntransition = ', "give a drift, or a transition"),
        ('transition = ["x + v", "0.9*v + u"]', "", "none is there"),
        ("sph = ", "shp = ", "unknown key filters.shp (did you mean 'sph'?)"),
        ('inputs = ["u"]', "", "unknown name 'u'"),
        ('h = ["x"]', 'h = ["x + w"]\ninputs = ["w"]', "sensor's inputs names 'w', which is no"),
    ],
)
def test_what_does_not_go(path, old, new, sentence):
    path.write_text(STEPS.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(sf.SphfilterError) as problem:
        sf.read_model(path)
    assert sentence in str(problem.value) and str(path) in str(problem.value)


@pytest.mark.parametrize(
    ("first", "second", "later"),
    [
        ("2024-02-28", "2024-03-01", "2024-03-02"),
        ("2024-02-28T12:00:00", "2024-02-29T00:00:00", "2024-02-29T12:00:00"),
        ("2024-02-28T12:00:00+01:00", "2024-02-29T00:00:00+01:00", "2024-02-29T12:00:00+01:00"),
    ],
)
def test_dates_come_back(tmp_path, first, second, later):
    path = tmp_path / "d.csv"
    path.write_text(f"when,z\n{first},1\n{second},2\n", encoding="utf-8")
    data = read_measurements(path, 1, unit="d")
    assert data.stamps == [first, second] and data.heading == "when"
    t = data.number(later)
    assert data.stamp(t) == later and data.number("7") == 7.0
    with pytest.raises(ConfigError, match="is no time as 'when' has them"):
        data.number("soon")
