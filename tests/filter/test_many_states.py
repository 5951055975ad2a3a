"""Seven to twelve states: chains against Kalman's filter, and two halves that know nothing of each other."""

import numpy as np
import pytest

import sphfilter as sf

TIMES = 0.5 * np.arange(1, 8)
START = np.eye(12)


def chain(n, pull):
    """Drift of a chain of n states between two walls, each drawn by its neighbours and by itself."""
    states = [f"x{i}" for i in range(n)]
    beside = [" + ".join(x for k, x in enumerate(states) if abs(k - i) == 1) for i in range(n)]
    return states, [f"0.5*({near} - 2*{x}) {pull}({x})" for x, near in zip(states, beside, strict=True)]


def reading(n):
    """A sensor of every other state."""
    H = START[:n:2, :n]
    return sf.GaussianMeasurement(H, 0.1 * np.eye(len(H)))


def filtered(model, sensor, z, **options):
    n = model.dim
    flt = sf.SPHFilter(model, sensor, np.zeros(n), START[:n, :n], config=sf.FilterConfig(**options))
    return flt, flt.run(TIMES, z)


@pytest.mark.parametrize("n", [7, 10, 12])
def test_a_linear_chain_is_kalmans_filter_and_its_points_are_near(n):
    states, drift = chain(n, "- 0.3*")
    model = sf.SDE.from_expressions(states, drift, 0.4 * np.eye(n))
    sensor = reading(n)
    _, z = sf.simulate(model, sensor, np.zeros(n), TIMES, rng=1)
    flt, exact = filtered(model, sensor, z)
    x, P = np.zeros(n), START[:n, :n]
    Phi, _, Q = model.to_linear().discretize(0.5)
    for number in z:
        x, P = Phi @ x, Phi @ P @ Phi.T + Q
        gain = P @ sensor.H.T @ np.linalg.inv(sensor.H @ P @ sensor.H.T + sensor.noise_cov)
        x, P = x + gain @ (number - sensor.H @ x), P - gain @ sensor.H @ P
    assert flt.density.gaussian
    np.testing.assert_allclose(flt.x, x, atol=1e-9)
    np.testing.assert_allclose(flt.P, P, atol=1e-9)
    points, found = filtered(model, sensor, z, scheme=sf.CloudScheme(n_points=4096))
    off = (found.x - exact.x) / np.sqrt(np.diagonal(exact.P, axis1=1, axis2=2))
    assert np.sqrt(np.mean(off**2)) < 0.06  # told .01 to .02: in so many states half to a third of it
    assert points.density.sample(5, rng=1).shape == (5, n)
    with pytest.raises(sf.ModelError, match="six states at most"):
        points.plot()


def test_two_chains_of_five_are_ten_states():
    states, drift = chain(5, "+ 0.5*sin")
    more = [x.replace("x", "y") for x in states]
    half = sf.SDE.from_expressions(states, drift, 0.4 * np.eye(5))
    both = drift + [f.replace("x", "y") for f in drift]
    whole = sf.SDE.from_expressions(states + more, both, 0.4 * np.eye(10))
    one = reading(5)
    two = sf.GaussianMeasurement(np.kron(np.eye(2), one.H), 0.1 * np.eye(6))
    _, z = sf.simulate(whole, two, np.zeros(10), TIMES, rng=3)
    halves = [filtered(half, one, z[:, part], target_error=0.005)[1] for part in (slice(0, 3), slice(3, 6))]
    _, found = filtered(whole, two, z, target_error=0.03)
    x = np.concatenate([run.x for run in halves], axis=1)
    std = np.concatenate([np.sqrt(np.diagonal(run.P, axis1=1, axis2=2)) for run in halves], axis=1)
    assert np.sqrt(np.mean(((found.x - x) / std) ** 2)) < 3.0 * np.sqrt(np.mean(found.error**2))
    total = sum(run.log_evidence.sum() for run in halves)
    assert abs(found.log_evidence.sum() - total) < 3.0 * found.total_evidence_error
