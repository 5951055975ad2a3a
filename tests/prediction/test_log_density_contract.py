"""What the log-density scheme promises besides its numbers: refusals, the same bits, usable densities."""

import copy
import pickle

import numpy as np
import pytest
from density_cases import duffing, linear, moved, off, position, quadrature, start, text
from scipy.stats import multivariate_normal

import sphfilter as sf
from sphfilter.errors import PropagationError, SphfilterError
from sphfilter.prediction import log_density

# refusals


def test_blow_up_is_told():
    with pytest.raises(PropagationError, match=r"blew up at t = .*x = .*grows without bound"):
        moved(text(["x"], ["x**3"], [["1"]]), [0.0], [[9.0]], 5.0, 100)


def test_advice_is_for_the_scheme_in_use():
    cubic, p0 = text(["x"], ["x**3"], [["1"]]), sf.initialize(sf.Gaussian([0.0], [[9.0]]), 100)
    with pytest.raises(PropagationError, match=r"blew up .*LogDensityScheme\(reach=3\)$"):
        sf.predict(p0, cubic, 5.0)
    few = sf.SolverConfig(scheme=sf.LogDensityScheme(max_steps=1, most_lost=100.0))
    advice = r"1 steps were not enough; allow more with .*, or predict over a shorter interval$"
    with pytest.raises(PropagationError, match=advice):
        sf.predict(sf.initialize(sf.Gaussian(*start(2)), 200), duffing(), 300.0, few)


def test_too_few_particles_are_told():
    _, info = moved(linear(2), *start(2), 0.1, 200)
    assert info.status == "ok"
    with pytest.raises(SphfilterError, match="particles"):
        moved(linear(4), *start(4), 0.1, 20)


def failing(kind):
    """A black box that fails once it has been asked for a while: in the middle of a prediction."""
    asked = []

    def drift(X, t):
        asked.append(t)
        if len(asked) > 12:
            raise kind("enough")
        return -X

    def divergence(X, t):
        return -np.ones(len(X))

    return sf.SDE(drift=drift, dim=1, noise=[[1.0]], divergence=divergence, vectorized=True)


@pytest.mark.parametrize("kind", [ValueError, KeyboardInterrupt])
def test_a_prediction_that_fails_leaves_the_filter(kind):
    flt = sf.SPHFilter(failing(kind), position(1), [1.0], [[0.3]], n_particles=60)
    before = flt.density, flt.x, flt.t, flt.log_evidence, flt.x_prior
    content = before[0].x.copy(), before[0].mass.copy(), before[0].field.coefficient.copy()
    with pytest.raises(kind, match="enough"):
        flt.predict(20.0)
    assert flt.density is before[0]
    assert (flt.t, flt.log_evidence) == (0.0, 0.0)
    assert flt.x is before[1]
    assert flt.x_prior is before[4]
    kept = flt.density.x, flt.density.mass, flt.density.field.coefficient
    assert all(np.array_equal(a, b) for a, b in zip(content, kept, strict=True))


# the filter and its density


def test_the_same_bits_twice():
    def run():
        flt = sf.SPHFilter(duffing(), position(2), [0.5, 1.0], 0.3 * np.eye(2), n_particles=200)
        result = flt.run([0.5, 1.0, 1.5], [[0.9], None, [np.nan]])
        return result, flt.density

    (first, p), (second, q) = run(), run()
    for name in ("x", "P", "log_evidence"):
        assert np.array_equal(getattr(first, name), getattr(second, name))
    assert np.array_equal(p.log_density, q.log_density)
    assert first.log_evidence[1] == first.log_evidence[2] == 0.0


def test_threads_change_no_bit(monkeypatch):
    """Three states and noises, 13 paths: enough work for threads from a few hundred particles on."""
    found = []
    for threads_from in (0, np.inf):
        monkeypatch.setattr(log_density, "_THREADS_FROM", threads_from)
        density, info = moved(linear(3), *start(3), 0.5, 600)
        assert (info.scheme, info.status) == ("log_density", "ok")
        assert ("threads: too little work for them" in info.skipped) == (threads_from > 0)
        found.append(density)
    assert np.array_equal(found[0].x, found[1].x)
    assert np.array_equal(found[0].log_density, found[1].log_density)


def test_large_predictions_are_the_log_density_s_too():
    """From twenty thousand paths a step on they run in threads."""
    _, info = moved(duffing(), [0.5, 1.0], 0.3 * np.eye(2), 0.1, 2500)
    assert (info.scheme, info.status) == ("log_density", "ok")
    assert not any("threads" in note for note in info.skipped)


def test_prediction_in_parts():
    """One interval or three: the same density to the error of the scheme."""
    p, _ = moved(duffing(), [0.5, 1.0], 0.3 * np.eye(2), 1.2, 400)
    q = sf.initialize(sf.Gaussian([0.5, 1.0], 0.3 * np.eye(2)), 400)
    for _ in range(3):
        q, _ = sf.predict(q, duffing(), 0.4)
    assert max(off(q.mean(), q.cov(), p.mean(), p.cov())) < 3e-3


def test_an_empty_interval_is_skipped():
    p = sf.initialize(sf.Gaussian([0.5, 1.0], 0.3 * np.eye(2)), 200)
    q, info = sf.predict(p, duffing(), 0.0)
    assert q is p
    assert info.n_evaluations == 0
    assert "empty" in info.skipped[0]


@pytest.fixture(scope="module")
def bent():
    return moved(duffing(), [0.5, 1.0], 0.3 * np.eye(2), 1.0, 300)[0]


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda p: pickle.loads(pickle.dumps(p))])
def test_copies_of_a_density(bent, copied):
    other = copied(bent)
    X = bent.x[::5] + 0.03
    assert np.array_equal(other.logpdf(X), bent.logpdf(X))
    assert np.array_equal(other.cov(), bent.cov())
    assert not other.x.flags.writeable
    after = [sf.predict(p, duffing(), 0.2)[0].mean() for p in (bent, other)]
    assert np.array_equal(*after)


def test_the_pdf_integrates_to_one_and_agrees_with_the_read_outs(bent):
    X, w = quadrature(bent)
    assert w.sum() == pytest.approx(1.0, abs=2e-3)
    mean = w @ X / w.sum()
    assert max(off(mean, (X - mean).T @ ((X - mean) * w[:, None]), bent.mean(), bent.cov())) < 1e-2
    assert bent.moment([2, 1]) == pytest.approx(w @ (X[:, 0] ** 2 * X[:, 1]), rel=1e-2)


def test_probabilities_know_an_edge_to_a_sixteenth_of_a_cell(bent):
    """Sixteen points a cell, in the same rows everywhere: a half-plane along the rows is off by half of what
    lies between two of them at most, to either side.
    """
    X, w = quadrature(bent)
    rows = w.reshape(400, 400).sum(axis=1) / w.sum()
    first = X[::400, 0]
    edges = 0.5 * (first[1:] + first[:-1])  # between two rows of the quadrature
    right = 1.0 - np.cumsum(rows)[:-1]
    chosen = range(100, 300, 2)
    found = [bent.probability(lambda Y, edge=edges[k]: Y[:, 0] > edge) for k in chosen]
    error = found - right[chosen]
    highest = rows.max() / (first[1] - first[0])
    assert np.abs(error).max() < highest * bent.field.A[0, 0] / 32.0
    assert abs(error.mean()) < 5e-4


def test_samples_have_the_moments_of_the_density(bent):
    drawn = bent.sample(40_000, rng=1)
    assert drawn.shape == (40_000, 2)
    assert max(off(drawn.mean(axis=0), np.cov(drawn.T), bent.mean(), bent.cov())) < 0.02
    assert np.array_equal(bent.sample(5, rng=3), bent.sample(5, rng=3))


def test_the_far_tail_falls_like_a_gaussian():
    p, _ = moved(linear(2), *start(2), 1.0, 300)
    Phi, c, Q = linear(2).discretize(1.0)
    mean, cov = start(2)
    exact = multivariate_normal(Phi @ mean + c, Phi @ cov @ Phi.T + Q)
    root = np.linalg.cholesky(exact.cov)
    for angle in np.linspace(0, 2 * np.pi, 9):
        X = exact.mean + 20.0 * root @ [np.cos(angle), np.sin(angle)]
        assert p.logpdf(X)[0] == pytest.approx(exact.logpdf(X), rel=0.05)
    huge = p.logpdf(np.array([[1e100, 0.0], [-1e200, 1e200]]))
    assert np.all(np.isfinite(huge))
    assert np.all(huge < -1e190)
