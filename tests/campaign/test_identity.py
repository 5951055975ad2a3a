"""What campaigns know factories and scenarios by: code, and the values of all that it refers to."""

import types

import numpy as np
import pytest

import sphfilter as sf
from sphfilter.campaign.identity import code_digest, text_of

SCRIPT = """
import numpy as np
import sphfilter as sf

NOISE, COUNT = 0.5, 60
MODEL = sf.SDE.from_expressions(["x"], ["-a*x"], [["1"]], parameters={"a": 0.6})
CALLED = sf.SDE(lambda x: (-x[0] * 0.25,), dim=1, noise=[[1.0]])
GRID = np.linspace(0.0, 1.0, 5000)


def deeper(x):
    return x + NOISE


class Scenario:
    name = "decay"

    def draw(self, rng):
        return deeper(rng.normal()), COUNT


def factory(case, rng):
    return [deeper(k) for k in range(2)], MODEL, CALLED, np.sum(GRID), Scenario().draw(rng)
"""
CHANGES = {
    "a value": ("NOISE, COUNT = 0.5", "NOISE, COUNT = 0.6"),
    "a value of a class": ("COUNT = 0.5, 60", "COUNT = 0.5, 61"),
    "a parameter": ('{"a": 0.6}', '{"a": 0.7}'),
    "a text": ('"-a*x"', '"-a*x**3"'),
    "a function of a model": ("* 0.25", "* 0.26"),
    "an array": ("0.0, 1.0, 5000", "1e-9, 1.0, 5000"),
    "a function": ("x + NOISE", "x - NOISE"),
    "a name of the library": ("np.sum(", "np.prod("),
}


def ran(script, name="script"):
    """The module of a script."""
    module = types.ModuleType(name)
    exec(script, vars(module))
    return module


@pytest.mark.parametrize("change", CHANGES)
def test_a_factory_is_another_by_whatever_it_refers_to(change):
    before, after = CHANGES[change]
    assert SCRIPT.count(before) == 1
    one, other = ran(SCRIPT), ran(SCRIPT.replace(before, after))
    assert text_of(one.factory) != text_of(other.factory)


def test_it_is_the_same_whatever_name_its_script_is_run_by():
    texts = {text_of(ran(SCRIPT, name).factory) for name in ("__main__", "script", "script")}
    texts |= {text_of(ran("\n\n" + SCRIPT).factory)}
    assert len(texts) == 1 and next(iter(texts)).startswith("factory ")
    assert len({text_of(ran(SCRIPT, name).Scenario()) for name in ("__main__", "script")}) == 1


def test_what_is_compiled_closes_over_or_calls_itself_is_known():
    numba = pytest.importorskip("numba")

    def made(value):
        @numba.njit
        def compiled(x):
            return x * value

        def again(n):
            return again(n - 1) if n else compiled(1.0)

        return again

    assert text_of(made(1.0)) == text_of(made(1.0)) != text_of(made(2.0))


def test_objects_that_tell_about_themselves_are_known_by_their_text():
    assert text_of(sf.CloudScheme(n_points=300)).startswith("CloudScheme(")
    assert text_of(np.float64(1.5)) == repr(np.float64(1.5))


def test_a_folder_is_of_the_code_that_filled_it(tmp_path):
    model, sensor = sf.LinearSDE([[-1.0]], noise=[[1.0]]), sf.GaussianMeasurement([[1.0]], [[0.1]])
    case = sf.Case([1.0], [[0.2]], [[0.3]], np.zeros(1), np.eye(1))
    script = """
class Once:
    name = "once"
    draw = staticmethod(lambda rng: case)
def sph(case, rng):
    return sf.SPHFilter(model, sensor, case.x0, case.P0, config=sf.FilterConfig(target_error=TARGET))
"""
    for target in (0.1, 0.2):
        module = types.ModuleType("camp")
        vars(module).update(sf=sf, case=case, model=model, sensor=sensor, TARGET=target)
        exec(script, vars(module))
        if target == 0.1:
            done = sf.run_campaign(module.Once(), {"sph": module.sph}, 2, seed=1, folder=tmp_path)
            again = sf.run_campaign(module.Once(), {"sph": module.sph}, 2, seed=1, folder=tmp_path)
            np.testing.assert_array_equal(done.results["sph"].x, again.results["sph"].x)
        else:
            with pytest.raises(sf.ConfigError, match="another campaign"):
                sf.run_campaign(module.Once(), {"sph": module.sph}, 2, seed=1, folder=tmp_path)


def test_source_of_the_library_is_known():
    assert code_digest() == code_digest() and len(code_digest()) == 8
