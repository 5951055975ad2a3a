"""Lattices that follow a level set, and posteriors laid on them, against quadrature and Kalman's formulae."""

import numpy as np
import pytest
from density_cases import whitened
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, norm

import sphfilter as sf
from sphfilter import consistency
from sphfilter.density.distributions import gaussian_log_pdf
from sphfilter.errors import PropagationError
from sphfilter.lattice.field import log_p_at
from sphfilter.lattice.level_set import fewest_particles, gaussian_volume, lay

COV = {
    1: np.array([[0.3]]),
    2: np.array([[2.0, -0.9], [-0.9, 0.5]]),
    3: np.array([[1.0, 0.5, 0.0], [0.5, 2.0, -0.3], [0.0, -0.3, 0.1]]),
    4: np.diag([1.0, 4.0, 0.01, 2.0]) + 0.05,
}
COUNTS = {1: 100, 2: 200, 3: 400, 4: 800}


def gaussian(n, N=None, mean=None, cov=None):
    mean = np.arange(1.0, n + 1.0) if mean is None else np.asarray(mean, float)
    return sf.initialize(sf.Gaussian(mean, COV[n] if cov is None else cov), N or COUNTS[n])


def off(density, mean, cov):
    """Error of the whitened mean, and largest of the whitened covariance."""
    return consistency.distance(density.mean(), mean, cov), np.abs(whitened(density.cov(), cov)).max()


@pytest.mark.parametrize("n", COV)
def test_a_gaussian_on_its_lattice(n):
    p = gaussian(n)
    assert 0.5 * COUNTS[n] <= p.n_particles <= COUNTS[n]
    assert p.mass.sum() == pytest.approx(1.0, abs=1e-12)
    assert max(off(p, np.arange(1.0, n + 1.0), COV[n])) < 1e-3
    exact = multivariate_normal(np.arange(1.0, n + 1.0), COV[n])
    assert np.allclose(p.log_density, exact.logpdf(p.x), atol=1e-3)
    radius = consistency.distance(p.x, p.mean(), COV[n]).max()
    assert gaussian_volume(n, 0.5) == pytest.approx({1: 2, 2: np.pi, 3: 4 * np.pi / 3, 4: np.pi**2 / 2}[n])
    assert p.volume == pytest.approx(gaussian_volume(n, 0.5 * radius**2), rel=0.35)


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_tail_and_integral_of_a_gaussian(n):
    p = gaussian(n)
    exact = multivariate_normal(p.mean(), COV[n])
    root, rng = np.linalg.cholesky(COV[n]), np.random.default_rng(n)
    direction = rng.normal(size=(20, n))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    for sigma in (6.0, 12.0, 40.0):
        X = p.mean() + sigma * direction @ root.T
        assert np.allclose(p.logpdf(X), exact.logpdf(X), rtol=0.02)
    if n <= 2:
        u = np.linspace(-7, 7, 281)
        z = np.stack(np.meshgrid(*[u] * n, indexing="ij"), axis=-1).reshape(-1, n)
        total = p.pdf(p.mean() + z @ root.T).sum() * (u[1] - u[0]) ** n * np.prod(np.diag(root))
        assert total == pytest.approx(1.0, abs=1e-3)


def bimodal(X):
    """0.7 N(-4, 0.25 I) + 0.3 N(4, 1.0 I), two states."""
    parts = [np.log(w) + gaussian_log_pdf(np.full(2, m), s * np.eye(2))(X) for w, m, s in PARTS]
    return logsumexp(parts, axis=0)


PARTS = [(0.7, -4.0, 0.25), (0.3, 4.0, 1.0)]


def test_pieces_without_a_bridge():
    mean = sum(w * np.full(2, m) for w, m, _ in PARTS)
    cov = sum(w * (s * np.eye(2) + np.full((2, 2), m * m)) for w, m, s in PARTS) - np.outer(mean, mean)
    laid = lay(bimodal, mean, np.linalg.cholesky(cov), np.array([[-4.0, -4.0], [4.0, 4.0]]), 600, 8.0)
    assert laid.log_mass == pytest.approx(0.0, abs=1e-3)
    upper = laid.x.sum(axis=1) > 0
    assert laid.mass[upper].sum() == pytest.approx(0.3, abs=1e-3)
    assert not np.any(np.abs(laid.x.sum(axis=1)) < 2.0)
    assert np.allclose(laid.mean, mean, atol=1e-3)
    assert np.allclose(laid.cov, cov, atol=5e-3)
    X = laid.x[::7] + 0.1
    assert np.allclose(log_p_at(laid.field, X), bimodal(X), atol=0.05)


def test_what_the_lattice_spares():
    """Two thin pieces on a diagonal: the kept nodes are a small part of the box around them."""
    cov = np.eye(2)
    laid = lay(bimodal, np.zeros(2), cov, np.array([[-4.0, -4.0], [4.0, 4.0]]), 600, 8.0)
    cells = np.ptp(laid.field.node, axis=0) + 1
    assert len(laid.x) < 0.4 * np.prod(cells)


def test_too_few_particles_for_a_lattice():
    with pytest.raises(PropagationError, match="use more particles"):
        lay(gaussian_log_pdf(np.zeros(3), np.eye(3)), np.zeros(3), np.eye(3), np.zeros((1, 3)), 7, 8.0)


@pytest.mark.parametrize("n", COV)
def test_the_fewest_particles_do_resolve_a_gaussian(n):
    log_p = gaussian_log_pdf(np.zeros(n), np.eye(n))
    laid = lay(log_p, np.zeros(n), np.eye(n), np.zeros((1, n)), fewest_particles(n), 8.0)
    assert len(laid.x) <= fewest_particles(n)
    assert np.allclose(laid.cov, np.eye(n), atol=0.5)


def kalman(mean, cov, H, R, z):
    S = H @ cov @ H.T + R
    K = np.linalg.solve(S, H @ cov).T
    evidence = multivariate_normal(H @ mean, S).logpdf(z)
    return mean + K @ (z - H @ mean), cov - K @ H @ cov, evidence


@pytest.mark.parametrize("n", COV)
@pytest.mark.parametrize("R", [1e-6, 1e-2, 1.0, 100.0])
def test_sharp_and_dull_sensors(n, R):
    p = gaussian(n)
    H = np.ones((1, n)) / n
    sensor = sf.GaussianMeasurement(h=H, noise_cov=[[R]])
    z = H @ p.mean() + 0.7
    q, info = sf.update(p, sensor, z, n_particles=COUNTS[n])
    mean, cov, evidence = kalman(np.arange(1.0, n + 1.0), COV[n], H, np.array([[R]]), z)
    assert max(off(q, mean, cov)) < 5e-3
    assert info.log_evidence == pytest.approx(evidence, abs=1e-2)


def reading(n, sigmas):
    """A reading of the first of n states that far from its prediction: H, R, z."""
    H, R = np.eye(1, n), np.array([[0.1 * COV[n][0, 0]]])
    return H, R, np.array([1.0 + sigmas * np.sqrt(COV[n][0, 0] + R[0, 0])])


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("sigmas", [10.0, 14.0])
def test_outliers_meet_a_gaussian_tail(n, sigmas):
    H, R, z = reading(n, sigmas)
    q, info = sf.update(gaussian(n), sf.GaussianMeasurement(h=H, noise_cov=R), z, n_particles=COUNTS[n])
    mean, cov, evidence = kalman(np.arange(1.0, n + 1.0), COV[n], H, R, z)
    assert info.accepted
    assert max(off(q, mean, cov)) < 2e-2
    assert info.log_evidence == pytest.approx(evidence, rel=1e-3)
    assert f"outlying measurement: {sigmas:.1f} sigma" in info.reason


@pytest.mark.parametrize("n", [1, 2])
@pytest.mark.parametrize("sigmas", [30.0, 50.0])
def test_what_lies_too_far_out_is_not_used(n, sigmas):
    """The filter says so and keeps its prior; the evidence still counts against the model."""
    H, R, z = reading(n, sigmas)
    p = gaussian(n)
    q, info = sf.update(p, sf.GaussianMeasurement(h=H, noise_cov=R), z, n_particles=COUNTS[n])
    assert not info.accepted
    assert "not used" in info.reason
    assert q is p
    evidence = kalman(np.arange(1.0, n + 1.0), COV[n], H, R, z)[2]
    assert info.log_evidence == pytest.approx(evidence, rel=2e-2)


@pytest.mark.parametrize("R", [1e-1, 1e-2, 1e-3, 1e-6])
def test_disconnected_posterior_of_one_state(R):
    """z = x² + v with narrow v: two peaks and their evidence, by quadrature."""
    p = gaussian(1, mean=[0.2], cov=[[1.0]])
    sensor = sf.GaussianMeasurement(h=lambda x: (x[0] ** 2,), noise_cov=[[R]])
    q, info = sf.update(p, sensor, [1.5], n_particles=200)
    x = np.linspace(-3, 3, 1_000_001)
    joint = norm.pdf(x, 0.2, 1.0) * norm.pdf(1.5, x**2, np.sqrt(R))
    total, dx = joint.sum() * (x[1] - x[0]), x[1] - x[0]
    mean = (joint * x).sum() * dx / total
    var = (joint * x**2).sum() * dx / total - mean**2
    assert info.log_evidence == pytest.approx(np.log(total), abs=1e-2)
    assert q.mean()[0] == pytest.approx(mean, abs=2e-3)
    assert q.cov()[0, 0] == pytest.approx(var, rel=5e-3)
    assert q.mass[q.x[:, 0] > 0].sum() == pytest.approx((joint[x > 0]).sum() * dx / total, abs=2e-3)
    assert np.all(np.abs(q.x) > 0.8) or R > 1e-2


def test_disconnected_posterior_of_two_states():
    """A ring: z = x² + y² + v, cut by a Gaussian beside its centre."""
    p = gaussian(2, 500, mean=[0.3, 0.0], cov=np.diag([1.0, 0.5]))
    sensor = sf.GaussianMeasurement(h=lambda x: (x[0] ** 2 + x[1] ** 2,), noise_cov=[[0.01]])
    q, info = sf.update(p, sensor, [2.0], n_particles=1000)
    u = np.linspace(-3, 3, 1201)
    X = np.stack(np.meshgrid(u, u, indexing="ij"), axis=-1).reshape(-1, 2)
    joint = multivariate_normal([0.3, 0.0], np.diag([1.0, 0.5])).pdf(X)
    joint *= norm.pdf(2.0, (X**2).sum(axis=1), 0.1)
    total = joint.sum() * (u[1] - u[0]) ** 2
    w = joint / joint.sum()
    mean = w @ X
    assert info.log_evidence == pytest.approx(np.log(total), abs=1e-2)
    assert np.allclose(q.mean(), mean, atol=1e-2)
    assert np.allclose(q.cov(), (X - mean).T @ ((X - mean) * w[:, None]), atol=2e-2)


def test_a_truncating_likelihood():
    """The half x > 0.5 of a Gaussian, by a likelihood that is zero elsewhere."""
    p = gaussian(1, 200, mean=[0.0], cov=[[1.0]])
    sensor = sf.LikelihoodMeasurement(lambda z, X, t: np.where(X[:, 0] > z[0], 0.0, -np.inf))
    q, info = sf.update(p, sensor, [0.5], n_particles=200)
    assert info.log_evidence == pytest.approx(norm.logsf(0.5), abs=0.05)
    assert q.mean()[0] == pytest.approx(norm.pdf(0.5) / norm.sf(0.5), abs=0.03)
