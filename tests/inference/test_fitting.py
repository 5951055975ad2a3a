"""Parameters of largest evidence: against exact evidence, against a grid, and refusals."""

from types import SimpleNamespace

import numpy as np
import pytest
from density_cases import text
from oscillators import DUFFING, OSCILLATOR, POSITION, START, TIMES, exact, readings
from scipy.optimize import minimize

import sphfilter as sf
from reference_filters.grid import GridFilter
from reference_filters.kalman import KalmanFilter
from sphfilter.inference.quadratic import quadratic, roughness, step_for


@pytest.fixture(scope="module")
def z():
    return readings(OSCILLATOR, TIMES, START[0], 3)


def best(function, guess, h=1e-3):
    """Maximum of a smooth function by scipy, and its inverse negative Hessian by short differences."""
    found = minimize(
        lambda v: -function(v), guess, method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-9}
    )
    steps = h * np.eye(len(guess))
    hessian = [
        [
            sum(a * b * function(found.x + a * i + b * j) for a in (1, -1) for b in (1, -1)) / (4 * h * h)
            for j in steps
        ]
        for i in steps
    ]
    return found.x, np.linalg.inv(-np.array(hessian)), -found.fun


def test_estimates_and_errors_are_those_of_the_exact_evidence(z):
    """Within a twentieth of a standard error; standard errors and correlation within 2 %."""
    guess = {"k": 0.7, "s": 0.8}
    theta, covariance, value = best(
        lambda v: exact(dict(zip(guess, v, strict=True))).run(TIMES, z).log_evidence.sum(), [0.7, 0.8]
    )
    error = np.sqrt(np.diag(covariance))
    flt = sf.SPHFilter(OSCILLATOR, POSITION, *START)
    for filt in (exact, flt):
        fit = sf.fit_parameters(filt, TIMES, z, guess, bounds={"s": (1e-3, None)})
        assert fit.converged and fit.names == ("k", "s") and fit.at_bound == ()
        assert np.abs(np.array(list(fit.estimate.values())) - theta).max() < 0.05 * error.min()
        assert np.array(list(fit.standard_error.values())) == pytest.approx(error, rel=0.02)
        assert fit.correlation[0, 1] == pytest.approx(covariance[0, 1] / error.prod(), abs=0.02)
        assert fit.log_evidence == pytest.approx(value, abs=2e-3)
        assert fit.n_readings == 20
        assert fit.aic == pytest.approx(4 - 2 * fit.log_evidence)
        assert fit.bic == pytest.approx(2 * np.log(20) - 2 * fit.log_evidence)
    assert flt.t == 0.0 and dict(flt.model.parameters) == {"k": 1.0, "c": 0.4, "s": 1.2}


def test_duffing_has_its_maximum_where_the_grid_has_it():
    times = 2.0 * np.arange(1, 5)
    z = readings(DUFFING, times, [3.0, 0.0], 1)
    start = np.array([3.0, 0.0]), np.diag([0.2, 1.0])
    flt = sf.SPHFilter(DUFFING, POSITION, *start, n_particles=400)
    fit = sf.fit_parameters(flt, times, z, {"g": -0.8})
    by_default = sf.fit_parameters(sf.SPHFilter(DUFFING, POSITION, *start), times, z, {"g": -0.8})
    assert by_default.estimate["g"] == pytest.approx(fit.estimate["g"], abs=0.05 * fit.standard_error["g"])
    g, error = fit.estimate["g"], fit.standard_error["g"]

    def grid(value):
        filt = GridFilter(DUFFING.with_parameters(g=value), POSITION, *start, size=64)
        return filt.run(times, z).log_evidence.sum()

    low, middle, high = grid(g - 0.5 * error), grid(g), grid(g + 0.5 * error)
    curvature = (high - 2 * middle + low) / 0.25  # in standard errors: -1
    assert fit.log_evidence == pytest.approx(middle, abs=0.02)
    assert curvature == pytest.approx(-1.0, abs=0.05)
    assert abs((high - low) / curvature) < 0.1  # from its maximum, in standard errors


@pytest.mark.slow
def test_the_evidence_of_the_truth_is_as_far_below_as_it_should_be():
    """Twelve data sets: twice what the estimate has more than the truth is of chi square (Wilks)."""
    times, total = 2.0 * np.arange(1, 31), 0.0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        begin = rng.multivariate_normal([3.0, 0.0], np.diag([0.2, 1.0]))
        flt = sf.SPHFilter(DUFFING, POSITION, [3.0, 0.0], np.diag([0.2, 1.0]))
        z = readings(DUFFING, times, begin, rng)
        fit = sf.fit_parameters(flt, times, z, {"c": 0.5, "g": -0.8})
        total += 2.0 * (fit.log_evidence - flt.run(times, z).log_evidence.sum())
    assert 8.1 < total < 52.0  # 99.9 % of chi square of 24 degrees of freedom lies between


def test_anything_that_makes_a_filter_can_be_fitted(z):
    """Noise of the sensor; the filter refuses what is not positive, and the search goes on."""
    told = []

    def build(p):
        return KalmanFilter(OSCILLATOR, POSITION.changed(noise_cov=p["R"]), *START)

    fit = sf.fit_parameters(build, TIMES, z, {"R": 0.02}, report=lambda *args: told.append(args))
    theta, covariance, _ = best(lambda v: build({"R": v[0]}).run(TIMES, z).log_evidence.sum(), [0.2])
    assert fit.estimate["R"] == pytest.approx(theta[0], abs=0.05 * covariance[0, 0] ** 0.5)
    assert fit.standard_error["R"] == pytest.approx(covariance[0, 0] ** 0.5, rel=0.03)
    assert [n for n, *_ in told] == list(range(1, fit.n_evaluations + 1))
    assert max(value for *_, value in told) <= fit.log_evidence + 1e-9


def test_an_estimate_on_a_bound_says_so(z):
    free = sf.fit_parameters(exact, TIMES, z, {"k": 0.8, "c": 0.5})
    bound = free.estimate["c"] + 0.5 * free.standard_error["c"]
    held = sf.fit_parameters(exact, TIMES, z, {"c": bound + 0.2, "k": 0.8}, bounds={"c": (bound, None)})
    assert held.posterior().mean["c"] > bound
    assert held.at_bound == ("c",) and held.estimate["c"] == bound
    assert np.isnan(held.standard_error["c"]) and np.isfinite(held.standard_error["k"])
    assert "on a bound or very near it, without a standard error: c" in str(held)


def test_differences_stay_off_a_bound_where_the_filter_refuses():
    """Readings without noise: its estimate is within a standard error of zero, where there is no evidence."""
    truth = sf.simulate(OSCILLATOR, POSITION, x0=START[0], times=np.r_[0.0, TIMES], rng=2)[0][1:, :1]

    def build(p):
        return KalmanFilter(OSCILLATOR.with_parameters(s=p["s"]), POSITION.changed(noise_cov=p["R"]), *START)

    fit = sf.fit_parameters(build, TIMES, truth, {"R": 0.2, "s": 1.0}, bounds={"R": (0.0, None)})

    def of(v):
        return build({"R": abs(v[0]), "s": v[1]}).run(TIMES, truth).log_evidence.sum()

    theta, _, value = best(of, [0.01, 1.1])
    assert fit.converged and fit.at_bound == () and fit.log_evidence == pytest.approx(value, abs=1e-3)
    assert fit.estimate["R"] == pytest.approx(theta[0], abs=0.1 * fit.standard_error["R"])
    assert fit.standard_error["R"] > fit.estimate["R"]


def test_a_variance_whose_maximum_is_zero_is_flagged_and_not_refused():
    """Readings without noise, and no bounds: the filter refuses R <= 0, and R is next to zero."""
    model = sf.SDE.from_expressions(["x"], ["-a*x"], [["1"]], parameters={"a": 0.6})
    times, level = 0.4 * np.arange(1, 31), sf.GaussianMeasurement([[1.0]], [[0.1]])
    truth = sf.simulate(model, level, x0=[0.0], times=np.r_[0.0, times], rng=1)[0][1:]

    def build(p):
        return KalmanFilter(model, level.changed(noise_cov=p["R"]), [0.0], [[0.1]])

    for bounds in (None, {"R": (0.0, None)}):
        fit = sf.fit_parameters(build, times, truth, {"R": 0.1}, bounds=bounds)
        assert 0.0 < fit.estimate["R"] < 1e-3 and fit.at_bound == ("R",) and fit.converged
        limit = build({"R": 1e-9}).run(times, truth).log_evidence.sum()
        assert fit.log_evidence == pytest.approx(limit, abs=5e-3)
        assert ("the filter refuses values below zero of R" in fit.status) == (bounds is None)


def test_the_profile_of_a_gaussian_evidence_is_a_parabola():
    class Filter:
        """A filter whose evidence is a Gaussian of its parameters."""

        information = np.array([[4.0, 1.5, 0.0], [1.5, 1.0, 0.2], [0.0, 0.2, 9.0]])

        def __init__(self, p):
            self.off = np.array([p["a"] - 1.0, p["b"] + 2.0, p["c"] - 100.0])

        def run(self, times, z):
            value = -0.5 * self.off @ self.information @ self.off
            return SimpleNamespace(log_evidence=np.array([value]), accepted=np.array([True]))

    fit = sf.fit_parameters(Filter, [1.0], [[0.0]], {"a": 0.0, "b": -1.0, "c": 80.0})
    assert np.array(list(fit.estimate.values())) == pytest.approx([1.0, -2.0, 100.0], abs=1e-6)
    assert fit.covariance == pytest.approx(np.linalg.inv(Filter.information), rel=1e-6, abs=1e-8)
    values = fit.estimate["b"] + fit.standard_error["b"] * np.array([-2.0, 0.0, 1.0])
    profile = sf.profile_evidence(Filter, [1.0], [[0.0]], fit, "b", values)
    assert profile == pytest.approx([-2.0, 0.0, -0.5], abs=5e-3)
    with pytest.raises(sf.ModelError, match="no parameter 'd'"):
        sf.profile_evidence(Filter, [1.0], [[0.0]], fit, "d", values)


def test_parameters_that_the_measurements_do_not_determine_are_refused(z):
    drift = ["v", "-a*b*x - 0.4*v + 0*d"]
    redundant = text(["x", "v"], drift, [["0"], ["1.2"]], a=1.0, b=1.0, d=1.0)

    def build(p):
        return KalmanFilter(redundant.with_parameters(**p), POSITION, *START)

    with pytest.raises(sf.EstimationError, match=r"fall in the direction (1|0\.\d+) a -(1|0\.\d+) b;"):
        sf.fit_parameters(build, TIMES, z, {"a": 1.0, "b": 1.1})
    with pytest.raises(sf.EstimationError, match="do not determine 'd'"):
        sf.fit_parameters(build, TIMES, z, {"a": 1.0, "d": 1.0})


def test_wrong_arguments_are_refused_with_a_sentence(z):
    flt = sf.SPHFilter(OSCILLATOR, POSITION, *START)
    with pytest.raises(sf.ModelError, match=r"no parameter 'kk'.*did you mean 'k'"):
        sf.fit_parameters(flt, TIMES, z, {"kk": 1.0})
    with pytest.raises(sf.ModelError, match="as many measurements as times"):
        sf.fit_parameters(flt, TIMES, z[:-1], {"k": 1.0})
    with pytest.raises(sf.ModelError, match="guess is empty"):
        sf.fit_parameters(flt, TIMES, z, {})
    with pytest.raises(sf.ModelError, match=r"guess is \['k'\]; give the parameters"):
        sf.fit_parameters(flt, TIMES, z, ["k"])
    with pytest.raises(sf.ModelError, match="bounds name 'x'"):
        sf.fit_parameters(flt, TIMES, z, {"k": 1.0}, bounds={"x": (0, 1)})
    with pytest.raises(sf.ModelError, match="not within its bounds"):
        sf.fit_parameters(flt, TIMES, z, {"k": 1.0}, bounds={"k": (2, 3)})
    with pytest.raises(sf.EstimationError, match="refuses the guess"):
        sf.fit_parameters(exact, TIMES[::-1], z, {"k": 1.0})


def test_steps_follow_the_roughness_that_is_seen():
    rng = np.random.default_rng(0)

    def rough(v):
        return -0.5 * v @ v + 1e-3 * rng.standard_normal()

    seen = np.array([roughness(rough, np.zeros(2), 0.0, np.eye(2)) for _ in range(100)])
    assert np.sqrt(np.mean(seen**2)) == pytest.approx(1e-3, rel=0.2)
    h = step_for(1e-3)
    found = [quadratic(rough, np.zeros(2), 0.0, np.eye(2), h).hessian for _ in range(20)]
    assert np.mean(found, axis=0) == pytest.approx(-np.eye(2), abs=0.02)
    assert np.std(found, axis=0).max() < 0.03
    assert roughness(lambda v: -0.5 * v @ v, np.ones(2), -1.0, np.eye(2)) < 1e-12


def test_a_log_evidence_too_rough_for_its_curvature_says_so():
    rng = np.random.default_rng(1)

    class Filter:
        """A filter whose evidence is noisier than it is curved."""

        def __init__(self, p):
            self.value = -0.5 * p["a"] ** 2 - 5e-2 * p["b"] ** 2 + 0.5 * rng.standard_normal()

        def run(self, times, z):
            return SimpleNamespace(log_evidence=np.array([self.value]), accepted=np.array([True]))

    with pytest.raises(sf.EstimationError, match=r"rough by .* nat, too much to see"):
        sf.fit_parameters(Filter, [1.0], [[0.0]], {"a": 0.1, "b": 0.1})
