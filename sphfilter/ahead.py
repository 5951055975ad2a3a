"""Compiling ahead of time: for images, containers and machines that are to answer at once."""

from time import perf_counter
from typing import Any

from .config import CloudScheme, FamilyScheme, FilterConfig, LogDensityScheme
from .filter.jump_markov_filter import JumpMarkovFilter
from .filter.sph_filter import SPHFilter
from .inference.smoother import smooth
from .model.discrete import DiscreteModel
from .model.jump_markov import JumpMarkovModel
from .model.measurements import GaussianMeasurement
from .model.sde import SDE
from .model.simulate import simulate

_SCHEMES: tuple[Any, ...] = "auto", CloudScheme(), LogDensityScheme(), FamilyScheme()


def compile() -> float:
    """Compile what filters call, and keep it in the folder that `sphfilter` names while it compiles.

    That is done once an installation; without a call it is done when something is first needed, and a line
    says so. What a model in text, or of functions, is compiled to is its own.

    Returns
    -------
    float
        Seconds that it took: some two minutes where nothing is kept, a few seconds where all is.

    Examples
    --------
    >>> import sphfilter as sf
    >>> print(sf.compile() < 600.0)
    True
    """
    began, start = perf_counter(), ([0.3, 0.1], [[0.2, 0.0], [0.0, 0.2]])
    texts = ["y", "x - x**3 - 0.3*y"], [["0"], ["0.5"]]
    model = SDE.from_expressions(["x", "y"], *texts)
    steps = DiscreteModel.from_expressions(["x", "y"], ["x + 0.1*y", "y + 0.1*sin(x)"], [["0.1"], ["0.5"]])
    sensor = GaussianMeasurement.from_expressions(["x", "y"], ["x + x**2/9"], [[0.1]])
    configs = [FilterConfig(scheme=scheme) for scheme in _SCHEMES]
    filters = [SPHFilter(model, sensor, *start, config=config) for config in configs]
    filters += [SPHFilter(steps, sensor, *start, config=config) for config in configs[:2]]
    switching = JumpMarkovModel({"a": model, "b": SDE.from_expressions(["x", "y"], ["y", "-x"], texts[1])},
                                [[-0.1, 0.1], [0.1, -0.1]])  # fmt: skip
    times, (_, z) = [0.2, 0.4], simulate(model, sensor, start[0], [0.0, 0.2, 0.4], rng=1)
    every: list[Any] = [*filters, JumpMarkovFilter(switching, sensor, *start)]
    for flt in every:
        flt.run([1.0, 2.0] if flt.model is steps else times, z[1:])
    filters[0].forecast([0.6], events={"over": lambda X: X[:, 0]})
    for flt in filters[:4]:
        flt.density.probability(lambda X: X[:, 0] > 0.0), flt.density.mode()
    smooth(SPHFilter(model, sensor, *start), times, z[1:])
    SPHFilter(model, sensor.changed(1e-6), *start).run(times, z[1:])  # what leads points to a sharp reading
    return perf_counter() - began
