"""What must hold for any model, start and measurement: drawn ones, not chosen ones."""

import numpy as np
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from stress_cases import check_moments, check_right

import sphfilter as sf
from experiments.stress.hard_systems import equation, linear
from experiments.stress.problem import Problem
from experiments.stress.records import record_of
from experiments.stress.referees import Referee, referee
from experiments.stress.relations import in_other_coordinates
from experiments.stress.sensors import GaussianReader

_SIZES = {1: 100, 2: 300, 3: 800}


def _few(n):
    """Settings of a property: the same examples each time, no limit of time on a busy machine."""
    quiet = [HealthCheck.too_slow, HealthCheck.filter_too_much]
    return settings(max_examples=n, deadline=None, derandomize=True, suppress_health_check=quiet)


def _turned(rng, eigenvalues):
    """Symmetric matrix with these eigenvalues in a random position."""
    V, _ = np.linalg.qr(rng.standard_normal((len(eigenvalues), len(eigenvalues))))
    return (V * eigenvalues) @ V.T


@st.composite
def linear_problems(draw, outliers=True):
    """Stable and unstable linear models, singular noise, ill-conditioned starts, sharp and dull sensors."""
    n = draw(st.integers(1, 3))
    k, rank = draw(st.integers(1, n)), draw(st.integers(0, n))
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    growth, decades = draw(st.floats(-2.0, 1.0)), draw(st.floats(0.0, 6.0))
    scale, sharp = 10.0 ** draw(st.floats(-3.0, 3.0)), 10.0 ** draw(st.floats(-4.0, 2.0))
    A = rng.standard_normal((n, n)) / np.sqrt(n) + growth * np.eye(n)
    P0 = scale**2 * _turned(rng, np.geomspace(1.0, 10.0**-decades, n))
    Q = 10.0 ** draw(st.floats(-2.0, 1.0)) * np.diag(np.arange(n) < rank)
    b, G = scale * rng.standard_normal(n), scale * _turned(rng, np.ones(n)) @ np.sqrt(Q)
    H = rng.standard_normal((k, n))
    R = sharp * np.diag(np.diag(H @ P0 @ H.T))
    x0, times = scale * rng.standard_normal(n), draw(st.floats(0.05, 1.0)) * np.arange(1, 5)
    problem = _problem(rng, linear(A, G, b), H, R, x0, P0, times)
    if outliers and draw(st.booleans()):
        problem.z[0][2] += draw(st.floats(3.0, 30.0)) * np.sqrt(np.diag(R))
    return problem


def _problem(rng, model, H, R, x0, P0, times):
    """A problem whose readings are drawn."""
    reader = GaussianReader(kind="linear", states=model.states, R=R, H=H)
    start = x0 + np.linalg.cholesky(P0) @ rng.standard_normal(len(x0))
    _, z = sf.simulate(model.model, reader.sensor, start, np.append(0.0, times), rng)
    about = {"equation": model, "readers": (reader,), "z": (z[1:].copy(),)}
    return Problem(**about, x0=x0, P0=P0, times=times, n_particles=_SIZES[len(x0)])


def _check(problem, name):
    """The default filter is right against a reference of that name, or refuses."""
    reference = referee(problem, 0)
    assert reference.name == name
    check_right(problem, record_of(problem), reference)


@given(problem=linear_problems())
@_few(60)
def test_linear_gaussian_problems_are_solved_or_refused(problem):
    _check(problem, "Kalman filter")


@given(
    seed=st.integers(0, 10**6),
    strength=st.floats(0.0, 1.0),
    sharp=st.floats(-2.0, 1.0),
    turn=st.floats(0.0, 3.0),
)
@_few(6)
def test_mildly_nonlinear_problems_are_solved_or_refused(seed, strength, sharp, turn):
    rng = np.random.default_rng(seed)
    A = -0.4 * np.eye(2) + 0.4 * rng.standard_normal((2, 2)) + turn * np.array([[0, 1], [-1, 0]])
    drift = "a*x0 + b*x1 + e*sin(x0)", "c*x0 + d*x1 - e*tanh(x1)"
    numbers = dict(zip("abcd", A.ravel(), strict=True)) | {"e": strength}
    model = equation(drift, np.sqrt(0.3) * np.eye(2), **numbers)
    H, R = rng.standard_normal((1, 2)), 10.0**sharp
    x0, P0, times = rng.standard_normal(2), _turned(rng, np.array([1.0, 0.1])), 0.4 * np.arange(1, 4)
    _check(_problem(rng, model, H, R, x0, P0, times), "grid")


def _check_equivariant(problem, B, c):
    """Runs on x and on B x + c agree within what either may err, or one of them is refused."""
    back = np.linalg.inv(B)
    first, second = record_of(problem), record_of(in_other_coordinates(problem, back, -back @ c))
    assume(first.end == second.end == "finished")
    check_moments(second, Referee("", first.x, first.P, first.log_evidence, n_trusted=len(first.x)))
    # the reading is the same, and so is its density
    assert abs(np.sum(first.log_evidence) - np.sum(second.log_evidence)) < 0.1


@given(problem=linear_problems(outliers=False), seed=st.integers(0, 10**6), decades=st.floats(0.0, 4.0))
@_few(6)
def test_units_do_not_matter(problem, seed, decades):
    rng, n = np.random.default_rng(seed), problem.model.dim
    B = np.diag(10.0 ** rng.uniform(-decades, decades, n)) @ _turned(rng, rng.uniform(0.5, 2.0, n))
    _check_equivariant(problem, B, B @ problem.x0 * rng.uniform(-3.0, 3.0, n))


@given(problem=linear_problems(outliers=False), seed=st.integers(0, 10**6))
@_few(4)
def test_order_of_the_states_does_not_matter(problem, seed):
    n = problem.model.dim
    _check_equivariant(problem, np.eye(n)[np.random.default_rng(seed).permutation(n)], np.zeros(n))


@given(problem=linear_problems())
@_few(6)
def test_same_input_gives_the_same_bits(problem):
    first, second = record_of(problem), record_of(problem)
    assert first.end == second.end and first.sentence == second.sentence
    for name in ("x", "P", "log_evidence"):
        assert np.array_equal(getattr(first, name), getattr(second, name))
