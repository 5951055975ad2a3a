"""Bayes' rule on points, where few of them carry the posterior: against closed forms and grids."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from scipy.stats import norm

import sphfilter as sf
from sphfilter.core.cloud.control import least_error
from sphfilter.core.cloud.guide import Ahead, look_ahead
from sphfilter.core.cloud.lineages import LINES, carriers, of_variances, outermost
from sphfilter.core.cloud.pace import Steps
from sphfilter.core.cloud.weights import finite_rows, for_moments
from sphfilter.density.moments import columns, moments
from sphfilter.density.passage import moved_points, points_of_gaussian, stored_key
from sphfilter.density.points import NO_LINES, Carried
from sphfilter.filter.bridged import bridged
from sphfilter.filter.guided import _at_once, piece_by_piece, weighed
from sphfilter.filter.reading_at_prior import ReadingAtPrior
from sphfilter.filter.stacked import Stacked
from sphfilter.model.discretization import linear_transition

N = 1024
DUFFING = sf.SDE.from_expressions(["x", "v"], ["v", "-0.4*v - x*(0.1*x**2 - 1)"], [["0"], ["1"]], [[1.6]])
START = np.array([-4.25, -1.46]), np.array([[0.2, 0.4], [0.4, 2.05]])
ORNSTEIN_UHLENBECK = sf.SDE.from_expressions(["x"], ["-x"], [["1"]], [[2.0]])
SWING = sf.SDE.from_expressions(["x", "v"], ["v", "-x - 0.2*v"], [["0"], ["1"]], [[0.8]])


def asked(sensor, z, t):
    return ReadingAtPrior(sensor, z, sensor.observed(z), t, None, None, None)


def run(model, sensor, start, readings, dt, key=0):
    """The last posterior, after readings dt seconds apart."""
    points, t = points_of_gaussian(*start, N, key), 0.0
    for i, z in enumerate(readings):
        points = moved_points(points, model, t, t + dt, Steps(10), N, 100 * key + i)
        t += dt
        found, points = weighed(points, Stacked.of((asked(sensor, z, t),), None), 100 * key + i + 50)
    return found


def off(found, mean, cov, log_evidence):
    """Errors: of the mean in standard deviations, relative of the covariance, of the log-evidence."""
    m, P = moments(found.x, found.w)
    L = np.linalg.cholesky(cov)
    E = np.linalg.solve(L, np.linalg.solve(L, P - cov).T)
    e = np.linalg.norm(np.linalg.solve(L, m - mean)), np.linalg.norm(E)
    return *(np.array(e) / np.sqrt(len(m))), abs(found.log_evidence - log_evidence)


def kalman(model, H, R, mean, cov, readings, dt):
    F, shift, Q = linear_transition(model, dt)
    for z in readings:
        mean, cov = F @ mean + shift, F @ cov @ F.T + Q
        S = float(H @ cov @ H) + R
        log_evidence = norm.logpdf(z, H @ mean, np.sqrt(S))
        gain = cov @ H / S
        mean, cov = mean + gain * (z - H @ mean), cov - np.outer(gain, H @ cov)
    return mean, cov, log_evidence


# moments and log-evidence of GridFilter, 144 nodes an axis, tol 3e-4
SHARP = (
    [-2.2754423556, 0.7171523270],
    [[1.99996e-05, 1.32916e-05], [1.32916e-05, 0.8794406607]],
    -0.9834410007,
)
OUTLYING = (
    [6.5815477864, -0.1854905249],
    [[0.0588631798, 0.0072950951], [0.0072950951, 1.3022598364]],
    -46.532180238,
)
BEFORE = [[-1.9815448517509], [-1.5857187625327993], [0.9171409384357706]]


@pytest.mark.parametrize("key", range(3))
def test_a_sensor_that_is_sharp_beside_two_wells(key):
    sensor = sf.GaussianMeasurement([[1.0, 0.0]], [[2e-5]])
    found = run(DUFFING, sensor, START, [[-2.2754456074168994]], 2.0, key)
    assert found.effective > 150.0  # both passes have a dozen
    mean, cov, evidence = off(found, *SHARP)
    assert mean < 3.0 / np.sqrt(found.effective)
    assert cov < 0.2
    assert evidence < 4.0 / np.sqrt(found.lineages)


@pytest.mark.parametrize("key", range(3))
def test_a_reading_far_off_beside_two_wells(key):
    sensor = sf.GaussianMeasurement([[1.0, 0.0]], [[0.2]])
    found = run(DUFFING, sensor, START, [*BEFORE, [9.971284072451873]], 2.0, key)
    mean, _, evidence = off(found, *OUTLYING)
    assert mean < 0.5  # both passes: up to 2
    assert mean < 3.0 / np.sqrt(found.effective)
    assert evidence < 3.0 / np.sqrt(found.lineages)


@pytest.mark.parametrize("R", [1.0, 1e-4])
def test_a_linear_model(R):
    start, sensor = (np.array([1.0, 0.0]), 0.3 * np.eye(2)), sf.GaussianMeasurement([[1.0, 0.0]], [[R]])
    found = run(SWING, sensor, start, [[0.8], [-0.5]], 2.0)
    exact = kalman(SWING, np.array([1.0, 0.0]), R, *start, [0.8, -0.5], 2.0)
    assert max(off(found, *exact)) < 0.03
    assert found.effective > 500.0


@pytest.mark.parametrize("model", [DUFFING, SWING], ids=["steps", "linear"])
def test_points_led_in_compiled_code_are_those_of_any_way(model):
    points = moved_points(points_of_gaussian(*START, N, 3), model, 0.0, 1.0, Steps(12), N, 4)
    for h in (lambda x: (x[0] ** 2,), [[1.0, 0.0]]):
        sensor = sf.GaussianMeasurement(h, [[1e-3]])
        about = points, Stacked.of((asked(sensor, [3.0], 1.0),), None), 17, 0.0
        at_once, one_by_one = piece_by_piece(*about), bridged(*about)
        assert len(at_once.w) == len(one_by_one.w) > N
        assert at_once.lineages == pytest.approx(one_by_one.lineages, rel=1e-9)
        assert at_once.log_evidence == pytest.approx(one_by_one.log_evidence, abs=1e-9)
        np.testing.assert_allclose(at_once.cov, one_by_one.cov, rtol=1e-7)
    assert piece_by_piece(*about[:3], 1e9) is bridged(*about[:3], 1e9) is None


def test_tails_that_a_guide_thinks_little_of_have_points():
    """x² read sharply in two wells after three seconds: the variance of v, beside 3e6 paths."""
    well = sf.SDE.from_expressions(["x", "v"], ["v", "x - x**3 - 0.3*v"], [["0"], ["0.5"]])
    sensor = sf.GaussianMeasurement(lambda x: (x[0] ** 2,), [[0.01]])
    ratios = []
    for key in range(8):
        points = points_of_gaussian(np.zeros(2), np.eye(2), 4 * N, key)
        points = moved_points(points, well, 0.0, 3.0, Steps(24), 4 * N, 100 + key)
        about = points, Stacked.of((asked(sensor, [2.184], 3.0),), None), 200 + key, 0.0
        led = piece_by_piece(*about)
        ratios.append(moments(led.x, led.w)[1][1, 1] / 0.6439)
    assert abs(np.mean(ratios) - 1.0) < 0.025  # by guides alone .95
    assert led.log_evidence == pytest.approx(bridged(*about).log_evidence, abs=1e-9)


def test_noise_that_depends_on_the_state_tells_a_guide_nothing_of_a_points_own():
    """A linear model seen through y + 1.5 x²: points that are led over short legs have its posterior."""
    along = "-0.2*x - 0.07*(y + 1.5*x**2)"
    drift = [along, f"0.32*x - 0.2*(y + 1.5*x**2) - 3*x*({along}) - 0.0956"]
    noise = [["-0.21", "0.14"], ["0.52 + 0.63*x", "0.38 - 0.42*x"]]
    model = sf.SDE.from_expressions(["x", "y"], drift, noise)
    sensor = sf.GaussianMeasurement(lambda x: (x[1] + 1.5 * x[0] ** 2 + x[0],), [[0.01]])
    first, second = (Stacked.of((asked(sensor, [z], t),), None) for z, t in ((0.65, 1.0), (0.33, 3.0)))
    ratios = []
    for key in range(6):
        points = points_of_gaussian(np.full(2, 0.3), 0.2 * np.eye(2), 8 * N, key)
        points = moved_points(points, model, 0.0, 1.0, Steps(6), 8 * N, 100 + key)
        points = moved_points(
            weighed(points, first, 200 + key)[1], model, 1.0, 3.0, Steps(8), 8 * N, 300 + key
        )
        once, led = _at_once(points, second, 400 + key), piece_by_piece(points, second, 400 + key, 0.0)
        ratios.append(moments(once.x, once.w)[1][1, 1] / moments(led.x, led.w)[1][1, 1])
    assert abs(np.mean(ratios) - 1.0) < 0.02


def test_starts_that_end_before_a_reading_are_told():
    """What a cloud has no points for no noise of the model brings back."""
    start, sensor = (np.array([1.0, 0.0]), 0.3 * np.eye(2)), sf.GaussianMeasurement([[1.0, 0.0]], [[0.2]])
    found = [run(SWING, sensor, start, [[0.8], [16.0]], 2.0, key) for key in range(12)]
    exact = kalman(SWING, np.array([1.0, 0.0]), 0.2, *start, [0.8, 16.0], 2.0)
    told = [off(f, *exact)[0] * np.sqrt(f.effective) for f in found]
    assert np.sqrt(np.mean(np.square(told))) < 3.0
    assert max(f.lineages for f in found) < 16.0


def test_a_mode_of_next_to_no_weight_keeps_its_points():
    """It has 4e-4 of the probability and half of the variance: of 1,024 points half a one, by its weight."""
    model = sf.SDE.from_expressions(["x"], ["0"], [["1"]], [[0.01]])
    square, line = (lambda x: (x[0] ** 2,)), [[1.0]]
    x, mean, var, dt = np.linspace(-5.0, 5.0, 20001), 0.6, 0.25, 0.25
    sensors = [sf.GaussianMeasurement(h, [[R**2]]) for h, R in ((square, 0.3), (line, 0.8), (square, 0.05))]
    p = norm.pdf(x, mean, np.sqrt(var))
    for h, R in ((x**2, 0.3), (x, 0.8), (x**2, 0.05)):
        p = gaussian_filter1d(p, np.sqrt(0.01 * dt) / (x[1] - x[0])) * norm.pdf(1.0, h, R)
        p /= p.sum()
    exact, far, off = p @ (x - p @ x) ** 2, p[x < 0.0].sum(), []
    for key in range(8):
        points = points_of_gaussian(np.array([mean]), np.array([[var]]), N, key)
        for i, sensor in enumerate(sensors):
            t = i * dt
            points = moved_points(points, model, t, t + dt, Steps(1), N, 100 * key + i)
            seen = Stacked.of((asked(sensor, [1.0], t + dt),), None)
            _, points = weighed(points, seen, 100 * key + i + 50)
        off.append(
            (moments(points.x, points.w)[1][0, 0] / exact - 1.0, points.w @ (points.x[:, 0] < 0.0) / far)
        )
    assert 3e-4 < far < 6e-4
    assert np.sqrt(np.mean(np.square(off), axis=0))[0] < 0.4  # .82 by weight alone
    assert np.mean(off, axis=0)[1] == pytest.approx(1.0, abs=0.3)


def of_likelihood(R, index):
    """A sensor of one state that says nothing but the likelihood of a Gaussian reading of variance R."""
    return sf.LikelihoodMeasurement(lambda z, X, t: norm.logpdf(z[0], X[:, index], np.sqrt(R)), dim_z=1)


@pytest.mark.parametrize("R", [1e-2, 1e-3])
def test_sensors_that_say_nothing_but_a_likelihood_are_guided(R):
    cov, z = np.diag([2.0, 2.0]), 1.0
    expected = kalman(SWING, np.array([1.0, 0.0]), R, np.zeros(2), cov, [z], 0.6)
    found = run(SWING, of_likelihood(R, 0), (np.zeros(2), cov), [[z]], 0.6)
    assert found.effective > N / 4  # unguided: .05 N and .016 N
    assert np.all(np.array(off(found, *expected)) < [0.03, 0.1, 0.03])


@pytest.mark.parametrize("order", [1, -1])
def test_a_likelihood_beside_a_sensor_that_guides(order):
    """Of two wells that a square leaves, an edge leaves one: what guides is the square and the edge."""
    square = sf.GaussianMeasurement.from_expressions(["x", "v"], ["x**2"], [[0.005]])
    edge = sf.LikelihoodMeasurement(lambda z, X, t: np.where(X[:, 0] > z[0], 0.0, -np.inf), dim_z=1)
    points = moved_points(
        points_of_gaussian(np.zeros(2), np.diag([2.0, 2.0]), N, 0), SWING, 0.0, 0.6, Steps(10), N, 1
    )
    readings = [asked(square, [0.1], 0.6), asked(edge, [0.0], 0.6)][::order]
    for k, reading in enumerate(readings):
        found, points = weighed(points, Stacked.of((reading,), None), 50 + k)
    F, _, Q = linear_transition(SWING, 0.6)
    sd = np.sqrt((F @ np.diag([2.0, 2.0]) @ F.T + Q)[0, 0])
    x = np.linspace(1e-6, 2.0, 20_001)
    p = norm.pdf(x, scale=sd) * norm.pdf(0.1, x**2, np.sqrt(0.005))
    mean = np.sum(x * p) / np.sum(p)
    assert found.effective > N / 4  # by the edge alone .05 N
    assert found.x[:, 0] @ found.w == pytest.approx(mean, abs=0.003)


def test_sensors_of_which_one_is_a_likelihood_are_guided_as_their_parts():
    square = sf.GaussianMeasurement.from_expressions(["x", "v"], ["x**2"], [[0.005]])
    weak = sf.LikelihoodMeasurement(lambda z, X, t: -((X[:, 1] - z[0]) ** 2) / 20.0, dim_z=1)
    points = moved_points(
        points_of_gaussian(np.zeros(2), np.diag([2.0, 2.0]), N, 0), SWING, 0.0, 0.6, Steps(10), N, 1
    )
    both = asked(sf.Sensors({"square": square, "weak": weak}), np.array([0.1, 0.3]), 0.6)
    one, _ = weighed(points, Stacked.of((both,), None), 50)
    other, _ = weighed(points, Stacked.of((asked(square, [0.1], 0.6), asked(weak, [0.3], 0.6)), None), 50)
    assert one.log_evidence == other.log_evidence
    assert one.effective == other.effective


def test_a_box():
    low, high = 0.595, 0.605
    sensor = sf.LikelihoodMeasurement(
        lambda z, X, t: np.where((X[:, 0] > low) & (X[:, 0] < high), 0.0, -np.inf)
    )
    found = run(ORNSTEIN_UHLENBECK, sensor, (np.array([0.5]), np.array([[0.5]])), [[0.0]], 1.0)
    F, _, Q = linear_transition(ORNSTEIN_UHLENBECK, 1.0)
    law = norm(0.5 * F[0, 0], np.sqrt(0.5 * F[0, 0] ** 2 + Q[0, 0]))
    exact = [0.6], [[0.01**2 / 12.0]], np.log(law.cdf(high) - law.cdf(low))
    mean, cov, evidence = off(found, *exact)
    assert found.lineages > 50.0
    assert max(mean, cov) < 3.0 / np.sqrt(found.effective)
    assert evidence < 3.0 / np.sqrt(found.lineages)


@pytest.mark.parametrize("s", [1e-2, 1e-3])
def test_a_likelihood_with_two_narrow_peaks(s):
    sensor = sf.LikelihoodMeasurement(lambda z, X, t: norm.logpdf(np.abs(X[:, 0]), 1.0, s))
    found = run(ORNSTEIN_UHLENBECK, sensor, (np.array([0.5]), np.array([[0.5]])), [[0.0]], 1.0)
    F, _, Q = linear_transition(ORNSTEIN_UHLENBECK, 1.0)
    law = norm(0.5 * F[0, 0], np.sqrt(0.5 * F[0, 0] ** 2 + Q[0, 0]))
    right = law.pdf(1.0) / (law.pdf(1.0) + law.pdf(-1.0))  # but for terms of s²
    x, w = found.x[:, 0], found.w
    assert found.effective > 50.0
    assert abs(w[x > 0.0].sum() - right) < 3.0 * np.sqrt(right * (1.0 - right) / found.lineages)
    assert abs(found.log_evidence - np.log(law.pdf(1.0) + law.pdf(-1.0))) < 3.0 / np.sqrt(found.lineages)


def test_a_sharp_likelihood_after_noise_that_depends_on_the_state():
    """The same posterior whether the sensor says h or a likelihood only."""
    model = sf.SDE.from_expressions(["x"], ["x - x**3"], [["0.5 + 0.2*x"]], [[1.0]])
    start = np.array([1.0]), np.array([[0.1]])
    one = run(model, sf.GaussianMeasurement([[1.0]], [[1e-4]]), start, [[0.4]], 1.0)
    only = sf.LikelihoodMeasurement(lambda z, X, t: norm.logpdf(z[0], X[:, 0], 1e-2))
    other = run(model, only, start, [[0.4]], 1.0)
    numbers = 1.0 / one.lineages + 1.0 / other.lineages
    assert abs(one.log_evidence - other.log_evidence) < 3.0 * np.sqrt(numbers)
    assert min(one.lineages, other.lineages) > 30.0


def test_nothing_can_have_been_read():
    sensor = sf.LikelihoodMeasurement(lambda z, X, t: np.full(len(X), -np.inf))
    points = moved_points(points_of_gaussian(*START, 128, 0), DUFFING, 0.0, 1.0, Steps(4), 128, 0)
    found, after = weighed(points, Stacked.of((asked(sensor, [0.0], 1.0),), None), 1)
    assert found.log_evidence == -np.inf
    assert found.effective == found.lineages == 0.0
    assert np.array_equal(after.x, points.x)
    assert np.array_equal(after.w, points.w)


def test_points_that_are_no_numbers_weigh_nothing():
    points = moved_points(points_of_gaussian(*START, 128, 0), DUFFING, 0.0, 1.0, Steps(4), 128, 0)
    x = points.x.copy()
    x[::7] = np.nan, np.inf
    sensor = sf.GaussianMeasurement([[1.0, 0.0]], [[0.2]])
    found, after = weighed(points._replace(x=x), Stacked.of((asked(sensor, [-4.0], 1.0),), None), 1)
    assert np.isfinite(after.x).all()
    assert np.isfinite(found.log_evidence)


def test_a_point_without_a_guide_keeps_its_weight():
    """Where h has no value on the way without noise, nothing is proposed: the ratio is zero."""
    N, one = 64, np.ones((1, 1, 1))
    r = np.zeros((1, N))
    r[0, 5] = np.nan
    zero, z = np.zeros(N, np.int64), np.zeros((1, N))
    about = Ahead(r, z, one, one, one), np.zeros((1, N)), np.full(N, 1.0 / N)
    ancestor, _, log_ratio = look_ahead(*about, zero, z, 7)
    assert 5 not in ancestor
    assert log_ratio[5] == -np.inf
    assert np.isfinite(np.delete(log_ratio, 5)).all()


@pytest.mark.parametrize("sharp", [False, True])
def test_a_key_gives_the_same_bits(sharp):
    only = sf.LikelihoodMeasurement(lambda z, X, t: -0.5 * ((X[:, 0] - z[0]) / 1e-3) ** 2)
    sensor = only if sharp else sf.GaussianMeasurement([[1.0, 0.0]], [[2e-5]])
    a, b = (run(DUFFING, sensor, START, [[-2.0]], 2.0, 7) for _ in range(2))
    assert np.array_equal(a.x, b.x)
    assert np.array_equal(a.w, b.w)
    assert a.log_evidence == b.log_evidence


def alike(count):
    """Weights of points that are as heavy as each other."""
    return np.full(count, 1.0 / count)


def test_copies_carry_no_more_than_what_they_are_copies_of():
    x = np.random.default_rng(0).standard_normal((2, 400))
    log_w = np.log(np.full(400, 1.0 / 400.0))
    mean, evidence = carriers(x, log_w, np.arange(400), alike(400), NO_LINES)[-2:]
    assert evidence == pytest.approx(400.0)
    assert mean == pytest.approx(400.0, rel=0.02)
    copied = np.repeat(x[:, :20], 20, axis=1)
    mean, evidence = carriers(copied, log_w, np.repeat(np.arange(20), 20), alike(20), NO_LINES)[-2:]
    assert evidence == pytest.approx(20.0)
    assert mean == pytest.approx(20.0, rel=0.1)
    mean, evidence = carriers(x, log_w, np.zeros(400, np.int64), alike(400), NO_LINES)[-2:]
    assert (mean, evidence) == (pytest.approx(1.0), pytest.approx(1.0))


def test_of_heavy_tails_few_points_know_the_variance():
    """A Gaussian's N points know it as N; of variance σ² / N ∫ (x² - σ²)² p dx those of other densities."""
    rng, w = np.random.default_rng(1), np.full(20_000, 5e-5)
    for x, number in (
        (rng.standard_normal((20_000, 2)), 20_000.0),
        (rng.laplace(size=(20_000, 2)), 2.0 / 5.0 * 20_000.0),  # of kurtosis six
    ):
        mean, cov = moments(x, w)
        assert of_variances(columns(x), w, mean, cov) == pytest.approx(number, rel=0.15)


@pytest.mark.parametrize("target", [0.1, 0.01])
@pytest.mark.parametrize("log_variance", [0.36, 1.0, 2.5])
def test_a_variance_tells_what_lies_beyond_the_outermost_point(target, log_variance):
    """Geometric Brownian motion without a drift: a lognormal law of mean one."""
    model = sf.SDE.from_expressions(["x"], ["0"], [["x"]])
    config = sf.FilterConfig(target_error=target)
    flt = sf.SPHFilter(model, None, x0=[1.0], P0=[[1e-6]], config=config)
    info = flt.predict(log_variance)
    made = abs(flt.P[0, 0] / np.expm1(log_variance) - 1.0)
    assert info.scheme == "cloud"
    assert 0.5 * made < info.variance_error < 2.0 * made


def test_of_a_gaussian_next_to_nothing_lies_beyond_the_outermost_point():
    """Of N squares the largest is two above the next in the mean, four in one of seven cases."""
    points = points_of_gaussian(np.zeros(2), np.eye(2), 512, stored_key(0, 0), 0)
    assert outermost(columns(points.x), points.w, *moments(points.x, points.w)) < 2.0 * 4.0 / 512


def test_copies_know_a_variance_no_better_than_what_they_are_copies_of():
    """A hundredth of the points, which come from one now or a reading before, carries half of a variance."""
    x, each = np.random.default_rng(0).standard_normal((2, 20_000)), np.arange(20_000)
    x[:, :200], together = 10.0, np.maximum(each - 199, 0)
    for ancestor, older in ((together, NO_LINES), (each, together[None])):
        alone, told, *_ = carriers(x, np.log(alike(20_000)), ancestor, alike(20_000), older)[-4:]
        assert told < 10.0 < 1000.0 < alone


@pytest.mark.parametrize("key", range(3))
def test_variances_that_tails_carry_are_kept_under_a_sharp_peak(key):
    """A Gaussian whose velocity is read with noise of Cauchy's law, against a sum over its logarithm."""
    scale, cov = 5e-3, np.diag([1.0, 0.4])
    sensor = sf.LikelihoodMeasurement(lambda z, X, t: -np.log1p((X[:, 1] / scale) ** 2))
    F, _, Q = linear_transition(SWING, 1.0)
    v = np.geomspace(1e-9, 9.0, 20_000)
    p = v * norm.pdf(v, scale=np.sqrt((F @ cov @ F.T + Q)[1, 1])) / (1.0 + (v / scale) ** 2)
    found = run(SWING, sensor, (np.zeros(2), cov), [[0.0]], 1.0, key)
    unsure = np.sqrt(2.0 / found.of_variance)
    assert found.cov[1, 1] == pytest.approx(p @ v**2 / p.sum(), rel=4.0 * unsure)
    assert unsure < 0.15


def test_what_came_from_few_points_a_reading_before_is_as_wrong_as_they_are():
    x, each = np.random.default_rng(0).standard_normal((2, 20_000)), np.arange(20_000)
    log_w = np.log(np.full(20_000, 5e-5))
    copied, first = np.repeat(x[:, :200], 100, axis=1), np.repeat(np.arange(200), 100)[None]
    _, _, lineage, *_, few, evidence = carriers(copied, log_w, each, alike(20_000), first)
    assert np.array_equal(lineage, [each, first[0]])
    assert (few, evidence) == (pytest.approx(200.0, rel=0.02), pytest.approx(20_000.0))
    parted = carriers(copied + 9.0 * x, log_w, each, alike(20_000), first)[
        -2
    ]  # what noise has parted knows more
    assert parted > 4000.0


def test_weights_that_are_no_numbers_are_left_out():
    x, log_w = np.arange(8.0)[:, None], np.zeros(8)
    log_w[2], x[3] = np.nan, np.inf
    found = Carried.of(x, log_w, np.arange(8), alike(8))
    assert len(found.x) == 6
    assert found.log_evidence == pytest.approx(np.log(6.0))


def test_states_whose_squares_overflow_are_numbers():
    fine, every = finite_rows(np.full((2, 9), 1e200))
    assert every and fine.all()


def test_of_one_carrier_points_are_drawn():
    x, w = np.array([[1e50, 0.0], [0.0, 1.0]]), np.array([1.0, 1e-214])
    mean, cov, order = np.zeros(2), np.diag([1e-214, 1e-214]), np.arange(len(w))
    assert for_moments(x, w, mean, cov, order, 64, 0.3)[1].sum() == pytest.approx(1.0)


def test_lineages_go_back_as_far_as_they_tell_apart():
    """One row stays while none of its lineages has most of the weight; then the row before it does."""
    x, log_w = np.random.default_rng(0).standard_normal((2, 64)), np.log(np.full(64, 1.0 / 64.0))
    each, first, one = np.arange(64), np.repeat(np.arange(16), 4), np.zeros(64, np.int64)
    older, ending = (np.array([each] * (LINES - 1) + [last]) for last in (first, one))
    assert np.array_equal(carriers(x, log_w, each, alike(64), older)[2], older)
    assert np.array_equal(carriers(x, log_w, each, alike(64), ending)[2], [each] * LINES)


def test_errors_of_few_points_have_no_jump():
    numbers = np.arange(16.0, 2048.0)
    least = np.array([least_error(number, 1e9) for number in numbers])
    assert np.all(np.diff(least) < 0.0) and np.all(np.diff(np.log(least)) > -1.1 / numbers[:-1])
