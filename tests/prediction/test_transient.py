"""Transient solutions: output times, callbacks, files that continue to the last bit, the last resort."""

import numpy as np
import pytest

import sphfilter as sf
from sphfilter.density.storage import load_arrays, write_arrays
from sphfilter.errors import UnresolvedError
from sphfilter.prediction import propagate

DUFFING = sf.SDE.from_expressions(
    ["x", "v"], ["v", "-0.4*v + x - 0.1*x**3"], noise=[[0], [1]], spectral_density=[[0.8]]
)
START = sf.Gaussian([0.0, 2.0], 0.25 * np.eye(2))


def start(n_particles=150, **options):
    return sf.initialize(START, n_particles, **options)


def test_moments_and_probabilities_along_the_way():
    model = sf.LinearSDE([[-1.0]], noise=[[1.0]])
    times = [0.5, 1.0, 1.0, 2.0]
    way = sf.propagate(sf.initialize(sf.Gaussian([1.0], [[0.1]]), 60), model, times)
    mean, var = np.exp(-way.times), 0.1 * np.exp(-2 * way.times) + 0.5 * (1 - np.exp(-2 * way.times))
    assert way.moment([1]) == pytest.approx(mean, rel=1e-4)
    assert way.moment([2], central=True) == pytest.approx(var, rel=1e-4)
    assert way.probability(lambda X: X[:, 0] > 0)[-1] == pytest.approx(0.5779, abs=0.01)
    assert way.infos[2].skipped == ("everything: the interval is empty",)


@pytest.mark.parametrize(
    "options", [{}, {"config": sf.SolverConfig(scheme="paper")}, {"domain": [("periodic", -9, 9), None]}]
)
def test_a_solution_read_from_a_file_goes_on_to_the_last_bit(tmp_path, options):
    config = options.get("config")
    first = sf.propagate(start(**options), DUFFING, [0.3, 0.6], config)
    first.save(tmp_path / "way.npz")
    again = sf.Trajectory.load(tmp_path / "way.npz")
    assert again.infos == first.infos and np.array_equal(again.times, first.times)
    ends = [sf.predict(way.densities[-1], DUFFING, 0.3, config)[0] for way in (first, again)]
    for name in ("x", "mass", "h"):
        assert np.array_equal(getattr(ends[0], name), getattr(ends[1], name))
    X = START.mean + np.array([[0.1, 0.2], [1.0, -1.0]])
    assert np.array_equal(first.densities[0].pdf(X), again.densities[0].pdf(X))
    assert again.densities[0].domain == first.densities[0].domain


def test_a_file_of_another_format_is_refused(tmp_path):
    write_arrays(tmp_path / "a.npz", {"x": np.zeros(1)})
    assert load_arrays(tmp_path / "a.npz")["x"] == 0.0
    np.savez(tmp_path / "b.npz", format=np.array(99))
    with pytest.raises(sf.ModelError, match="format 99"):
        sf.Trajectory.load(tmp_path / "b.npz")
    with pytest.raises(sf.ModelError, match="cannot read"):
        sf.Trajectory.load(tmp_path / "c.npz")


def test_a_callback_sees_every_time_and_may_stop():
    seen = []

    def look(density, info):
        seen.append((density.t, info.scheme))
        return density.t >= 0.4

    way = sf.propagate(start(), DUFFING, [0.2, 0.4, 0.6], callback=look)
    assert [t for t, _ in seen] == [0.2, 0.4] == list(way.times) and len(way.densities) == 2


@pytest.mark.parametrize("times", [[1.0, 0.5], [-1.0], [np.nan], [[1.0, 2.0]]])
def test_times_that_cannot_be(times):
    with pytest.raises(sf.ModelError, match="times"):
        sf.propagate(start(), DUFFING, times)


def test_a_cloud_is_the_last_resort(monkeypatch):
    """Where no lattice holds the density points of it go on."""

    def no_lattice(density, model, *, t, config, **options):
        if t > 0.3 and density.field is not None and not isinstance(config.scheme, sf.CloudScheme):
            raise UnresolvedError("the density has edges")
        return sf.predict(density, model, t=t, config=config, **options)

    monkeypatch.setattr(propagate, "predict", no_lattice)
    way = sf.propagate(start(), DUFFING, [0.3, 0.6, 0.9])
    monkeypatch.undo()
    usual = sf.propagate(start(), DUFFING, [0.3, 0.6, 0.9])
    assert [info.scheme for info in way.infos][:2] == ["log_density", "cloud"]
    assert way.infos[1].status.endswith("the density has edges")
    assert way.infos[0].code == sf.Code.OK and sf.Code.FALLBACK in way.infos[1].code
    assert way.densities[-1].cov() == pytest.approx(usual.densities[-1].cov(), abs=0.01)


@pytest.mark.slow
def test_a_density_that_folds_three_dimensions():
    """Lorenz's system from N(0, I): second moments of a million paths, standard errors below .4 per cent."""
    drift = ["10*(y - x)", "28*x - x*z - y", "x*y - 8*z/3"]
    lorenz = sf.SDE.from_expressions(["x", "y", "z"], drift, np.eye(3).tolist(), np.eye(3))
    way = sf.propagate(
        sf.initialize(sf.Gaussian(np.zeros(3), np.eye(3)), 2000), lorenz, np.linspace(0.1, 0.7, 7)
    )
    assert [info.scheme for info in way.infos] == 4 * ["log_density"] + 3 * ["cloud"]
    second = [way.moment(powers) for powers in 2 * np.eye(3, dtype=int)]
    paths = {2: (143.659, 393.79, 351.29), 4: (118.10, 146.03, 1366.7), 6: (46.602, 80.548, 781.26)}
    for k, moments in paths.items():
        assert [m[k] for m in second] == pytest.approx(moments, rel=0.02)
