"""Models in discrete time that switch: against sums over all sequences of modes, a grid, and particles."""

import pickle
from itertools import product

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, norm

import sphfilter as sf

P = np.array([[0.9, 0.1], [0.3, 0.7]])
FLAT = {"calm": 0.05, "wild": 1.5}


def pushed(F=1.0, n=2):
    """Walks of little and of much noise, seen in the first state."""
    step = np.eye(n) + np.diag(0.4 * np.ones(n - 1), 1) if n > 1 else np.array([[F]])
    return {k: sf.DiscreteModel.from_matrices(F=step, Q=q * np.eye(n)) for k, q in FLAT.items()}


def all_sequences(modes, z, R, w, x0, P0):
    """Log-evidence, mode probabilities, mean and covariance: a Kalman filter for each sequence of modes."""
    matrices = [mode.discretize(1.0) for mode in modes.values()]
    H, found = np.eye(1, len(x0)), []
    for sequence in product(range(len(modes)), repeat=len(z)):
        log_w, m, C = 0.0, x0, P0
        before = w
        for k, y in zip(sequence, z, strict=True):
            log_w += np.log((before @ P)[k])
            before = np.eye(len(modes))[k]
            F, b, Q = matrices[k]
            m, C = F @ m + b, F @ C @ F.T + Q
            S = H @ C @ H.T + R
            log_w += multivariate_normal(H @ m, S).logpdf(y)
            gain = C @ H.T / S
            m, C = m + gain[:, 0] * (y - (H @ m)[0]), C - gain @ H @ C
        found.append((log_w, sequence[-1], m, C))
    log_w, last, m, C = (np.array(part) for part in zip(*found, strict=True))
    total = logsumexp(log_w)
    share = np.exp(log_w - total)
    mean = share @ m
    off = m - mean
    return (
        total,
        np.bincount(last, share, len(modes)),
        mean,
        np.einsum("k,kab->ab", share, C) + (share * off.T) @ off,
    )


@pytest.mark.parametrize("n", [1, 2, 3])
def test_linear_maps_are_sums_over_all_sequences_of_modes(n):
    modes, z = pushed(n=n), [0.3, 2.6, 2.4, 5.0, 4.4, 4.9]
    model = sf.JumpMarkovModel(modes, transitions=P)
    flt = sf.JumpMarkovFilter(
        model, sf.GaussianMeasurement(np.eye(1, n), [[0.1]]), np.zeros(n), np.eye(n), dt=1.0
    )
    result = flt.run(np.arange(1.0, len(z) + 1), z)
    total, w, mean, cov = all_sequences(modes, z, 0.1, model.stationary, np.zeros(n), np.eye(n))
    assert abs(result.log_evidence.sum() - total) < 2.0 * result.total_evidence_error < 0.05
    np.testing.assert_allclose(flt.mode_probabilities, w, atol=0.003)
    np.testing.assert_allclose((flt.x - mean) / np.sqrt(np.diag(cov)), 0.0, atol=0.01)
    np.testing.assert_allclose(np.diag(flt.P), np.diag(cov), rtol=0.03)
    assert not result.flagged.any()


def test_several_steps_at_once_are_those_one_by_one():
    model = sf.JumpMarkovModel(pushed(), transitions=P)
    flt, other = (sf.JumpMarkovFilter(model, None, np.zeros(2), np.eye(2)) for _ in range(2))
    flt.predict(3.0)
    for _ in range(3):
        other.predict(1.0)
    np.testing.assert_allclose(flt.mode_probabilities, other.mode_probabilities, atol=1e-12)
    np.testing.assert_allclose(flt.mode_probabilities, model.stationary @ np.linalg.matrix_power(P, 3))
    np.testing.assert_allclose(flt.P, other.P, rtol=1e-3)


def growth():
    """Kitagawa's growth model, calm and wild."""
    text = "0.5*x + 25*x/(1 + x**2)"
    return {
        k: sf.DiscreteModel.from_expressions(["x"], [text], [["1"]], [[q]])
        for k, q in (("a", 1.0), ("b", 10.0))
    }


def test_maps_of_one_state_beside_a_grid():
    model, z = sf.JumpMarkovModel(growth(), transitions=P), [3.0, 9.0, 1.0, 7.0]
    sensor = sf.GaussianMeasurement.from_expressions(["x"], ["x**2/20"], [[1.0]])
    flt = sf.JumpMarkovFilter(model, sensor, [0.5], [[2.0]], dt=1.0)
    x = np.linspace(-45.0, 45.0, 3001)
    p = model.stationary[:, None] * norm.pdf(x, 0.5, np.sqrt(2.0))
    step = 0.5 * x + 25.0 * x / (1.0 + x**2)
    kernels = [norm.pdf(x[:, None], step, np.sqrt(q)) * (x[1] - x[0]) for q in (1.0, 10.0)]
    for y in z:
        flt.predict()
        info = flt.update(y)
        p = np.array([kernel @ part for kernel, part in zip(kernels, P.T @ p, strict=True)])
        p *= norm.pdf(y, x**2 / 20.0, 1.0)
        evidence = p.sum() * (x[1] - x[0])
        p /= evidence
        w = p.sum(axis=1) * (x[1] - x[0])
        mean = p.sum(axis=0) @ x * (x[1] - x[0])
        std = np.sqrt(p.sum(axis=0) @ (x - mean) ** 2 * (x[1] - x[0]))
        assert info.log_evidence == pytest.approx(np.log(evidence), abs=0.01)
        np.testing.assert_allclose(flt.mode_probabilities, w, atol=0.003)
        assert abs(flt.x[0] - mean) < 0.01 * std and not info.flagged


def test_maps_of_two_states_beside_particles():
    """Also what simulates such models, of which the particles are."""
    turn = {
        k: sf.DiscreteModel.from_expressions(
            ["y", "theta"], ["y + sin(theta)", f"theta + {a}"], covariance=0.02 * np.eye(2)
        )
        for k, a in (("ahead", 0.0), ("left", 0.4))
    }
    model = sf.JumpMarkovModel(turn, transitions=P)
    sensor = sf.GaussianMeasurement([[1.0, 0.0]], [[0.05]])
    flt, z = sf.JumpMarkovFilter(model, sensor, np.zeros(2), 0.1 * np.eye(2), dt=1.0), [0.4, 1.3, 2.4]
    flt.run([1.0, 2.0, 3.0], z)
    paths = sf.simulate_modes(
        model,
        None,
        np.random.default_rng(1).multivariate_normal(np.zeros(2), 0.1 * np.eye(2), 400_000),
        np.arange(4.0),
        rng=2,
    )
    w = np.exp(-0.5 * ((paths.truth[:, 1:, 0] - z) ** 2).sum(axis=1) / 0.05)
    w /= w.sum()
    mean, share = w @ paths.truth[:, -1], np.bincount(paths.modes[:, -1], w)
    allowed = 4.0 * np.sqrt(np.sum(w**2)) + 0.01
    np.testing.assert_allclose((flt.x - mean) / np.sqrt(np.diag(flt.P)), 0.0, atol=allowed)
    np.testing.assert_allclose(flt.mode_probabilities, share, atol=allowed)


def test_what_does_not_fit_is_refused_and_what_does_is_kept():
    equation = sf.LinearSDE([[0.0]], noise=[[1.0]])
    slow = sf.DiscreteModel.from_matrices(F=[[1.0]], Q=[[1.0]], period=2.0)
    for modes, given, sentence in (
        (pushed(), {"rates": [[-1, 1], [1, -1]]}, "transitions="),
        (pushed(), {"transitions": [[0.9, 0.2], [0.5, 0.5]]}, "'calm'"),
        (pushed(), {"transitions": [[1.0, 0.0], [1.1, -0.1]]}, "'wild'"),
        ({"a": equation, "b": equation}, {"transitions": P}, "rates="),
        ({"a": equation, "b": slow}, {"rates": [[-1, 1], [1, -1]]}, "DiscreteModel"),
        ({"a": slow, **pushed(n=1)}, {"transitions": np.eye(3)}, "period"),
    ):
        with pytest.raises(sf.ModelError, match=sentence):
            sf.JumpMarkovModel(modes, **given)
    model = pickle.loads(pickle.dumps(sf.JumpMarkovModel(pushed(), transitions=P)))
    np.testing.assert_array_equal(model.transitions, P)
    with pytest.raises(sf.ModelError, match="whole steps"):
        sf.JumpMarkovFilter(model, None, np.zeros(2), np.eye(2)).predict(1.5)
