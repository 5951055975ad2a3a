"""Smoothed densities against Rauch, Tung and Striebel, and against a grid with a backward pass of its own."""

import numpy as np
import pytest
from density_cases import off, text

import sphfilter as sf
from reference_filters.grid_smoother import smooth_on_grid
from reference_filters.rts import smooth_linear
from sphfilter.errors import PropagationError
from sphfilter.inference import smoother

LINEAR = sf.LinearSDE(
    A=[[0.0, 1.0], [-1.0, -0.4]], b=[0.0, 0.5], noise=[[0.0], [1.0]], spectral_density=[[1.6]]
)
POSITION = sf.GaussianMeasurement(h=[[1.0, 0.0]], noise_cov=[[0.2]])
VELOCITY = sf.GaussianMeasurement(h=[[0.0, 1.0]], noise_cov=[[0.5]])
START = np.array([1.0, 0.0]), np.eye(2)

DOUBLE_WELL = text(["x"], ["x - x**3"], [["1"]], [[0.5]])
LEVEL = sf.GaussianMeasurement(h=[[1.0]], noise_cov=[[0.1]])
DUFFING = text(["x", "v"], ["v", "-0.4*v + x - 0.1*x**3"], Q=[[1.6]])
VAN_DER_POL = text(["x", "v"], ["v", "-x + 0.2*(1 - x**2)*v"], Q=[[0.2]])


def distance(x, P, exact_x, exact_P):
    """Largest errors of mean (standard deviations) and covariance (relative)."""
    mean, cov = off(x, P, exact_x, exact_P)
    return mean.max(), cov.max()


def check_as_exact(found, exact, nats=1e-3):
    """Moments within a thousandth of exact ones, and the log-evidence within so much."""
    x, P, log_evidence = exact
    mean, cov = distance(found.x, found.P, x, P)
    assert mean < 1e-3 and cov < 1e-3
    assert np.abs(found.log_evidence - log_evidence).max() < nats


def simulated(model, sensor, x0, times, seed):
    """Measurements at the times, the fourth of them missing."""
    _, z = sf.simulate(model, sensor, x0=x0, times=np.r_[0.0, times], rng=seed)
    z[4] = np.nan
    return z[1:]


def test_linear_as_rauch_tung_and_striebel():
    """Measured: mean 2.4e-4, covariance 1.1e-4, evidence 2.2e-4 nat."""
    times = np.arange(1.0, 13.0)
    z = simulated(LINEAR, POSITION, START[0], times, 2)
    found = sf.smooth(sf.SPHFilter(LINEAR, POSITION, *START, n_particles=200), times, z)
    check_as_exact(found, smooth_linear(LINEAR, POSITION, START, times, z))


def test_what_no_lattice_follows_goes_on_as_clouds(monkeypatch):
    def refused(epochs):
        raise PropagationError("the lattice lost 26 % of the probability")

    monkeypatch.setattr(smoother, "_backward", refused)
    times = np.arange(1.0, 7.0)
    z = simulated(LINEAR, POSITION, START[0], times, 2)
    found = sf.smooth(sf.SPHFilter(LINEAR, POSITION, *START), times, z)
    mean, _ = off(found.x, found.P, *smooth_linear(LINEAR, POSITION, START, times, z)[:2])
    assert np.sqrt(np.mean(mean**2)) < 3.0 * np.sqrt(np.mean(found.error**2)) < 0.3
    with pytest.raises(PropagationError, match="26 %"):
        sf.smooth(sf.SPHFilter(LINEAR, POSITION, *START, n_particles=200), times, z)


def test_times_of_a_clock():
    """Counted from long ago: their rounding is no part of a step."""
    z = [[0.8], [0.1], [-0.4]]
    times = 2.0**30 + np.array([0.5, 1.0, 1.5])
    found = sf.smooth(sf.SPHFilter(LINEAR, POSITION, *START, t0=2.0**30, n_particles=200), times, z)
    mean, cov = distance(found.x, found.P, *smooth_linear(LINEAR, POSITION, START, times - 2.0**30, z)[:2])
    assert mean < 1e-3 and cov < 1e-3


def test_several_sensors_at_irregular_and_repeated_times():
    times = np.array([0.0, 0.4, 0.4, 2.0, 2.0, 2.3])
    z = [[0.8], None, [0.1], [np.nan], [-0.4], [0.3]]
    sensors = [None, None, VELOCITY, None, VELOCITY, POSITION]
    for config in (sf.FilterConfig(), sf.FilterConfig(exact_linear=True)):
        flt = sf.SPHFilter(LINEAR, POSITION, *START, n_particles=200, config=config)
        found = sf.smooth(flt, times, z, sensors=sensors)
        own = [s or POSITION for s in sensors]
        check_as_exact(found, smooth_linear(LINEAR, POSITION, START, times, z, own))
        assert found.densities[1] is found.densities[2]
        assert flt.t == 0.0 and flt.log_evidence == 0.0


def test_four_states():
    """Two coupled oscillators. Measured: mean 1.2e-4, covariance .0099; on 1000 particles 9e-5 and 4e-4."""
    A = [[0, 1, 0, 0], [-2, -0.8, 1, 0.4], [0, 0, 0, 1], [1, 0.4, -1, -0.4]]
    noise = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 0.0], [0.0, 1.0]])
    model = sf.LinearSDE(A=np.array(A, dtype=float), noise=noise, spectral_density=0.2 * np.eye(2))
    sensor = sf.GaussianMeasurement(h=np.eye(4)[[0, 2]], noise_cov=0.1 * np.eye(2))
    start, times = (np.zeros(4), 0.3 * np.eye(4)), np.array([1.0, 2.0, 3.0])
    z = [[0.3, 0.1], [0.2, np.nan], [-0.3, -0.2]]
    found = sf.smooth(sf.SPHFilter(model, sensor, *start, n_particles=500), times, z)
    mean, cov = distance(found.x, found.P, *smooth_linear(model, sensor, start, times, z)[:2])
    assert mean < 1e-3 and cov < 0.03


def test_the_last_density_is_the_filters():
    times = np.array([1.0, 2.0])
    flt = sf.SPHFilter(LINEAR, POSITION, *START, n_particles=200)
    found = sf.smooth(flt, times, [[0.5], [0.2]])
    result = flt.run(times, [[0.5], [0.2]])
    np.testing.assert_array_equal(found.x[-1], result.x[-1])
    np.testing.assert_array_equal(found.filtered.P, result.P)
    np.testing.assert_array_equal(found.filtered.log_evidence, result.log_evidence)


def test_the_grid_smoother_is_exact_where_there_is_an_exact_one():
    times = np.array([0.5, 1.2, 2.0])
    z = [[0.5], None, [-0.3]]
    found = smooth_on_grid(LINEAR, POSITION, START, times, z, size=96, nodes=96, step=0.05)
    check_as_exact(found, smooth_linear(LINEAR, POSITION, START, times, z), 2e-3)


def test_a_double_well_as_on_a_grid():
    """Densities in two pieces. Measured: mean 1.9e-4, covariance 2.8e-4."""
    times = 1.5 * np.arange(1, 9)
    z = simulated(DOUBLE_WELL, LEVEL, [0.5], times, 3)
    start = np.array([0.5]), np.array([[0.3]])
    found = sf.smooth(sf.SPHFilter(DOUBLE_WELL, LEVEL, *start, n_particles=50), times, z)
    grid = smooth_on_grid(DOUBLE_WELL, LEVEL, start, times, z, nodes=600, step=0.025)
    mean, cov = distance(found.x, found.P, grid.x, grid.P)
    assert mean < 2e-3 and cov < 2e-3
    assert mean < 3.0 * found.error.max() < 5e-3
    X = np.linspace(-1.5, 1.5, 7)[:, None]
    for p, q in zip(found.densities, grid.densities, strict=True):
        assert p.pdf(X) == pytest.approx(q.pdf(X), abs=2e-3)


def test_duffing_as_on_a_grid():
    """The mean is within a hundredth of a standard deviation on 200 particles."""
    times = np.array([2.0, 4.0, 6.0])
    z = simulated(DUFFING, POSITION, [3.0, 0.0], np.arange(2.0, 10.0, 2.0), 3)[:3]
    start = np.array([3.0, 0.0]), np.diag([0.2, 1.0])
    found = sf.smooth(sf.SPHFilter(DUFFING, POSITION, *start), times, z)
    grid = smooth_on_grid(DUFFING, POSITION, start, times, z, nodes=100, step=0.05)
    mean, cov = distance(found.x, found.P, grid.x, grid.P)
    assert mean < 0.01 and cov < 0.02
    assert np.ptp(found.log_evidence) < 0.01
    assert mean < 3.0 * found.error.max() < 0.05


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "start", "interval"),
    [(DUFFING, ([3.0, 0.0], [0.2, 1.0]), 2.0), (VAN_DER_POL, ([1.0, 0.0], [0.2, 0.2]), 2.5)],
    ids=["duffing", "van_der_pol"],
)
def test_long_intervals_as_on_a_grid(model, start, interval):
    start = np.array(start[0]), np.diag(start[1])
    times = interval * np.arange(1, 9)
    z = simulated(model, POSITION, start[0], times, 3)
    grid = smooth_on_grid(model, POSITION, start, times, z, step=0.025)
    found = sf.smooth(sf.SPHFilter(model, POSITION, *start, n_particles=400), times, z)
    mean, cov = distance(found.x, found.P, grid.x, grid.P)
    assert mean < 0.01 and cov < 0.02


def test_smoothing_says_what_it_does_not_support():
    flt = sf.SPHFilter(LINEAR, POSITION, *START)
    with pytest.raises(sf.ModelError, match="needs an SPHFilter"):
        sf.smooth(LINEAR, [1.0], [[0.1]])
    with pytest.raises(sf.ModelError, match="1 times, 2 measurements"):
        sf.smooth(flt, [1.0], [[0.1], [0.2]])
    with pytest.raises(sf.ModelError, match="before the filter's own time"):
        sf.smooth(flt, [-1.0], [[0.1]])
    with pytest.raises(sf.ModelError, match="log_density"):
        sf.smooth(sf.SPHFilter(LINEAR, POSITION, *START, config=sf.FilterConfig.paper()), [1.0], [[0.1]])
    circle = [("periodic", -np.pi, np.pi), None]
    angle = sf.SDE.from_expressions(["a", "v"], ["v", "-sin(a)"], [["0"], ["1"]], domain=circle)
    with pytest.raises(sf.ModelError, match="domain"):
        sf.smooth(sf.SPHFilter(angle, POSITION, *START), [1.0], [[0.1]])
