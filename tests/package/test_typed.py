"""Types: a strict checker accepts a user's script and finds a user's mistakes; every public name has them."""

import inspect
import os
import subprocess
import sys
import typing
from dataclasses import is_dataclass
from functools import cache, cached_property
from pathlib import Path

import pytest

import sphfilter as sf

ROOT = Path(__file__).parents[2]

#: A line of a script, and what a strict checker says of it.
MISTAKES = {
    'flt.predict("nonsense")': "arg-type",
    "flt.update({1: 1.0})": "dict-item",
    "flt.predcit(1.0)": "attr-defined",
    "flt.t = 3.0": "misc",
    "flt.density.maen()": "attr-defined",
    "sf.FilterConfig(target_eror=0.01)": "call-arg",
    'sf.FilterConfig(scheme="papr")': "arg-type",
    "sf.FilterConfig().target_error = 0.1": "misc",
    'sf.SDE.from_expressions(["x"], ["-x"], interpretation="strato")': "arg-type",
    'sf.fit_parameters(flt, [1.0], [0.3], guess="a")': "arg-type",
    "sf.run_campaign(flt, {}, n_runs=1, seed=1)": "arg-type",
}
SCRIPT = """import sphfilter as sf

model, sensor = sf.LinearSDE([[-1.0]], noise=[[1.0]]), sf.GaussianMeasurement([[1.0]], [[0.1]])
flt = sf.SPHFilter(model, sensor, x0=[0.0], P0=[[1.0]])
"""


@pytest.fixture(scope="module")
def checked(tmp_path_factory):
    """Run the checker as a command, as a user of the package would; returns (passed, what it says)."""
    cache = tmp_path_factory.mktemp("mypy")

    def run(script):
        # a user has no settings of this repository, and is told of the script's own errors only
        options = "--strict", "--config-file=", "--follow-imports=silent", "--no-error-summary"
        command = [sys.executable, "-m", "mypy", *options, "--cache-dir", str(cache), str(script)]
        environment = os.environ | {"MYPYPATH": str(ROOT)}
        done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
        return done.returncode == 0, done.stdout + done.stderr

    return run


def test_a_users_script(checked):
    passed, said = checked(ROOT / "tests/package/typed_script.py")
    assert passed, said


def test_a_users_mistakes(checked, tmp_path):
    script = tmp_path / "mistaken.py"
    script.write_text(SCRIPT + "\n".join(MISTAKES) + "\n")
    _, said = checked(script)
    first = len(SCRIPT.splitlines()) + 1
    for number, (line, code) in enumerate(MISTAKES.items(), first):
        found = [told for told in said.splitlines() if f"mistaken.py:{number}: error:" in told]
        assert any(told.endswith(f"[{code}]") for told in found), f"{line}\n{said}"
    assert said.count("error:") == len(MISTAKES), said


@cache
def reachable():
    """Every public function, and every class of the package that annotations lead to from there."""
    waiting = [getattr(sf, name) for name in sf.__all__ if name not in ("__version__", "consistency")]
    waiting += [getattr(sf.consistency, name) for name in sf.consistency.__all__]
    found = {}
    while waiting:
        thing = waiting.pop()
        name = f"{thing.__module__}.{thing.__qualname__}"
        if name not in found and name.startswith("sphfilter.") and not name.startswith("sphfilter.core."):
            found[name] = thing
            waiting += [part for hint in hints(thing) for part in parts(hint)]
    return found


def members(thing):
    """Public functions of a function or class, by name."""
    if inspect.isfunction(thing):
        return {thing.__name__: thing}
    own = {}
    for kind in reversed(thing.__mro__):
        if kind.__module__.startswith("sphfilter."):
            made = "" if getattr(kind, "_is_protocol", False) else "__init__"
            own |= {name: value for name, value in vars(kind).items() if name == made or name[0] != "_"}
    unwrapped = {}
    for name, value in own.items():
        value = getattr(value, "fget", getattr(value, "__func__", value))
        value = value.func if isinstance(value, cached_property) else value
        if inspect.isfunction(value):
            unwrapped[name] = value
    return unwrapped


def hints(thing):
    """Types that the annotations of a function or class, its fields included, are made of."""
    owners = [*members(thing).values(), *([thing] if inspect.isclass(thing) else [])]
    return [hint for owner in owners for hint in typing.get_type_hints(owner, localns=vars(sf)).values()]


def parts(hint):
    """Classes that a type is made of."""
    inside = [part for argument in typing.get_args(hint) for part in parts(argument)]
    return [*inside, hint] if inspect.isclass(hint) else inside


@pytest.mark.parametrize("name", sorted(reachable()))
def test_annotated(name):
    thing = reachable()[name]
    for member, function in members(thing).items():
        signature = inspect.signature(function, follow_wrapped=False)
        names = list(signature.parameters)[0 if inspect.isfunction(thing) else 1 :]
        bare = [p for p in names if signature.parameters[p].annotation is inspect.Parameter.empty]
        assert not bare, f"{name}.{member} has no types of {bare}"
        assert signature.return_annotation is not inspect.Signature.empty, f"{name}.{member} returns what?"
    if is_dataclass(thing):
        assert object not in typing.get_type_hints(thing, localns=vars(sf)).values(), (
            f"{name} has fields of any kind"
        )
