"""Clouds of weighted points: closed forms, a fine lattice, walls, stiff drifts, and errors that are true."""

import numpy as np
import pytest
from scipy import integrate, stats

import sphfilter as sf
from experiments.scene.scenario import load_scenario
from sphfilter.campaign.campaign import draw_case
from sphfilter.core.cloud.pace import Steps
from sphfilter.density.moments import moments
from sphfilter.density.passage import chosen_steps, moved_points, points_of_gaussian
from sphfilter.density.points import Points
from sphfilter.density.storage import from_bytes, to_bytes

CLOUD = sf.FilterConfig(scheme="cloud")
WELLS = sf.SDE.from_expressions(["x", "v"], ["v", "-0.4*v - x*(-1 + 0.1*x**2)"], [["0"], ["1"]], [[1.6]])


def line(drift, noise="1", **options):
    """dx = drift dt + noise dW."""
    return sf.SDE.from_expressions(["x"], [drift], [[noise]], **options)


def normal(variance, n=60):
    return sf.initialize(sf.Gaussian([0.0], [[variance]]), n)


def test_a_moment_between_two_readings_does_not_make_the_next_steps_as_short():
    sensor, config = sf.GaussianMeasurement([[1.0, 0.0]], [[0.2]]), sf.FilterConfig(target_error=0.1)
    flt, other = (sf.SPHFilter(WELLS, sensor, [1.0, 0.0], 0.3 * np.eye(2), config=config) for _ in range(2))
    usual = other.predict(8.0).n_steps
    for dt in (1.0, 1e-6):
        flt.predict(dt)
        flt.update(1.1)
    assert flt.predict(8.0).n_steps < 20 * usual  # 8,000,000 that a millionth of a second each would be


def distance(root, difference):
    return np.sqrt(np.mean((root @ difference) ** 2))


def against_kalman(n, R, seed, steps=8):
    """Rms error of mean and evidence over a record of a linear model, and what was estimated of both."""
    rng = np.random.default_rng(seed)
    model = sf.LinearSDE(-0.5 * np.eye(n) + 0.4 * rng.standard_normal((n, n)), noise=np.eye(n))
    sensor = sf.GaussianMeasurement(np.eye(1, n), [[R]])
    H, (F, _, Q), m, P = np.eye(1, n), model.discretize(0.4), np.zeros(n), np.eye(n)
    flt = sf.SPHFilter(model, sensor, m, P, n_particles=(100, 300, 600, 1000)[n - 1], config=CLOUD)
    x, rows = rng.standard_normal(n), []
    for _ in range(steps):
        x = F @ x + np.linalg.cholesky(Q) @ rng.standard_normal(n)
        z = H @ x + np.sqrt(R) * rng.standard_normal(1)
        m, P = F @ m, F @ P @ F.T + Q
        S, off = H @ P @ H.T + R, z - H @ m
        evidence = stats.norm.logpdf(off[0], scale=np.sqrt(S[0, 0]))
        K = P @ H.T / S
        m, P = m + K @ off, P - K @ H @ P
        flt.predict(0.4)
        info = flt.update(z)
        assert sf.Code.CLOUD in info.code and "on a cloud of" in info.status
        root = np.linalg.inv(np.linalg.cholesky(P))
        np.testing.assert_allclose(root @ flt.P @ root.T, np.eye(n), atol=0.1 + 4.0 * info.error)
        rows.append(
            (distance(root, flt.x - m), info.error, info.log_evidence - evidence, info.evidence_error)
        )
    return np.sqrt(np.mean(np.square(rows), axis=0))


@pytest.mark.parametrize("R", [1.0, 0.05])
@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_a_linear_model_is_right_within_the_errors_that_are_told(n, R):
    records = [against_kalman(n, R, seed) for seed in range(1, 25 if n < 3 else 13)]
    error, told, evidence, evidence_told = np.sqrt(np.mean(np.square(records), axis=0))
    assert told < 0.02
    assert told / 3.0 < error < 3.0 * told
    assert evidence_told / 4.0 < evidence < 3.0 * evidence_told


def test_no_clock_moves_a_cloud():
    """Where the clock begins changes nothing but rounding."""
    scenario, found = load_scenario("lorenz"), []
    start, Z = scenario.settings.start, draw_case(scenario, 1, 1).z
    for t0 in (0.0, 1024.0):
        about = {"x0": start.mean, "P0": start.cov, "t0": t0, "config": sf.FilterConfig(target_error=0.05)}
        flt = sf.SPHFilter(scenario.model, scenario.measurement, **about)
        flt.run(t0 + 0.25 * np.arange(1, 9), Z[:8])
        assert flt.density.cloud is not None
        found.append(np.append(flt.P.ravel(), flt.log_evidence))
    np.testing.assert_allclose(*found, rtol=1e-7)


@pytest.mark.parametrize("n", [1, 3])
def test_a_likelihood_a_ten_thousandth_as_wide_as_the_prior(n):
    records = [against_kalman(n, 1e-8, seed, steps=2) for seed in range(2, 10)]
    error, told, evidence, evidence_told = np.sqrt(np.mean(np.square(records), axis=0))
    assert error < 3.0 * told < 0.3
    assert evidence < 4.0 * evidence_told < 0.4


def test_two_wells_as_on_a_fine_lattice():
    start = sf.initialize(sf.Gaussian([3.0, 0.0], np.diag([0.2, 1.0])), 400)
    fine, _ = sf.predict(start, WELLS, 1.0, n_particles=4000)
    density, info = sf.predict(start, WELLS, 1.0, CLOUD)
    root = np.linalg.inv(np.linalg.cholesky(fine.cov()))
    assert distance(root, density.mean() - fine.mean()) < 3.0 * info.error < 0.03
    np.testing.assert_allclose(root @ density.cov() @ root.T, np.eye(2), atol=0.03)
    assert abs(density.entropy() - fine.entropy()) < 0.06
    assert abs(density.quantile(0, 0.9) - fine.quantile(0, 0.9)) < 0.05
    X = fine.mean() + np.array([[0.0, 0.0], [0.4, 0.2], [-0.5, 0.5]])
    np.testing.assert_allclose(density.pdf(X), fine.pdf(X), rtol=0.1)
    np.testing.assert_allclose(density.hpd_rank(X), fine.hpd_rank(X), atol=0.05)
    assert abs(density.hpd_region(0.9).volume / fine.hpd_region(0.9).volume - 1.0) < 0.15
    assert abs(density.probability(lambda X: X[:, 0] > 3) - fine.probability(lambda X: X[:, 0] > 3)) < 0.02
    assert abs(density.marginal([1]).mean()[0] - density.mean()[1]) < 1e-12
    assert distance(root, density.sample(4000, 1).mean(axis=0) - density.mean()) < 0.06
    assert fine.pdf(density.mode())[0] > 0.95 * fine.pdf(fine.mode())[0]


@pytest.mark.parametrize("drift, power", [("-sinh(x)", None), ("-x**5", 5)])
@pytest.mark.parametrize("variance", [1.0, 100.0])
def test_stiff_drifts_from_a_wide_start_come_in(drift, power, variance):
    def p(x):
        return np.exp(-2.0 * (np.cosh(x) - 1.0 if power is None else x**6 / 6.0))

    exact = integrate.quad(lambda x: x**2 * p(x), -6, 6)[0] / integrate.quad(p, -6, 6)[0]
    off, told = [], []
    for t in (4.0, 4.5, 5.0):  # one shadow may tell little by chance
        density, info = sf.predict(normal(variance), line(drift), t, CLOUD)
        assert info.mass_error == 0.0
        np.testing.assert_allclose(density.cov()[0, 0], exact, rtol=0.05)
        off, told = [*off, density.mean()[0] / np.sqrt(exact)], [*told, info.error]
    assert np.linalg.norm(off) < 2.0 * np.linalg.norm(told)


@pytest.mark.parametrize("target", [0.1, 0.01])
@pytest.mark.parametrize("rate, t", [(6.0, 3.0), (40.0, 0.8), (200.0, 3.0)])
def test_noise_of_the_state_beside_a_stiff_drift_has_its_variance(rate, t, target):
    """No mean is wrong however long the steps are; from d E[x²] = (-2 rate + .02) E[x²] dt + .04 dt."""
    model = sf.SDE.from_expressions(["x"], [f"-{rate}*x"], [["0.2*sqrt(1 + 0.5*x**2)"]])
    config = sf.FilterConfig(scheme="cloud", target_error=target)
    density, info = sf.predict(normal(4e-6), model, t, config, n_particles="auto")
    off = density.cov()[0, 0] * (2.0 * rate - 0.02) / 0.04 - 1.0
    assert abs(off) < min(0.05, 3.0 * info.variance_error)


@pytest.mark.parametrize("allowed", [1e-3, 1e-4])
def test_a_mild_drift_is_not_taken_for_stiff_by_chance(allowed):
    points = points_of_gaussian(np.array([1.0, 0.0]), np.diag([0.4, 1.0]), 512, 1)
    for t in np.arange(40.0):  # by the time go the keys, and so what few points show
        steps, bias, _ = chosen_steps(points, WELLS, (t, t + 2.0), Steps(4), (1, 20_000), allowed)
        assert bias.mean <= allowed and not steps.stiff


@pytest.mark.parametrize("high", [np.inf, 1.5])
def test_reflecting_walls_keep_the_stationary_density(high):
    model = line("-x - 0.5", domain=[("reflecting", 0.0, high)])
    start = sf.initialize(sf.Gaussian([0.5], [[0.04]]), 200, domain=model.domain)
    density, _ = sf.predict(start, model, 4.0, CLOUD)
    ends = 0.0, min(high, 8.0)
    total, first = (integrate.quad(lambda x, k=k: x**k * np.exp(-((x + 0.5) ** 2)), *ends)[0] for k in (0, 1))
    assert abs(density.mean()[0] - first / total) < 0.03 * np.sqrt(density.cov()[0, 0])
    assert density.x.min() >= 0.0 and density.x.max() <= high


def test_a_periodic_axis_goes_round():
    model = line("0.5", "0.4", domain=[("periodic", -np.pi, np.pi)])
    start = sf.initialize(sf.Gaussian([2.5], [[0.04]]), 200, domain=model.domain)
    density, info = sf.predict(start, model, 2.0, CLOUD)
    sd = np.sqrt(0.04 + 0.32)
    assert abs(density.mean()[0] - (3.5 - 2 * np.pi)) < 4.0 * info.error * sd
    np.testing.assert_allclose(density.pdf([3.5 - 2 * np.pi]), stats.norm.pdf(0, scale=sd), rtol=0.06)
    sensor = sf.GaussianMeasurement([[1.0]], [[0.05]], angles=[0])
    posterior, said = sf.update(density, sensor, [3.2], CLOUD)
    variance = 1.0 / (1.0 / sd**2 + 20.0)
    exact = variance * (3.5 / sd**2 + 3.2 * 20.0)
    off = (posterior.mean()[0] - exact + np.pi) % (2 * np.pi) - np.pi
    assert abs(off) < 4.0 * said.error * np.sqrt(variance)


def test_state_dependent_noise():
    start = sf.initialize(sf.Gaussian([1.0], [[0.1]]), 100)
    density, info = sf.predict(start, line("-x", "0.6*sqrt(1 + 0.5*x**2)"), 1.0, CLOUD)
    rate, source = -2.0 + 0.18, 0.36  # of the second moment
    second = (1.1 + source / rate) * np.exp(rate) - source / rate
    assert abs(density.mean()[0] - np.exp(-1.0)) < 4.0 * info.error * 0.46
    np.testing.assert_allclose(density.cov()[0, 0], second - np.exp(-2.0), rtol=0.03)


def test_the_same_density_gives_the_same_bits():
    start = sf.initialize(sf.Gaussian([3.0, 0.0], np.diag([0.2, 1.0])), 200)
    sensor = sf.GaussianMeasurement([[1.0, 0.0]], [[0.02]])
    density, _ = sf.predict(start, WELLS, 0.5, CLOUD)
    density, _ = sf.update(density, sensor, [3.1], CLOUD)
    again = from_bytes(to_bytes(density))
    assert again.read_out == "cloud" and again.error == density.error
    one, other = (sf.predict(d, WELLS, 0.5, CLOUD)[0] for d in (density, again))
    np.testing.assert_array_equal(one.x, other.x)
    np.testing.assert_array_equal(one.mass, other.mass)
    later = density.noted(cloud=density.cloud._replace(age=9))  # other numbers after as many predictions
    assert not np.array_equal(one.x, sf.predict(later, WELLS, 0.5, CLOUD)[0].x)


def test_a_model_that_blows_up_says_so_and_a_little_of_it_is_told():
    with pytest.raises(sf.PropagationError, match="blew up"):
        sf.predict(normal(1.0), line("x**3"), 1.0, CLOUD)
    density, info = sf.predict(normal(0.04), line("x**3", "0.3"), 1.0, CLOUD)
    assert 0.0 < info.mass_error < 0.05
    assert np.isfinite(density.cov()).all()


def test_a_point_that_blows_up_takes_no_other_with_it():
    escape = sf.FilterConfig(scheme=sf.CloudScheme(n_points=20_000))
    _, info = sf.predict(normal(0.08), line("x**3", "0.3"), 1.0, escape)
    rng = np.random.default_rng(5)
    x = np.sqrt(0.08) * rng.standard_normal(20_000)
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(1000):
            x += x**3 / 1000 + 0.3 * rng.standard_normal(len(x)) / np.sqrt(1000)
    assert abs(info.mass_error - (~np.isfinite(x)).mean()) < 0.004


def test_a_likelihood_of_zero_everywhere_is_refused():
    nowhere = sf.LikelihoodMeasurement(lambda z, X, t: np.full(len(X), -np.inf))
    with pytest.raises(sf.PropagationError, match="zero wherever"):
        sf.update(normal(1.0), nowhere, [0.0], CLOUD)


def test_a_box_finer_than_the_points_is_found():
    box = sf.LikelihoodMeasurement(lambda z, X, t: np.where(np.abs(X[:, 0] - z) < 1e-3, 0.0, -np.inf))
    many = sf.FilterConfig(scheme=sf.CloudScheme(n_points=20_000))
    density, info = sf.update(normal(1.0), box, 0.5, many)
    exact = np.log(np.diff(stats.norm.cdf([0.499, 0.501]))[0])
    assert abs(info.log_evidence - exact) < 0.1
    assert abs(density.mean()[0] - 0.5) < 1e-4


def test_what_the_default_refused_goes_on_as_a_cloud_and_says_so():
    density, info = sf.predict(normal(100.0), line("-x**5"), 1.0)
    assert sf.Code.CLOUD in info.code and "on a cloud" in info.status and density.read_out == "cloud"
    with pytest.raises(sf.PropagationError):
        sf.predict(normal(100.0), line("-x**5"), 1.0, goes_on=False)


def test_a_cloud_comes_back_to_a_lattice_that_holds_it():
    as_many = sf.FilterConfig(scheme=sf.CloudScheme(n_points=4096))  # as a lattice is laid on
    cloud, _ = sf.predict(normal(1.0), line("-x"), 0.5, as_many)
    density, info = sf.predict(cloud, line("-x"), 0.5, n_particles=60)
    assert info.scheme == "log_density" and density.field is not None
    exact = np.exp(-2.0) + 0.5 * (1.0 - np.exp(-2.0))
    np.testing.assert_allclose(density.cov()[0, 0], exact, rtol=0.05)


@pytest.mark.parametrize(
    ("readings", "R", "n_points"), [(4, 0.03, 20_000), (30, 0.3, 1024)], ids=["sharp", "many"]
)
def test_copies_of_few_points_are_not_taken_for_as_many(readings, R, n_points):
    """A state that hardly moves, read again and again: points that a reading left out do not come back.

    A cloud and its shadow tell half of that, and lineages of one reading no more; nor of many readings those
    of the last six.
    """
    model = sf.LinearSDE(np.zeros((3, 3)), noise=1e-3 * np.eye(3))
    sensors = [sf.GaussianMeasurement(np.eye(3)[[k]], [[R]]) for k in range(3)]
    config = sf.FilterConfig(scheme=sf.CloudScheme(n_points=n_points))
    off, told = [], []
    for seed in range(24):
        rng = np.random.default_rng(seed)
        flt = sf.SPHFilter(model, sensors[0], np.zeros(3), np.eye(3), n_particles=300, config=config)
        x, exact = rng.standard_normal(3), np.ones(3)
        mean = np.zeros(3)
        for k in (reading % 3 for reading in range(readings)):
            z = x[k] + np.sqrt(R) * rng.standard_normal()
            exact += 1e-6
            gain = exact[k] / (exact[k] + R)
            mean[k], exact[k] = mean[k] + gain * (z - mean[k]), (1.0 - gain) * exact[k]
            flt.predict(1.0)
            info = flt.update(z, sensors[k])
        off.append((flt.x - mean) / np.sqrt(exact))
        told.append(info.error)
    assert 0.7 < np.sqrt(np.mean(np.square(told)) / np.mean(np.square(off))) < 1.6


def test_steps_are_short_enough_for_the_narrowest_part_of_a_density():
    """A neuron that spikes or not: a reading leaves one branch, a ninth as wide as both, for which steps that
    were good for the mean of both were too long by .4 of its standard deviations.
    """
    scenario = load_scenario("fitzhugh_nagumo")
    case = draw_case(scenario, 1, 2)
    found = []
    clouds = [sf.FilterConfig(scheme=sf.CloudScheme(n_points=N)) for N in range(11_057, 12_000, 200)]
    for config, count in (sf.FilterConfig(scheme="log_density"), 800), *((c, 200) for c in clouds):
        given = {"t0": case.t0, "n_particles": count, "config": config}
        flt = sf.SPHFilter(scenario.model, scenario.measurement, case.x0, case.P0, **given)
        for t, z in zip(case.times[:2], case.z[:2], strict=True):
            flt.predict(t=t)
            info = flt.update(z)
        found.append((flt.x, flt.P, info.error))
    (x, P, _), *others = found
    off = [np.linalg.solve(np.linalg.cholesky(P), own - x) for own, *_ in others]
    assert np.sqrt(np.mean(np.square(off))) < 2.0 * np.sqrt(np.mean([told**2 for *_, told in others]))


@pytest.mark.parametrize("far", [8.0, 20.0])
def test_steps_are_short_enough_for_the_farthest_of_many_points(far):
    """A few dozen of 4,097 points do not see the one that their steps would throw out."""
    x = np.append(0.1 * stats.norm.ppf((np.arange(4096) + 0.5) / 4096), far)[:, None]
    points, span = Points(x, np.full(4097, 1.0 / 4097)), (0.0, 1.0)
    model = line("-x*(1 + 20*x**2/(25 + x**2))")
    steps, bias, _ = chosen_steps(points, model, span, Steps(4), (1, 10_000), 0.01)
    ends = moved_points(points, model, *span, steps, 4097, 1)
    assert bias.mean < 0.01 and not steps.stiff
    assert np.abs(ends.x).max() < 2.0  # 4 steps: 7e4 and 1e6


def test_steps_that_throw_points_out_are_seen_to_be_too_long():
    """Far points turn the faster, and one step would throw some of a hundred out to 1e14."""
    turn = "1 + 0.4*(x**2 + y**2)"
    drift = [f"-y*({turn})", f"x*({turn}) - 0.3*y"]
    model = sf.SDE.from_expressions(["x", "y"], drift, [["1", "0"], ["0", "1"]], np.diag([0.02, 0.05]))
    points = points_of_gaussian([1.5, 0.0], np.diag([1.0, 0.01]), 2048, 7)
    steps, bias, _ = chosen_steps(points, model, (0.0, 0.8), Steps(1), (1, 10_000), 0.005)
    assert 4 <= steps.number <= 200 and bias.mean <= 0.005
    coarse, fine = (moved_points(points, model, 0.0, 0.8, Steps(k), 2048, 7) for k in (steps.number, 400))
    (mean, cov), (true, P) = (moments(ends.x, ends.w) for ends in (coarse, fine))
    np.testing.assert_allclose(mean, true, atol=0.03)
    np.testing.assert_allclose(cov, P, atol=0.03)


@pytest.mark.parametrize("key", range(4))
def test_chance_of_noise_that_depends_on_the_state_is_no_bias(key):
    """Means are exact after steps of order two; points with a noise each would ask for 11 to 168."""
    model = sf.SDE.from_expressions(["x", "h"], ["0", "-0.5*(h + 1)"], [["exp(h/2)", "0"], ["0", "0.7"]])
    points = points_of_gaussian([0.0, -1.0], np.diag([0.1, 0.4]), 4096, key)
    steps, bias, _ = chosen_steps(points, model, (0.0, 0.5), Steps(1), (1, 10_000), 0.002)
    assert steps.number <= 10 and bias.mean <= 0.002 and not steps.stiff


def test_a_prediction_tells_what_it_leaves_of_the_error_before_it():
    """All of it where nothing moves (a fifth was told), and less of states that forget."""
    about = {"x0": [0.5, 0.0], "P0": 4.0 * np.eye(2), "config": sf.FilterConfig(target_error=0.1)}
    for rate, least, most in ((0.0, 0.9, 1.1), (3.0, 0.0, 0.8)):
        flt = sf.SPHFilter(sf.LinearSDE(-rate * np.eye(2), noise=rate * np.eye(2)), None, **about)
        for t, (a, b), z in ((0.01, (0.0, 0.0), 0.72), (0.02, (3.0, 0.0), 2.43)):
            flt.predict(t=t)
            text = f"sqrt((x - {a})**2 + (y - {b})**2)"
            told = flt.update([z], sf.GaussianMeasurement.from_expressions(["x", "y"], [text], [[4e-4]]))
        ahead = flt.predict(t=2.0)
        assert told.error > 0.05
        assert least * told.error <= ahead.error <= most * told.error
        assert ahead.variance_error >= np.sqrt(2.0) * ahead.error


def test_a_rate_that_some_points_make_too_fast_for_the_steps_loses_none_of_them():
    """Steps that its mean asks for throw out those of rates beyond e⁴, and half as long ones do, too."""
    model = sf.SDE.from_expressions(["x", "a"], ["-exp(a)*x", "0"], [["0.3"], ["0"]])
    start = sf.initialize(sf.Gaussian([0.0, 0.0], np.diag([0.5, 4.0])), 200)
    density, info = sf.predict(start, model, 0.5, sf.FilterConfig(scheme="cloud"))
    rates = np.exp(2.0 * stats.norm.ppf((np.arange(20_000) + 0.5) / 20_000))
    kept = np.exp(-2.0 * rates * 0.5)
    assert info.mass_error == 0.0
    assert density.cov()[0, 0] == pytest.approx(np.mean(0.5 * kept + 0.045 * (1.0 - kept) / rates), rel=0.03)
    assert density.cov()[1, 1] == pytest.approx(4.0, rel=0.01)
