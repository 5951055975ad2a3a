"""What must hold for any model, start and measurement: drawn ones, not chosen ones."""

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

import sphfilter as sf
from experiments.show.comparison import moment_errors
from experiments.stress.cell import Problem
from experiments.stress.judge import judge
from experiments.stress.references import reference
from experiments.stress.runs import run
from sphfilter.errors import ModelError, SphfilterError

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
def linear_problems(draw, max_dim=3, outliers=True):
    """Stable and unstable linear models, singular noise, ill-conditioned starts, sharp and dull sensors."""
    n = draw(st.integers(1, max_dim))
    k, rank = draw(st.integers(1, n)), draw(st.integers(0, n))
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    growth, decades = draw(st.floats(-2.0, 1.0)), draw(st.floats(0.0, 6.0))
    scale, sharp = 10.0 ** draw(st.floats(-3.0, 3.0)), 10.0 ** draw(st.floats(-4.0, 2.0))
    A = rng.standard_normal((n, n)) / np.sqrt(n) + growth * np.eye(n)
    P0 = scale**2 * _turned(rng, np.geomspace(1.0, 10.0**-decades, n))
    Q = 10.0 ** draw(st.floats(-2.0, 1.0)) * np.diag(np.arange(n) < rank)
    model = sf.LinearSDE(A=A, b=scale * rng.standard_normal(n), noise=scale * _turned(rng, np.ones(n)),
                         spectral_density=Q)  # fmt: skip
    H = rng.standard_normal((k, n))
    R = sharp * np.diag(np.diag(H @ P0 @ H.T))
    sensor, x0 = sf.GaussianMeasurement(h=H, noise_cov=R), scale * rng.standard_normal(n)
    times = draw(st.floats(0.05, 1.0)) * np.arange(1, 5)
    start = x0 + np.linalg.cholesky(P0) @ rng.standard_normal(n)
    _, z = sf.simulate(model, sensor, start, np.append(0.0, times), rng)
    z = z[1:].copy()
    if outliers and draw(st.booleans()):
        z[2] += draw(st.floats(3.0, 30.0)) * np.sqrt(np.diag(R))
    about = {"x0": x0, "P0": P0, "times": times, "z": z, "n_particles": _SIZES[n]}
    return Problem(model=model, measurement=sensor, **about)


def _run(problem):
    return run(problem, "default")


@given(problem=linear_problems())
@_few(60)
def test_linear_gaussian_problems_are_solved_or_refused(problem):
    exact = reference(problem, 0)
    assert exact.name == "Kalman filter"
    verdict = judge(_run(problem), exact)
    assert verdict.verdict in ("ok", "refused"), verdict


def _mild(x, t, p):
    return (p[0] * x[0] + p[1] * x[1] + p[4] * np.sin(x[0])), (
        p[2] * x[0] + p[3] * x[1] - p[4] * np.tanh(x[1])
    )


@pytest.fixture(scope="module")
def mild_model():
    """Two coupled states with bounded nonlinear terms; the coefficients are data."""
    names = ("a", "b", "c", "d", "e")
    return sf.SDE(_mild, 2, np.eye(2), 0.3 * np.eye(2), parameters=dict.fromkeys(names, 0.0))


@given(
    seed=st.integers(0, 10**6),
    strength=st.floats(0.0, 1.0),
    sharp=st.floats(-2.0, 1.0),
    turn=st.floats(0.0, 3.0),
)
@_few(6)
def test_mildly_nonlinear_problems_are_solved_or_refused(mild_model, seed, strength, sharp, turn):
    rng = np.random.default_rng(seed)
    A = -0.4 * np.eye(2) + 0.4 * rng.standard_normal((2, 2)) + turn * np.array([[0, 1], [-1, 0]])
    model = mild_model.with_parameters(a=A[0, 0], b=A[0, 1], c=A[1, 0], d=A[1, 1], e=strength)
    sensor = sf.GaussianMeasurement(h=rng.standard_normal((1, 2)), noise_cov=[[10.0**sharp]])
    x0, P0, times = rng.standard_normal(2), _turned(rng, np.array([1.0, 0.1])), 0.4 * np.arange(1, 4)
    start = x0 + np.linalg.cholesky(P0) @ rng.standard_normal(2)
    truth, z = sf.simulate(model, sensor, start, np.append(0.0, times), rng)
    about = {"x0": x0, "P0": P0, "times": times, "z": z[1:], "truth": truth[1:], "n_particles": 300}
    problem = Problem(model=model, measurement=sensor, **about)
    grid = reference(problem, 0)
    assert grid.name == "grid"
    verdict = judge(_run(problem), grid)
    assert verdict.verdict in ("ok", "refused"), verdict


def _changed(problem, B, c):
    """The same problem for the state B x + c."""
    inverse, model = np.linalg.inv(B), problem.model
    A = B @ model.A @ inverse
    noise = B @ model.noise(np.zeros((1, model.dim)), 0.0)[0]
    new = sf.LinearSDE(A=A, b=B @ model.b - A @ c, noise=noise, spectral_density=model.spectral_density)
    H = problem.measurement.H @ inverse
    sensor = sf.GaussianMeasurement(h=H, noise_cov=problem.measurement.noise_cov)
    x0, P0 = B @ problem.x0 + c, B @ problem.P0 @ B.T
    about = {"x0": x0, "P0": 0.5 * (P0 + P0.T), "z": problem.z + H @ c}
    return Problem(**{**vars(problem), "model": new, "measurement": sensor, **about})


def _check_equivariant(problem, B, c):
    """Runs in both coordinates agree within what either may err, or one of them is refused."""
    first, second = _run(problem), _run(_changed(problem, B, c))
    assume(first.end == second.end == "finished")
    mean, cov = moment_errors(second.x, second.P, first.x @ B.T + c, B @ first.P @ B.T)
    assert np.sqrt(np.mean(mean**2)) < 0.1 and np.sqrt(np.mean(cov**2)) < 0.25
    det = -np.sum(first.log_evidence) + np.sum(second.log_evidence)
    assert abs(det) < 0.1  # the measurement is the same, and so is its density


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
    first, second = _run(problem), _run(problem)
    assert first.end == second.end and first.sentence == second.sentence
    for name in ("x", "P", "log_evidence"):
        assert np.array_equal(getattr(first, name), getattr(second, name))


def _snapshot(f):
    d = f.density
    return [a.copy() for a in (f.x, f.P, f.x_prior, f.P_prior, f.x_post, f.P_post, d.x, d.mass, d.h)] + [
        np.array([f.t, f.log_likelihood, f.log_evidence])
    ]


@given(
    bad=st.sampled_from(["length", "infinite", "backwards", "impossible", "blow-up"]),
    problem=linear_problems(max_dim=2, outliers=False),
)
@_few(10)
def test_a_refusal_leaves_the_filter_as_it_was(bad, problem):
    model = problem.model
    if bad == "blow-up":  # grows by e^1000 within the interval
        model = sf.LinearSDE(A=1e3 * np.eye(model.dim), noise=np.eye(model.dim))
    nowhere = sf.LikelihoodMeasurement(lambda z, X, t: np.full(len(X), -np.inf), dim_z=1)
    f = sf.SPHFilter(model, problem.measurement, problem.x0, problem.P0, n_particles=problem.n_particles)
    before = _snapshot(f)
    k = problem.measurement.dim_z
    calls = {
        "length": lambda: f.update(np.zeros(k + 1)),
        "infinite": lambda: f.update(np.full(k, np.inf)),
        "backwards": lambda: f.predict(t=-1.0),
        "impossible": lambda: f.update([0.0], nowhere),
        "blow-up": lambda: f.predict(1.0),
    }
    with pytest.raises(
        ModelError if bad in ("length", "infinite", "backwards") else SphfilterError
    ) as refusal:
        calls[bad]()
    assert len(str(refusal.value)) > 20
    assert all(np.array_equal(a, b) for a, b in zip(before, _snapshot(f), strict=True))
