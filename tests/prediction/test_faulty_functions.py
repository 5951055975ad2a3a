"""Functions of a user's own that go wrong: what they raise comes out as it was, and Python lives on."""

import functools
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from faulty_functions import Faulty, OwnError, behaves

import sphfilter as sf

CASES = Path(__file__).parents[1] / "cases" / "faulty_functions.py"


@pytest.mark.parametrize(("dim", "fails_at"), [(1, 1), (1, 30), (2, 4), (2, 90)])
@pytest.mark.parametrize("how", ["raise", "nan", "shape"])
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_drift_that_goes_wrong_at_some_call(dim, how, fails_at):
    assert behaves(dim, how, fails_at, 60) == ""


def fuzzed(cases, seed):
    """What a process of its own says, which a crash of Python would end."""
    code = f"import runpy, sys; sys.argv = ['', '{seed}', '{cases}']; "
    code += f"runpy.run_path({str(CASES)!r}, run_name='__main__')"
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


def test_exceptions_in_threads_do_not_end_python():
    """Five states and 2000 particles: the paths run in threads, in compiled code."""
    ended = fuzzed(0, 1)
    assert (ended.returncode, ended.stdout) == (0, ""), ended.stderr[-500:]


@pytest.mark.slow
def test_faults_at_random_calls():
    ended = fuzzed(40, 2)
    assert (ended.returncode, ended.stdout) == (0, ""), ended.stderr[-500:]


def raising(function, fails_at):
    """The function, but for one call, at which it raises."""
    calls = []

    @functools.wraps(function)
    def changed(*arguments):
        calls.append(None)
        assert all(len(a) for a in arguments if np.ndim(a) == 2)
        if len(calls) == fails_at:
            raise OwnError("its own")
        return function(*arguments)

    return changed


@pytest.mark.parametrize("name", ["noise", "diffusion", "divergence"])
@pytest.mark.parametrize("scheme", ["auto", "paper"])
def test_all_functions_of_a_model(name, scheme):
    functions = {
        "noise": lambda X, t: np.full((len(X), 1, 1), 0.5 + 0.1 * t),
        "diffusion": lambda X, t: np.full((len(X), 1, 1), 0.5 + 0.1 * t),
        "divergence": lambda X, t: -np.ones(len(X)),
    }
    if scheme != "auto" and name == "divergence":
        pytest.skip("these schemes ask for no divergence")
    options = {name: raising(functions[name], 5)}
    options |= {"noise": [[1.0]]} if name == "divergence" else {}
    options |= {"spectral_density": [[1.0]]} if name == "noise" else {}
    model = sf.SDE(lambda X, t: -X, 1, vectorized=True, **options)
    config = sf.SolverConfig(scheme=scheme)
    start = sf.initialize(sf.Gaussian([1.0], [[0.2]]), 60, config)
    with pytest.raises(OwnError, match="its own"):
        sf.predict(start, model, 1.0, config)


def walk():
    return sf.SDE(lambda x: (-x[0],), 1, noise=[[1.0]])


@pytest.mark.parametrize("call", ["predict", "simulate", "propagate", "run", "smooth", "fit"])
def test_every_verb(call):
    drift = Faulty(lambda X, t: -X, "raise", np.inf)
    model = sf.SDE(drift, 1, [[1.0]], vectorized=True, parameters={"a": 1.0})
    sensor = sf.GaussianMeasurement([[1.0]], [[0.1]])
    flt = sf.SPHFilter(model, sensor, [0.0], [[0.2]], n_particles=60)
    drift.fails_at = drift.calls + 8
    times, z = [0.5, 1.0], [[0.1], [0.2]]
    verbs = {
        "predict": lambda: flt.predict(1.0),
        "simulate": lambda: sf.simulate(model, None, [0.0], [0.0, 5.0], rng=1),
        "propagate": lambda: sf.propagate(flt.density, model, times),
        "run": lambda: flt.run(times, z),
        "smooth": lambda: sf.smooth(flt, times, z),
        "fit": lambda: sf.fit_parameters(flt, times, z, {"a": 1.0}),
    }
    with pytest.raises(OwnError) as raised:
        verbs[call]()
    assert raised.value is drift.raised
    if call != "run":
        assert flt.t == 0.0


@pytest.mark.parametrize("fails_at", [1, 2])
def test_sensors_and_likelihoods(fails_at):
    def log_likelihood(z, X, t):
        return -0.5 * (z[0] - X[:, 0]) ** 2

    sensors = [
        sf.GaussianMeasurement(raising(lambda X: X**2, fails_at + 1), [[0.1]], vectorized=True),
        sf.LikelihoodMeasurement(raising(log_likelihood, fails_at)),
    ]
    for sensor in sensors:
        flt = sf.SPHFilter(walk(), sensor, [1.0], [[0.2]], n_particles=60)
        before = flt.density
        with pytest.raises(OwnError):
            flt.update([1.0])
        assert flt.density is before


def test_no_rows_are_no_call():
    asked = []
    model = sf.SDE(lambda X, t: asked.append(X.max()) or -X, 2, [[1.0], [1.0]], vectorized=True)
    called = len(asked)
    assert model.drift(np.empty((0, 2)), 0.0).shape == (0, 2)
    sensor = sf.LikelihoodMeasurement(lambda z, X, t: asked.append(X.max()) or X[:, 0])
    assert sensor.log_likelihood([1.0], np.empty((0, 2))).shape == (0,)
    assert len(asked) == called


def test_a_compiled_function_that_raises():
    def table(x, t):
        if t > 0.2:
            raise ValueError("beyond the table")
        return (-x[0],)

    model = sf.SDE(table, 1, noise=[[1.0]])
    np.testing.assert_array_equal(model.drift([[1.0], [2.0]], 0.1), [[-1.0], [-2.0]])
    with pytest.raises(ValueError, match="beyond the table"):
        model.drift([[1.0], [2.0]], 0.3)
    start = sf.initialize(sf.Gaussian([1.0], [[0.2]]), 60)
    with pytest.raises(ValueError, match="beyond the table"):
        sf.predict(start, model, 1.0)
