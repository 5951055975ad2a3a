"""Smoothing on clouds against Rauch, Tung and Striebel, lattices, and itself with many points."""

import numpy as np
import pytest
from density_cases import duffing, linear, off, position, start, text

import sphfilter as sf
from reference_filters.rts import smooth_linear

FEW = sf.FilterConfig(scheme=sf.CloudScheme(n_points=512))
WELL = text(["x"], ["x - x**3"], [["1"]], [[0.5]])
VAN_DER_POL = text(["x", "v"], ["v", "-x + 0.2*(1 - x**2)*v"], Q=[[0.2]])
CART = text(
    ["x", "v", "y", "w"],
    ["v", "-2*x - 0.2*x**3 - 0.4*v + y", "w", "x - 2*y - 0.4*w"],
    [["0", "0"], ["1", "0"], ["0", "0"], ["0", "1"]],
    [[0.4, 0.0], [0.0, 0.4]],
)
BOTH = sf.GaussianMeasurement(h=np.eye(4)[[0, 2]], noise_cov=0.1 * np.eye(2))


def chain(n):
    """Oscillators joined by springs: n states, noise and readings of half of them."""
    A, half = np.zeros((n, n)), np.eye(n)[:, 1::2]
    for i in range(0, n, 2):
        A[i, i + 1], A[i + 1, i], A[i + 1, i + 1] = 1.0, -2.0, -0.3
        for j in (i - 2, i + 2):
            if 0 <= j < n:
                A[i + 1, j] = 1.0
    model = sf.LinearSDE(A=A, noise=half, spectral_density=0.4 * np.eye(n // 2))
    sensor = sf.GaussianMeasurement(h=np.eye(n)[::2], noise_cov=0.1 * np.eye(n // 2))
    return model, sensor, (np.zeros(n), 0.5 * np.eye(n))


LINEAR = {3: (linear(3), position(3), start(3)), 4: (linear(4), position(4), start(4)), 6: chain(6)}


def simulated(model, sensor, x0, times, seed):
    """Measurements at the times, one of them missing."""
    _, z = sf.simulate(model, sensor, x0=x0, times=np.r_[0.0, times], rng=seed)
    z[3] = np.nan
    return z[1:]


def errors(found, x, P):
    """Errors of means, rms over the states, and of covariances, by epoch."""
    mean, cov = off(found.x, found.P, x, P)
    return mean / np.sqrt(x.shape[1]), cov


def assert_close(found, exact, mean, cov, told=3.0):
    off_mean, off_cov = errors(found, *exact)
    assert off_mean.max() < mean and np.sqrt(np.mean(off_cov**2)) < cov
    variances, right = (np.diagonal(P, axis1=1, axis2=2) for P in (found.P, exact[1]))
    off_variance = np.abs(variances / right - 1.0).max(axis=1)
    for each, error in ((off_mean, found.error), (off_variance, found.variance_error)):
        made, said = (np.sqrt(np.mean(square)) for square in (each**2, error**2))
        assert said / 6.0 < made < told * said


@pytest.mark.parametrize("n", LINEAR)
@pytest.mark.parametrize("interval", [0.1, pytest.param(1.0, marks=pytest.mark.slow)])
def test_linear_models_as_rauch_tung_and_striebel(n, interval):
    model, sensor, begin = LINEAR[n]
    times = interval * np.arange(1, 9)
    z = simulated(model, sensor, begin[0], times, 3)
    found = sf.smooth(sf.SPHFilter(model, sensor, *begin, config=FEW), times, z)
    x, P, log_evidence = smooth_linear(model, sensor, begin, times, z)
    assert_close(found, (x, P), 0.04, 0.12)
    assert np.abs(found.log_evidence - log_evidence).max() < 0.1
    assert np.isnan(found.extrapolated).all()


def test_the_default_of_four_states_and_of_maps():
    model, sensor, begin = LINEAR[4]
    times = np.arange(1.0, 5.0)
    F, _, Q = model.discretize(1.0)
    steps = sf.DiscreteModel.from_matrices(F, Q)
    z = simulated(model, sensor, begin[0], times, 3)
    exact = smooth_linear(model, sensor, begin, times, z)[:2]
    for each in (model, steps):
        found = sf.smooth(sf.SPHFilter(each, sensor, *begin), times, z)
        assert_close(found, exact, 0.03, 0.05)


def test_maps_of_three_states_by_their_text():
    """As of matrices: each step of its own is linearised."""
    F, Q = np.array([[0.9, 0.2, 0.0], [0.0, 0.8, 0.1], [0.0, 0.0, 0.7]]), 0.1 * np.eye(3)
    words = [" + ".join(f"{c}*{s}" for c, s in zip(row, "xyv", strict=True)) for row in F]
    bent = sf.DiscreteModel.from_expressions(
        list("xyv"), [*words[:2], f"{words[2]} + 1e-9*sin(x)"], covariance=Q
    )
    begin, times = (np.zeros(3), np.eye(3)), np.arange(1.0, 7.0)
    z = simulated(bent, position(3), begin[0], times, 1)
    found = sf.smooth(sf.SPHFilter(bent, position(3), *begin, config=FEW), times, z)
    same = sf.DiscreteModel.from_matrices(F, Q)
    exact = sf.smooth(sf.SPHFilter(same, position(3), *begin), times, z)
    mean, _ = errors(found, exact.x, exact.P)
    assert mean.max() < 0.05


def test_repeated_times_sensors_and_a_reading_at_the_start():
    model, sensor, begin = LINEAR[3]
    other = sf.GaussianMeasurement(h=[[0.0, 1.0, 0.0]], noise_cov=[[0.5]])
    times = np.array([0.0, 0.4, 0.4, 2.0])
    z, sensors = [[0.8], [np.nan], [0.1], [-0.4]], [None, None, other, None]
    flt = sf.SPHFilter(model, sensor, *begin, config=FEW)
    found = sf.smooth(flt, times, z, sensors=sensors)
    x, P, _ = smooth_linear(model, sensor, begin, times, z, [s or sensor for s in sensors])
    mean, _ = errors(found, x, P)
    assert mean.max() < 0.05 and flt.t == 0.0
    assert found.densities[1] is found.densities[2]


CURVED = {
    "van der Pol": (VAN_DER_POL, position(2, 0.2), [1.0, 0.0], 0.2 * np.eye(2), 1.0),
    "double well": (WELL, position(1, 0.1), [0.5], [[0.3]], 1.5),
    "duffing": (duffing(1.6), position(2, 0.2), [3.0, 0.0], np.diag([0.2, 1.0]), 2.0),
}


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) for n in CURVED])
def test_curved_models_as_on_lattices(name):
    model, sensor, x0, P0, interval = CURVED[name]
    times = interval * np.arange(1, 9)
    z = simulated(model, sensor, x0, times, 3)
    config = sf.FilterConfig(scheme=sf.CloudScheme(n_points=2048))
    found = sf.smooth(sf.SPHFilter(model, sensor, x0, P0, config=config), times, z)
    lattice = sf.smooth(sf.SPHFilter(model, sensor, x0, P0, n_particles=300), times, z)
    made, _ = errors(found, lattice.x, lattice.P)
    assert np.all(made < 3.0 * found.error)
    assert np.all(made[found.error < 0.1] < 0.03) and np.any(found.error < 0.1)


@pytest.mark.parametrize("seed", [pytest.param(2, marks=pytest.mark.slow), 4])  # of that no led point goes on
def test_wells_of_three_states_as_each_by_itself(seed):
    """What later readings say of two peaks is no quadratic: the filter's points are weighted by them."""
    sensor = sf.GaussianMeasurement.from_expressions(list("xyv"), ["x**2", "y"], noise_cov=0.1 * np.eye(2))
    times, (x0, P0) = 0.5 * np.arange(1, 7), ([0.5] * 3, 0.3 * np.eye(3))
    wells = text(list("xyv"), ["x - x**3", "y - y**3", "v - v**3"], np.eye(3), 0.5 * np.eye(3))
    z = simulated(wells, sensor, x0, times, seed)
    found = sf.smooth(sf.SPHFilter(wells, sensor, x0, P0, config=FEW), times, z)
    square = sf.GaussianMeasurement.from_expressions(["x"], ["x**2"], noise_cov=[[0.1]])
    sides = zip((square, position(1, 0.1), position(1, 0.1)), (*z.T, [None] * 6), strict=True)
    alone = [
        sf.smooth(sf.SPHFilter(WELL, one, [0.5], [[0.3]], n_particles=300), times, each)
        for one, each in sides
    ]
    x, P = (np.hstack([getattr(each, name).reshape(6, 1) for each in alone]) for name in ("x", "P"))
    made = np.sqrt(np.mean((found.x - x) ** 2 / P, axis=1))
    assert made.max() < 0.1 and np.sqrt(np.mean(made**2)) < 3.0 * np.sqrt(np.mean(found.error**2)) < 0.3
    assert np.abs(np.diagonal(found.P, axis1=1, axis2=2) / P - 1.0).max() < 0.2


@pytest.mark.parametrize("count", [512, pytest.param(2048, marks=pytest.mark.slow)])
def test_a_cart_as_with_many_points(count):
    times = 2.0 * np.arange(1, 5)
    z = simulated(CART, BOTH, [1.0, 0.0, -0.5, 0.5], times, 4)

    def found(points):
        config = sf.FilterConfig(scheme=sf.CloudScheme(n_points=points))
        return sf.smooth(sf.SPHFilter(CART, BOTH, np.zeros(4), 0.5 * np.eye(4), config=config), times, z)

    many, few = found(8 * count), found(count)
    assert_close(few, (many.x, many.P), 0.06, 0.12)
    assert few.error[-1] <= few.filtered.error[-1]  # nothing comes later: the filter's, where that is better
