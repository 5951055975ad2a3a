"""Write `sphfilter/API.md`, the page of all public names, from their docstrings.

    python tests/package/api_page.py

Needs the extra `stonesoup`. A name is put under a question here; what stands beside it is the first sentence
of its docstring, and the link leads to the file in which that stands.
"""

import inspect
import re
from functools import cached_property
from pathlib import Path

import sphfilter as sf
from sphfilter.adapters import stonesoup

PAGE = Path(sf.__file__).parent / "API.md"
HEAD = """# Every public name in a line

By the question you ask: the first sentences of the docstrings, with links to the files in which these stand
whole, with shapes, units, errors and an example each; `help(sf.SPHFilter)` prints one. Below a class are its
fields, then its methods and properties. [Recipes by problem](RECIPES.md) have them at work. (Written by
`python tests/package/api_page.py`, in a clone.)
"""
QUESTIONS = {
    "Write down a model": "SDE LinearSDE DiscreteModel correlated_noise Domain Table simulate",
    "Keep it in files": "read_model ModelOfFile",
    "Say what a sensor reads": "GaussianMeasurement LikelihoodMeasurement Sensors",
    "Filter": "SPHFilter PredictInfo UpdateInfo Code FilterResult Forecast",
    "Ask the density": "ParticleDensity",
    "Solve without measurements": "Gaussian Uniform initialize propagate Trajectory predict update "
    "resample ResampleInfo health Health",
    "Judge a filter": "run_campaign Case CampaignResult report Report consistency",
    "Estimate, compare, smooth": "fit_parameters ParameterFit ParameterPosterior profile_evidence "
    "compare_models ModelComparison smooth SmoothedResult",
    "Switching modes": "JumpMarkovModel JumpMarkovFilter JumpMarkovResult simulate_modes",
    "Settings": "FilterConfig SolverConfig LogDensityScheme CloudScheme FamilyScheme "
    "PaperScheme AcceptanceTest compile __version__",
    "Errors": "SphfilterError ModelError ConfigError ExpressionError PropagationError EstimationError",
}
OTHERS = "In Stone Soup: `sphfilter.adapters.stonesoup`"


def page():
    """The whole page."""
    parts = [HEAD]
    for question, names in QUESTIONS.items():
        entries = [line for name in names.split() for line in entry(name, getattr(sf, name))]
        parts.append("\n".join([f"## {question}", "", *entries, ""]))
    entries = [line for name in stonesoup.__all__ for line in entry(name, getattr(stonesoup, name))]
    parts.append("\n".join([f"## {OTHERS}", "", *entries, ""]))
    return "\n".join(parts)


def entry(name, thing):
    """Lines of a name, and of what is inside a class or module."""
    if isinstance(thing, str):
        return [f"- `{name}`: the version, such as {thing!r}."]
    lines = [f"- [`{name}`]({home(thing)}): {sentence(thing)}"]
    if inspect.ismodule(thing):
        inside = {own: getattr(thing, own) for own in thing.__all__}
        return lines + [f"  - [`{name}.{own}`]({home(it)}): {sentence(it)}" for own, it in inside.items()]
    if inspect.isclass(thing):
        base = next((one.__name__ for one in thing.__mro__[1:] if is_public(one)), None)
        lines += [f"  - all of `{base}`"] if base else []
        named = ", ".join(f"`{field}`" for field in fields(thing))
        lines += [f"  - fields: {named}"] if named else []
        lines += [f"  - `.{own}`: {sentence(it)}" for own, it in members(thing).items()]
    return lines


def sentence(thing):
    """First sentence of a docstring."""
    first = " ".join(inspect.getdoc(thing).partition("\n\n")[0].split())
    return re.split(r"(?<=[.?])\s", first)[0]


def home(thing):
    """File of a class, function or module, seen from the page."""
    return Path(inspect.getfile(inspect.unwrap(thing))).relative_to(PAGE.parent).as_posix()


def is_public(kind):
    """Has a class lines of its own?"""
    return kind.__name__ in (*sf.__all__, *stonesoup.__all__)


def family(kind):
    """A class and what it is made of in the library, without what is told of another public class."""
    told = [one for base in kind.__mro__[1:] if is_public(base) for one in base.__mro__]
    own = [one for one in kind.__mro__ if one not in told and one.__module__.startswith("sphfilter.")]
    return own[::-1]


def fields(kind):
    """Public names that hold values: those with a type, and those that the docstring lists as attributes."""
    held = {name: None for one in family(kind) for name in [*inspect.get_annotations(one), *attributes(one)]}
    return [name for name in held if not name.startswith("_") and name not in members(kind)]


def attributes(kind):
    """Names in the section "Attributes" of a docstring."""
    section = re.search(
        r"^Attributes\n-+\n(.*?)(^\w+\n---|\Z)", inspect.getdoc(kind), re.MULTILINE | re.DOTALL
    )
    rows = re.findall(r"^(\w[\w, ]*?)(?: : |$)", section[1], re.MULTILINE) if section else []
    return [name for row in rows for name in row.split(", ")]


def members(kind):
    """Public methods and properties by name."""
    own = {name: thing for one in family(kind) for name, thing in vars(one).items()}
    return {name: thing for name, thing in own.items() if not name.startswith("_") and is_member(thing)}


def is_member(thing):
    """Is it a method or a property, written in the library?"""
    thing = getattr(thing, "fget", thing) if isinstance(thing, property) else thing
    thing = thing.func if isinstance(thing, cached_property) else getattr(thing, "__func__", thing)
    return inspect.isfunction(thing) and thing.__module__.startswith("sphfilter.")


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
