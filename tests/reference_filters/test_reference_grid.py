"""Grid filter against exact filters, a steady state, quadrature, and itself on finer grids."""

import numpy as np
import pytest
from referee_cases import OSCILLATOR, P0, POSITION, X0, errors
from scipy.integrate import solve_ivp

from reference_filters.closed_forms import BenesFilter, DuffingSteadyState
from reference_filters.grid import GridFilter
from reference_filters.grid_density import Box, GridDensity
from reference_filters.kalman import KalmanFilter
from reference_filters.particle import ParticleFilter
from sphfilter.errors import ModelError, PropagationError
from sphfilter.model.likelihood import LikelihoodMeasurement
from sphfilter.model.measurements import GaussianMeasurement
from sphfilter.model.sde import SDE, LinearSDE
from sphfilter.model.simulate import simulate

#: 002 Tables 6 and 8: model, measurement, interval, number of updates.
VAN_DER_POL = (
    SDE(lambda x, t: (x[1], -0.1 * x[1] * (x[0] ** 2 - 1) - x[0]), 2, [[0.0], [1.0]], [[0.8]]),
    POSITION,
    2.5,
    40,
)
DUFFING = (
    SDE(lambda x, t: (x[1], -0.4 * x[1] + x[0] - 0.1 * x[0] ** 3), 2, [[0.0], [1.0]], [[1.6]]),
    GaussianMeasurement(h=[[1.0, 0.0]], noise_cov=[[0.2]]),
    2.0,
    15,
)


def test_linear_oscillator_equals_kalman():
    """Irregular and repeated times, a missing reading, an outlier of four standard deviations."""
    times, readings = [0.0, 0.8, 0.8, 2.0, 4.5], [[1.5], [0.4], [5.0], None, [-1.9]]
    truth = KalmanFilter(OSCILLATOR, POSITION, X0, P0).run(times, readings)
    result = GridFilter(OSCILLATOR, POSITION, X0, P0, size=64).run(times, readings)
    assert max(errors(result, truth)) < 1e-4


def test_steps_are_of_fourth_order():
    """Extrapolated Strang splitting: half the step, a sixteenth of the error."""
    exact = KalmanFilter(OSCILLATOR, None, X0, P0)
    exact.predict(2.4)
    grid = GridFilter(OSCILLATOR, None, X0, P0, size=64)
    off = []
    for n_steps in (4, 8):
        density, dt = grid.density, 2.4 / n_steps
        for i in range(n_steps):
            density, _ = grid._step(density, i * dt, dt)
        off.append(np.linalg.norm(density.moments()[1] - exact.P))
    assert 10 < off[0] / off[1] < 24


def test_benes_one_dimension():
    sensor = GaussianMeasurement(h=[[1.5]], noise_cov=[[0.6]])
    model = SDE(lambda x, t: (np.tanh(x[0]),), 1, noise=[[1.0]])
    exact = BenesFilter(sensor, m=0.3, s=0.2)
    start = GridDensity.sampled(lambda X: exact.pdf(X[:, 0]), Box.between([[-5.0, 6.0]], 128))
    grid = GridFilter(model, sensor, density=start, size=128, tol=2e-5)
    times, readings = [0.5, 1.5, 1.7], [[1.0], [-2.0], [4.0]]
    truth, result = exact.run(times, readings), grid.run(times, readings)
    assert max(errors(result, truth)) < 2e-5
    x = np.linspace(-6, 6, 301)
    np.testing.assert_allclose(grid.density.pdf(x[:, None]), exact.pdf(x), atol=1e-5)


def test_duffing_settles_into_its_steady_state():
    model, _, _, _ = DUFFING
    steady = DuffingSteadyState(c=0.4, k=-1.0, e=0.1, q=1.6)
    start = Box.between([[-8.0, 8.0], [-9.0, 9.0]], 96)
    grid = GridFilter(model, None, density=GridDensity.sampled(steady.pdf, start), tol=1e-4)
    grid.predict(2.0)
    X = grid.density.box.nodes()
    difference = grid.density.values.ravel() - steady.pdf(X)
    assert np.linalg.norm(difference) / np.linalg.norm(steady.pdf(X)) < 1e-4
    np.testing.assert_allclose(grid.P, steady.cov(), rtol=2e-4, atol=1e-4)


def test_time_dependent_coefficients():
    model = SDE(
        lambda x, t: (-x[0] * (1 + np.sin(t)),),
        1,
        noise=lambda x, t: ((1 + 0.5 * np.cos(2 * t),),),
        spectral_density=[[0.5]],
    )

    def rates(t, y):
        a = 1 + np.sin(t)
        return [-a * y[0], -2 * a * y[1] + 0.5 * (1 + 0.5 * np.cos(2 * t)) ** 2]

    m, var = solve_ivp(rates, (1.0, 4.0), [0.8, 0.3], rtol=1e-11, atol=1e-12).y[:, -1]
    grid = GridFilter(model, None, [0.8], [[0.3]], t0=1.0, size=64, tol=1e-4)
    grid.predict(t=4.0)
    assert grid.x[0] == pytest.approx(m, abs=1e-5)
    assert grid.P[0, 0] == pytest.approx(var, rel=1e-5)


@pytest.mark.parametrize(("size", "tolerance"), [(32, 6.4e-5), (64, 1e-6)])
def test_a_needle_of_a_likelihood_is_resolved(size, tolerance):
    """A sensor a thousand times finer than the nodes; the splines' error is of sixth order in the spacing."""
    needle = GaussianMeasurement(h=[[1.0, 0.3]], noise_cov=[[1e-8]])
    exact = KalmanFilter(OSCILLATOR, needle, X0, P0)
    grid = GridFilter(OSCILLATOR, needle, X0, P0, size=size)
    exact.update([1.6])
    grid.update([1.6])
    assert grid.log_likelihood == pytest.approx(exact.log_likelihood, abs=tolerance)
    np.testing.assert_allclose(grid.x, exact.x, atol=tolerance)
    np.testing.assert_allclose(grid.P, exact.P, atol=tolerance)


def test_a_two_valued_sensor_splits_the_density():
    """x² is seen: both branches, with the weights and the evidence of Bayes' rule."""
    sensor = LikelihoodMeasurement(lambda z, X, t: -0.5 * (z[0] - X[:, 0] ** 2) ** 2 / 0.02, dim_z=1)
    model = SDE(lambda x, t: (-x[0],), 1, noise=[[1.0]])
    grid = GridFilter(model, sensor, [0.2], [[1.0]], size=128)
    x = np.linspace(-6, 6, 200_001)
    joint = np.exp(-0.5 * (x - 0.2) ** 2 + sensor.log_likelihood([2.0], x[:, None], 0.0)) / np.sqrt(2 * np.pi)
    evidence = joint.sum() * (x[1] - x[0])
    mean = (x * joint).sum() / joint.sum()
    grid.update([2.0])
    assert grid.log_likelihood == pytest.approx(np.log(evidence), abs=1e-5)
    assert grid.x[0] == pytest.approx(mean, abs=1e-5)
    assert grid.P[0, 0] == pytest.approx(((x - mean) ** 2 * joint).sum() / joint.sum(), abs=1e-5)


def test_a_box_of_ones_own_gives_the_same_answer():
    limits = [[-6.5, 6.5], [-6.5, 6.5]]
    times, readings = [1.0, 2.0], [[0.5], [-0.4]]
    truth = KalmanFilter(OSCILLATOR, POSITION, X0, P0).run(times, readings)
    grid = GridFilter(OSCILLATOR, POSITION, X0, P0, size=96, box=limits)
    assert max(errors(grid.run(times, readings), truth)) < 1e-4
    np.testing.assert_array_equal(grid.density.box.centre, [0.0, 0.0])


@pytest.mark.parametrize("scene", [VAN_DER_POL, DUFFING], ids=["van_der_pol", "duffing"])
@pytest.mark.parametrize("share", [0.1, pytest.param(1.0, marks=pytest.mark.slow)])
def test_half_the_spacing_and_half_the_steps_change_nothing(scene, share):
    """The referee certifies errors of .1 %: its own is below .05 % of a standard deviation."""
    model, sensor, interval, n_updates = scene
    times = interval * np.arange(max(2, int(share * n_updates)) + 1)
    _, readings = simulate(model, sensor, [1.0, 1.0], times, rng=3)
    coarse, fine = (
        GridFilter(model, sensor, [1.0, 1.0], np.diag([0.3, 1.5]), size=size, tol=tol).run(times, readings)
        for size, tol in ((64, 1e-3), (128, 1.25e-4))  # the local error is of third order
    )
    mean, cov, evidence = errors(coarse, fine)
    assert 0.0 < mean < 5e-4
    assert cov < 1e-3
    assert evidence < 5e-4


def test_particles_agree_with_the_grid_where_no_closed_form_exists():
    model, sensor, interval, _ = DUFFING
    times, readings = interval * np.arange(1, 3), [[2.5], [-1.0]]
    n = 40_000
    grid = GridFilter(model, sensor, [1.0, 1.0], np.diag([0.3, 1.5]), size=64).run(times, readings)
    cloud = ParticleFilter(model, sensor, [1.0, 1.0], np.diag([0.3, 1.5]), n_particles=n, rng=2)
    mean, cov, evidence = errors(cloud.run(times, readings), grid)
    noise = 5 / np.sqrt(n / 20)  # five standard errors for a twentieth; 24 seeds: .09 at most
    assert mean < noise
    assert cov < 3 * noise
    assert evidence < noise


def test_too_coarse_a_grid_says_so_and_leaves_the_filter_as_it_was():
    model, sensor, _, _ = DUFFING
    grid = GridFilter(model, sensor, [1.0, 1.0], np.diag([0.3, 1.5]), size=16)
    with pytest.raises(PropagationError, match="raise size"):
        grid.predict(8.0)
    assert grid.t == 0.0
    np.testing.assert_allclose(grid.x, [1.0, 1.0], atol=1e-9)


def test_branches_too_fine_for_the_grid_are_refused():
    """Two needles far apart: no one box of nodes resolves them, and no answer is better than a wrong one."""
    sensor = LikelihoodMeasurement(lambda z, X, t: -0.5 * (z[0] - X[:, 0] ** 2) ** 2 / 1e-6, dim_z=1)
    grid = GridFilter(SDE(lambda x, t: (-x[0],), 1, noise=[[1.0]]), sensor, [0.2], [[1.0]], size=64)
    with pytest.raises(PropagationError, match="raise size"):
        grid.update([2.0])
    np.testing.assert_allclose(grid.x, [0.2], atol=1e-9)


def test_a_coarse_grid_still_filters():
    """32 nodes an axis and long steps: the cheap end of the scale, against the fine one."""
    model, sensor, interval, _ = VAN_DER_POL
    times, readings = interval * np.arange(1, 4), [[1.5], [-1.0], [0.3]]
    coarse, fine = (
        GridFilter(model, sensor, [1.0, 1.0], np.diag([0.3, 1.5]), size=m, tol=tol).run(times, readings)
        for m, tol in ((32, 1e-2), (64, 1e-3))
    )
    assert max(errors(coarse, fine)) < 2e-2


def test_models_out_of_reach_are_refused():
    three = LinearSDE(A=-np.eye(3), noise=np.eye(3))
    with pytest.raises(ModelError, match="1 or 2 states"):
        GridFilter(three, None, np.zeros(3), np.eye(3))
    state_noise = SDE(lambda x, t: (-x[0],), 1, noise=lambda x, t: ((x[0],),), spectral_density=[[1.0]])
    with pytest.raises(ModelError, match="does not depend on the state"):
        GridFilter(state_noise, None, [0.0], [[1.0]])


def test_a_first_step_that_would_lose_the_density_is_cut():
    """Tried whole, the first interval loses all of the density in both ways of stepping, which then agree."""
    model = SDE(lambda x, t: (1.0 - np.exp(x[1]), np.exp(x[0]) - 1.0), 2, np.eye(2), 0.05 * np.eye(2))
    grid = GridFilter(model, None, [0.5, 0.0], 0.1 * np.eye(2), size=64, tol=3e-4)
    assert grid.predict(2.0).n_steps > 1
    np.testing.assert_allclose(grid.density.mass, 1.0)
