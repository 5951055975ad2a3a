"""Particle filter against the Kalman filter and the laws of resampling."""

import numpy as np
import pytest
from density_cases import whitened
from filterpy.monte_carlo import systematic_resample
from referee_cases import OSCILLATOR, P0, POSITION, X0
from scipy.special import logsumexp

from reference_filters._weights import ancestors, condition
from reference_filters.kalman import KalmanFilter
from reference_filters.particle import ParticleFilter
from sphfilter import consistency
from sphfilter.density.moments import moments
from sphfilter.errors import ModelError, PropagationError
from sphfilter.model.likelihood import LikelihoodMeasurement
from sphfilter.model.measurements import GaussianMeasurement
from sphfilter.model.sde import SDE

TIMES, READINGS = [0.0, 0.8, 0.8, 2.0, 3.0], [[1.5], [0.4], [0.7], None, [-1.9]]
MODES = ["always", "ess"]


def _filter(mode="always", n=1000, rng=1, measurement=POSITION, **options):
    return ParticleFilter(OSCILLATOR, measurement, X0, P0, n_particles=n, rng=rng, resampling=mode, **options)


@pytest.mark.parametrize("mode", MODES)
def test_many_particles_give_the_kalman_answer(mode):
    n = 40_000
    exact = KalmanFilter(OSCILLATOR, POSITION, X0, P0)
    result, truth = _filter(mode, n).run(TIMES, READINGS), exact.run(TIMES, READINGS)
    # five standard errors of a mean, of a log-weight average, of a covariance, for an effective n / 4
    noise = 5 / np.sqrt(n / 4)
    assert consistency.distance(result.x, truth.x, truth.P).max() < noise
    assert np.abs(whitened(result.P, truth.P)).max() < 2 * noise
    np.testing.assert_allclose(result.log_evidence, truth.log_evidence, atol=2 * noise)
    assert result.log_evidence[3] == 0.0


@pytest.mark.parametrize("mode", MODES)
def test_evidence_is_unbiased(mode):
    """E[Ẑ] = Z for any number of particles (Del Moral 2004): wrong bookkeeping of the weights shows here."""
    exact = KalmanFilter(OSCILLATOR, POSITION, X0, P0)
    exact.run(TIMES, READINGS)
    rng = np.random.default_rng(3)
    ratios = []
    for _ in range(300):
        filt = _filter(mode, 30, rng)
        filt.run(TIMES, READINGS)
        ratios.append(np.exp(filt.log_evidence - exact.log_evidence))
    error = np.std(ratios) / np.sqrt(len(ratios))
    assert error < 0.05
    assert abs(np.mean(ratios) - 1.0) < 4 * error


def test_an_outlier_does_not_underflow():
    filt = _filter()
    info = filt.update([400.0])
    assert np.isfinite(info.log_evidence)
    assert info.log_evidence < -1e5
    assert filt.weights.sum() == pytest.approx(1.0)
    assert np.isfinite(filt.x).all()


def test_an_impossible_measurement_is_refused_and_changes_nothing():
    positive = LikelihoodMeasurement(lambda z, X, t: np.where(X[:, 0] > z[0], 0.0, -np.inf), dim_z=1)
    filt = _filter(measurement=positive)
    x = filt.x.copy()
    filt.update([0.0])
    assert (filt.particles[filt.weights > 0, 0] > 0).all()
    assert filt.log_evidence == pytest.approx(np.log(0.92), abs=0.05)
    x, evidence = filt.x.copy(), filt.log_evidence
    with pytest.raises(PropagationError, match="no density"):
        filt.update([1e6])
    np.testing.assert_array_equal(filt.x, x)
    assert filt.log_evidence == evidence


def test_ess_resamples_only_when_weights_have_degenerated():
    filt = _filter("ess", 2000)
    filt.update([1.0], measurement=GaussianMeasurement(h=[[1.0, 0.0]], noise_cov=[[50.0]]))
    assert filt.effective_size > 1000
    filt.predict(0.1)
    assert np.ptp(filt.weights) > 0
    filt.update([2.5], measurement=GaussianMeasurement(h=[[1.0, 0.0]], noise_cov=[[0.01]]))
    assert filt.effective_size < 1000
    filt.predict(0.1)
    assert np.ptp(filt.weights) == 0


def test_resampling_is_that_of_filterpy():
    rng = np.random.default_rng(5)
    for k in range(50):
        w = rng.exponential(size=500) ** 3
        w[[0, 7, 499]] = 0.0
        w /= w.sum()
        out = np.empty(500, np.int64)
        np.random.seed(k)  # noqa: NPY002
        ancestors(w, np.random.random(), out)  # noqa: NPY002
        np.random.seed(k)  # noqa: NPY002
        np.testing.assert_array_equal(out, systematic_resample(w))


@pytest.mark.parametrize("u", [0.0, 0.5, 1.0 - 1e-16])
def test_resampling_survives_rounding(u):
    w = np.full(1000, (1 - 1e-9) / 1000)
    w[-3:] = w[:2] = 0.0
    out = np.empty(1000, np.int64)
    ancestors(w, u, out)
    assert out.min() >= 2
    assert out.max() <= 996


def test_conditioning_and_moments():
    rng = np.random.default_rng(6)
    X, log_likelihood = rng.standard_normal((77, 3)), rng.normal(-2000.0, 3.0, 77)
    log_likelihood[5] = -np.inf
    prior = rng.dirichlet(np.ones(77))
    log_w, w = np.log(prior), np.empty(77)
    log_evidence = condition(log_w, log_likelihood, w)
    assert log_evidence == pytest.approx(logsumexp(np.log(prior) + log_likelihood), rel=1e-13)
    np.testing.assert_allclose(w, np.exp(np.log(prior) + log_likelihood - log_evidence), rtol=1e-9)
    np.testing.assert_allclose(np.exp(log_w), w, rtol=1e-9)
    mean, cov = moments(X, w)
    np.testing.assert_allclose(mean, np.average(X, axis=0, weights=w), rtol=1e-12)
    np.testing.assert_allclose(cov, np.cov(X.T, aweights=w, bias=True), rtol=1e-12)


@pytest.mark.parametrize("bad", [-np.inf, np.nan])
def test_conditioning_on_the_impossible_changes_nothing(bad):
    log_w, w = np.zeros(4), np.empty(4)
    assert not np.isfinite(condition(log_w, np.full(4, bad), w))
    np.testing.assert_array_equal(log_w, 0.0)


def test_threads_do_not_change_a_run():
    runs = [_filter(n=6000, n_threads=n).run(TIMES, READINGS) for n in (1, 2)]
    np.testing.assert_array_equal(runs[0].x, runs[1].x)


def test_the_seed_decides_everything():
    runs = [_filter(rng=seed).run(TIMES, READINGS) for seed in (4, 4, 5)]
    np.testing.assert_array_equal(runs[0].x, runs[1].x)
    assert not np.array_equal(runs[0].x, runs[2].x)


def test_a_blow_up_leaves_the_filter_as_it_was():
    runaway = SDE(lambda x, t: (x[0] ** 3,), 1, noise=[[1.0]], spectral_density=[[0.1]])
    filt = ParticleFilter(runaway, None, [2.0], [[0.1]], n_particles=50, rng=0)
    particles = filt.particles.copy()
    with pytest.raises(PropagationError, match="blew up"):
        filt.predict(3.0)
    assert filt.t == 0.0
    np.testing.assert_array_equal(filt.particles, particles)


def test_unknown_resampling_is_named():
    with pytest.raises(ModelError, match="did you mean 'always'"):
        _filter("alway")


def test_other_orders_are_refused():
    with pytest.raises(ModelError, match="order must be 2 or 4, got 3"):
        _filter(order=3)
