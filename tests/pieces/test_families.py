"""A few families as a density: windows, Bayes' rule, bent flows; against closed forms and many points."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import logsumexp

import sphfilter as sf
from sphfilter.density.as_family import families_density, family_density
from sphfilter.density.families import Families, families_of, merged_families
from sphfilter.density.families_posterior import families_posterior, split
from sphfilter.density.family import gaussian_family
from sphfilter.density.storage import from_bytes, to_bytes
from sphfilter.prediction.families import carried_families

COV = np.array([[0.5, 0.1, 0.05], [0.1, 0.4, 0.1], [0.05, 0.1, 0.3]])
START = sf.initialize(sf.Gaussian(np.array([0.0, 0.0, 0.5]), COV), "auto")
ONE = gaussian_family(np.array([0.0, 0.0, 0.5]), COV, 5)
TURNS = sf.SDE.from_expressions(
    states=["x", "y", "a"],
    drift=["cos(a)", "sin(a)", "0"],
    noise=np.eye(3).astype(str).tolist(),
    spectral_density=np.diag([0.05, 0.05, 0.1]),
)


def parts():
    return split(families_of(ONE), 0, lambda X: TURNS.drift(X, 0.0), 5, 1e-3)


def some_states(count=200):
    return np.random.default_rng(0).multivariate_normal(ONE.mu, COV, size=count)


def test_windows_split_a_family_into_narrower_ones_whose_sum_it_is():
    found, off = parts()
    assert 5 <= len(found.log_w) <= 9 and off < 0.01
    assert found.w.sum() == pytest.approx(1.0, abs=1e-12)
    near = some_states()[np.linalg.norm(some_states() - ONE.mu, axis=1) < 1.2]
    np.testing.assert_allclose(found.log_p(near), ONE.log_p(near), atol=0.01)
    assert np.ptp(found.mu[:, 2]) > 2.0 * np.sqrt(COV[2, 2])  # along the heading, which alone bends
    assert np.linalg.norm(found.A, axis=2)[:, 2].max() < 0.7 * np.sqrt(COV[2, 2])
    _, mean, cov = found.looked_at().together(found.log_w)
    np.testing.assert_allclose(mean, ONE.mu, atol=2e-3)
    np.testing.assert_allclose(cov, COV, atol=5e-3)


def test_what_a_window_split_is_gathered_again():
    found, _ = parts()
    again, off = merged_families(found, 0.02, 0.1)
    assert len(again.log_w) == 1 and off < 0.01
    off = again.one(0).log_p(some_states()) - ONE.log_p(some_states())
    assert np.sqrt(np.mean(off**2)) < 0.04
    far = Families(
        np.log([0.5, 0.5]), np.array([[0.0] * 3, [9.0] * 3]), np.array([ONE.A] * 2), np.array([ONE.c] * 2)
    )
    assert len(merged_families(far, 0.02, 0.1)[0].log_w) == 2


def test_a_linear_reading_of_gaussians_is_exact():
    w, shifts = np.array([0.5, 0.3, 0.2]), np.array([[0.0, 0.0, 0.0], [1.0, -1.0, 0.5], [-2.0, 0.0, 0.3]])
    fams = [gaussian_family(ONE.mu + s, COV, 4) for s in shifts]
    prior = Families(np.log(w), *(np.array(part) for part in zip(*fams, strict=True)))
    H, R, z = np.array([[1.0, 0.5, 0.0]]), 0.2, 0.7

    def weight(X):
        return -0.5 * (z - X @ H[0]) ** 2 / R - 0.5 * np.log(2.0 * np.pi * R)

    found = families_posterior(prior, weight, 1e-6)
    S = (H @ COV @ H.T).item() + R
    off = z - (ONE.mu + shifts) @ H[0]
    log_w = np.log(w) - 0.5 * off**2 / S - 0.5 * np.log(2.0 * np.pi * S)
    gain = COV @ H[0] / S
    means, cov = ONE.mu + shifts + off[:, None] * gain, COV - np.outer(gain, gain) * S
    share = np.exp(log_w - logsumexp(log_w))
    mean = share @ means
    away = means - mean
    assert found.log_evidence == pytest.approx(logsumexp(log_w), abs=1e-3)
    _, own_mean, own_cov = found.families.looked_at().together(found.families.log_w)
    np.testing.assert_allclose(own_mean, mean, atol=2e-3)
    np.testing.assert_allclose(own_cov, cov + (share[:, None] * away).T @ away, atol=3e-3)
    assert found.error < 0.01 and found.evidence_error < 0.01


def test_a_flow_that_bends_is_followed():
    """Means and variances of x and y in closed form: the heading is a Gaussian at all times."""
    density = family_density(START, ONE, gaussian=False)
    t1, m, P, q = 2.0, 0.5, COV[2, 2], 0.1
    moved, info = carried_families(density, TURNS, t1, 0.02, 1e7)
    damp = quad(lambda s: np.exp(-0.5 * (P + q * s)), 0.0, t1)[0]
    mean, std = moved.mean(), np.sqrt(np.diag(moved.cov()))
    exact = np.array([np.cos(m) * damp, np.sin(m) * damp, m])
    assert np.abs((mean - exact) / std).max() < 0.02
    # Cov(a_t, x_t) = Cov(a_0, x_0) - sin(m) int (P + q s) exp(-(P + q s)/2) ds
    slope = quad(lambda s: (P + q * s) * np.exp(-0.5 * (P + q * s)), 0.0, t1)[0]
    assert moved.cov()[2, 0] == pytest.approx(COV[2, 0] - np.sin(m) * slope, abs=0.02 * std[0] * std[2])
    assert moved.cov()[2, 2] == pytest.approx(P + q * t1, rel=0.02)
    assert info.rung == "pieces" and info.error < 0.06 and info.n_steps > 0
    with pytest.raises(sf.PropagationError, match="more families"):
        carried_families(density, TURNS, t1, 0.02, 1e4)


def test_questions_and_files():
    moved, _ = carried_families(family_density(START, ONE, gaussian=False), TURNS, 2.0, 0.02, 1e7)
    X = some_states(50)
    each = [np.exp(w) * np.exp(moved.families.one(k).log_p(X)) for k, w in enumerate(moved.families.log_w)]
    np.testing.assert_allclose(moved.pdf(X), np.sum(each, axis=0), rtol=1e-10)
    again = from_bytes(to_bytes(moved))
    assert np.array_equal(again.pdf(X), moved.pdf(X)) and np.array_equal(again.mass, moved.mass)
    states, w = moved.form.states(16, True)
    root = np.linalg.inv(np.linalg.cholesky(moved.cov()))
    np.testing.assert_allclose(root @ (w @ states - moved.mean()), 0.0, atol=0.03)
    assert moved.marginal([2]).cov().item() == pytest.approx(moved.cov()[2, 2], rel=0.02)
    alone = families_density(moved, families_of(ONE))
    assert alone.read_out == "family" and alone.families is None


def test_bent_readings_of_families_agree_with_many_points():
    found, _ = parts()
    z, noise = 0.9, 0.2

    def weight(X):
        return -0.5 * ((z - np.hypot(X[:, 0] + 2.0, X[:, 1])) / noise) ** 2

    posterior = families_posterior(found, weight, 1e-6)
    X = np.random.default_rng(1).multivariate_normal(ONE.mu, COV, size=400_000)
    w = np.exp(weight(X))
    assert posterior.log_evidence == pytest.approx(np.log(w.mean()), abs=0.03)
    mean = w @ X / w.sum()
    own = posterior.families.looked_at().together(posterior.families.log_w)[1]
    assert np.abs(own - mean).max() < 0.03
