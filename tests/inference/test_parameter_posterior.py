"""Posteriors of parameters: against closed forms and sums over grids of the same log-evidence."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from density_cases import text
from scipy import stats

import sphfilter as sf
from reference_filters.kalman import KalmanFilter

PUSHED = text(["x"], ["b - a*x"], [["1"]], a=0.6, b=0.5)
LEVEL = sf.GaussianMeasurement([[1.0]], [[0.1]])
START = np.zeros(1), np.array([[0.5]])
TIMES = 0.4 * np.arange(1, 16)
LOWEST = {"R": (0.0, None)}


def drawn(seed):
    return sf.simulate(PUSHED, LEVEL, x0=[0.0], times=TIMES, rng=seed)[1]


class Exact(SimpleNamespace):
    """Kalman's filter of one state with parameters a and b of the model, and R of the sensor."""

    def run(self, times, z):
        decay, mean, P, found = np.exp(-self.a * np.diff(times, prepend=0.0)), 0.0, 0.5, []
        for phi, (read,) in zip(decay.tolist(), np.asarray(z).tolist(), strict=True):
            mean = phi * mean + self.b * (1.0 - phi) / self.a
            P = phi * phi * P + (1.0 - phi * phi) / (2.0 * self.a)
            S, off = P + self.R, read - mean
            found.append(-0.5 * (off * off / S + math.log(2.0 * math.pi * S)))
            mean, P = mean + P / S * off, P * self.R / S
        return SimpleNamespace(log_evidence=np.array(found))


def exact(p):
    return Exact(**{"a": 0.6, "b": 0.5, "R": 0.1} | p)


def evidence(z, **p):
    return exact(p).run(TIMES, z).log_evidence.sum()


def on_grid(values, log_p):
    """Mean, deviation, quantiles .05, .5 and .95 and the log of the integral, of evenly spaced values."""
    w = np.exp(log_p - log_p.max())
    total = log_p.max() + np.log(w.sum() * (values[1] - values[0]))
    w /= w.sum()
    mean = w @ values
    quantiles = np.interp([0.05, 0.5, 0.95], np.cumsum(w) - 0.5 * w, values)
    return mean, np.sqrt(w @ (values - mean) ** 2), quantiles, total


@pytest.fixture(scope="module")
def z():
    return drawn(3)


def test_what_it_is_held_against_is_kalmans_filter(z):
    known = KalmanFilter(PUSHED, LEVEL, *START).run(TIMES, z).log_evidence
    np.testing.assert_allclose(exact({}).run(TIMES, z).log_evidence, known, rtol=1e-12)


@pytest.fixture(scope="module")
def noise(z):
    """A fit of the sensor's noise, and the log-evidence on a grid."""
    R = np.linspace(2e-3, 4.0, 600)
    fit = sf.fit_parameters(exact, TIMES, z, {"R": 0.2}, bounds={"R": (0.0, 4.0)})
    return fit, R, np.array([evidence(z, R=r) for r in R])


def test_of_a_quadratic_log_evidence_it_is_the_gaussian_of_the_fit(z):
    """And with a Gaussian before, the product of the two."""
    fit = sf.fit_parameters(exact, TIMES, z, {"b": 0.3})
    posterior = fit.posterior()
    b, error = fit.estimate["b"], fit.standard_error["b"]
    assert posterior.mean["b"] == pytest.approx(b, abs=0.03 * error)
    assert posterior.standard_deviation["b"] == pytest.approx(error, rel=0.03)
    low, middle, high = posterior.quantile("b", [0.05, 0.5, 0.95])
    assert np.array([low, middle, high]) == pytest.approx(
        b + error * stats.norm.ppf([0.05, 0.5, 0.95]), abs=0.1 * error
    )
    assert np.isnan(posterior.log_evidence) and not posterior.flagged
    told = fit.posterior({"b": stats.norm(b + 2 * error, 0.5 * error)})
    assert told.mean["b"] == pytest.approx(b + 1.6 * error, abs=0.03 * error)
    assert told.standard_deviation["b"] == pytest.approx(error / np.sqrt(5), rel=0.05)
    wide = np.sqrt(1.25) * error
    averaged = fit.log_evidence + np.log(error * np.sqrt(2 * np.pi)) + stats.norm(0, wide).logpdf(2 * error)
    assert told.log_evidence == pytest.approx(averaged, abs=0.03)


def test_noise_of_a_sensor_is_skewed_as_on_a_grid(noise):
    fit, R, log_p = noise
    posterior = fit.posterior()
    mean, deviation, quantiles, total = on_grid(R, log_p)
    assert abs(mean - fit.estimate["R"]) > 0.3 * deviation  # no Gaussian about the estimate
    assert posterior.mean["R"] == pytest.approx(mean, abs=3 * posterior.mean_error["R"])
    assert posterior.mean_error["R"] < 0.05 * deviation
    assert posterior.standard_deviation["R"] == pytest.approx(deviation, rel=0.1)
    assert posterior.quantile("R", [0.05, 0.5, 0.95]) == pytest.approx(quantiles, abs=0.08 * deviation)
    above = np.exp(log_p - log_p.max()) @ (R > 0.2) / np.exp(log_p - log_p.max()).sum()
    assert posterior.probability(lambda p: p["R"] > 0.2) == pytest.approx(above, abs=0.02)
    assert posterior.log_evidence == pytest.approx(total - np.log(4.0), abs=3 * posterior.log_evidence_error)
    assert posterior.log_evidence_error < 0.05
    assert posterior.weights.sum() == pytest.approx(1.0) and posterior.draws.min() > 0.0
    assert np.array_equal(fit.posterior().draws, posterior.draws)


@pytest.mark.parametrize("as_function", [False, True])
def test_what_was_known_before_counts(noise, as_function):
    fit, R, log_p = noise
    before = stats.gamma(3.0, scale=0.05)
    posterior = fit.posterior((lambda p: before.logpdf(p["R"])) if as_function else {"R": before})
    mean, deviation, quantiles, total = on_grid(R, log_p + before.logpdf(R))
    assert posterior.mean["R"] == pytest.approx(mean, abs=0.05 * deviation)
    assert posterior.standard_deviation["R"] == pytest.approx(deviation, rel=0.05)
    assert posterior.quantile("R", [0.05, 0.5, 0.95]) == pytest.approx(quantiles, abs=0.08 * deviation)
    assert posterior.log_evidence == pytest.approx(total, abs=0.03)


@pytest.mark.slow
def test_two_parameters_as_on_a_grid(z):
    fit = sf.fit_parameters(exact, TIMES, z, {"R": 0.2, "b": 0.4}, bounds=LOWEST)
    R, b = np.linspace(5e-3, 2.5, 100), np.linspace(-1.5, 2.5, 20)
    log_p = np.array([[evidence(z, R=r, b=c) for c in b] for r in R])
    posterior = fit.posterior()
    w = np.exp(log_p - log_p.max())
    for name, values, weight in (("R", R, w.sum(axis=1)), ("b", b, w.sum(axis=0))):
        mean, deviation, quantiles, _ = on_grid(values, np.log(weight))
        assert posterior.mean[name] == pytest.approx(mean, abs=0.1 * deviation)
        assert posterior.standard_deviation[name] == pytest.approx(deviation, rel=0.1)
        assert posterior.quantile(name, [0.05, 0.5, 0.95]) == pytest.approx(quantiles, abs=0.2 * deviation)
    both = (w * (R[:, None] * b > 0.2)).sum() / w.sum()
    assert posterior.probability(lambda p: p["R"] * p["b"] > 0.2) == pytest.approx(both, abs=0.03)
    mean = np.array([w.sum(axis=1) @ R, w.sum(axis=0) @ b]) / w.sum()
    product = (R - mean[0]) @ w @ (b - mean[1]) / w.sum()
    assert posterior.covariance[0, 1] == pytest.approx(
        product, abs=0.1 * np.sqrt(np.diag(fit.covariance)).prod()
    )


@pytest.mark.parametrize("off", [-0.7, 0.1, 1.0])
def test_a_bound_cuts_it(z, off):
    """Half Gaussians, from standard errors beside the maximum on: the fit is on the bound, or inside."""
    free = sf.fit_parameters(exact, TIMES, z, {"b": 0.3})
    b, error = free.estimate["b"], free.standard_error["b"]
    cut = sf.fit_parameters(exact, TIMES, z, {"b": b + 2 * error}, bounds={"b": (b + off * error, None)})
    posterior, known = cut.posterior(), stats.truncnorm(off, np.inf, b, error)
    assert (cut.at_bound == ("b",)) == (off > 0)
    assert posterior.mean["b"] == pytest.approx(known.mean(), abs=0.05 * known.std())
    assert posterior.standard_deviation["b"] == pytest.approx(known.std(), rel=0.05)
    assert posterior.quantile("b", 0.05) == pytest.approx(known.ppf(0.05), abs=0.03 * known.std())
    assert posterior.draws.min() >= b + off * error


@pytest.mark.slow
def test_errors_are_told_as_large_as_they_are():
    """Of means, and of the averaged evidence, over sixteen records; some fits end on the bound."""
    a, off = np.linspace(0.0, 6.0, 300), []
    for seed in range(16):
        z = drawn(seed)
        fit = sf.fit_parameters(exact, TIMES, z, {"a": 0.5}, bounds={"a": (0.0, 6.0)})
        posterior = fit.posterior()
        mean, deviation, _, total = on_grid(a, np.array([evidence(z, a=one) for one in a]))
        made = (posterior.mean["a"] - mean) / deviation, posterior.log_evidence - total + np.log(6.0)
        off.append([*made, posterior.mean_error["a"] / deviation, posterior.log_evidence_error])
    made, told = np.split(np.sqrt(np.mean(np.square(off), axis=0)), 2)
    assert np.all((told / made > 0.5) & (told / made < 2.0))


def test_it_says_how_far_it_is_and_what_came_of_it(z):
    told = []
    fit = sf.fit_parameters(exact, TIMES, z, {"R": 0.2}, bounds=LOWEST)
    before = fit.n_evaluations
    posterior = fit.posterior(n_draws=64, report=lambda *args: told.append(args))
    assert [n for n, *_ in told] == list(range(1, len(told) + 1)) and len(told) <= 64
    assert set(told[0][1]) == {"R"} and fit.n_evaluations == before
    assert "draws are effective" in posterior.status and str(posterior).startswith("R = ")
    assert repr(posterior).startswith("ParameterPosterior(R = ") and "\n" not in repr(posterior)
    far = fit.posterior({"R": stats.norm(fit.estimate["R"] * 60, 1e-3)}, n_draws=64)
    assert far.flagged and "too few to be relied on" in far.status


def test_wrong_arguments_are_refused_with_a_sentence(noise):
    fit = noise[0]
    with pytest.raises(sf.ModelError, match=r"the fit has no parameter 'RR' \(did you mean 'R'"):
        fit.posterior({"RR": stats.norm()})
    with pytest.raises(sf.ModelError, match="the prior of 'R' needs a logpdf"):
        fit.posterior({"R": 0.2})
    with pytest.raises(sf.ModelError, match="prior maps names to distributions"):
        fit.posterior(0.2)
    with pytest.raises(sf.ModelError, match="n_draws must be a whole number of at least 64, got 10"):
        fit.posterior(n_draws=10)
    with pytest.raises(sf.EstimationError, match="none of 512 draws"):
        fit.posterior(lambda p: -np.inf, n_draws=512)
    posterior = fit.posterior(n_draws=64)
    with pytest.raises(sf.ModelError, match="the posterior has no parameter 'Q'"):
        posterior.quantile("Q", 0.5)
    with pytest.raises(sf.ModelError, match="between 0 and 1"):
        posterior.quantile("R", 1.0)


def test_it_is_drawn(z):
    pytest.importorskip("matplotlib").use("Agg")
    guess = {"R": 0.2, "b": 0.4, "a": 0.5}
    fit = sf.fit_parameters(exact, TIMES, z, guess, bounds=LOWEST)
    posterior = fit.posterior(n_draws=128)
    assert posterior.plot("R").get_xlabel() == "R"
    assert posterior.plot(["R", "b"]).get_ylabel() == "b"
    assert posterior.plot().shape == (3, 3)
