"""How states move: what equations in continuous time and models in discrete time have in common."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._types import BatchFunction, Floats
from ..errors import ModelError
from .compile import Data, Maker, filled
from .domain import Domain, DomainLike
from .named import Adjustable, Values


def compiled(name: str, what: str) -> Any:
    """A property: a compiled function of a model, made when it is first asked for."""

    def function(model: "Dynamics") -> BatchFunction:
        return model._functions[name]

    return property(function, doc=what)


class Dynamics(Adjustable):
    """A model of how states move; parameters are data."""

    _called = "The model"
    _recipe: tuple[Callable[..., Any], dict[str, Any]]
    _functions: Mapping[str, BatchFunction]
    _tail: Floats
    states: tuple[str, ...]
    dim: int
    n_noise: int
    p: Floats
    domain: Domain
    events: Floats
    max_step: float
    constant_diffusion: bool
    state_dependent_noise: bool
    autonomous: bool
    linear: bool
    diffusion_rows: Any

    def _made(
        self, recipe: Any, states: Sequence[str], n_noise: int, tail: Floats, domain: DomainLike
    ) -> None:
        """Set what every model has."""
        self._recipe, self._tail, self.n_noise = recipe, tail, n_noise
        self.states, self.dim = tuple(states), len(states)
        self.domain = Domain.of(domain, self.dim)

    def _set(self, values: Values) -> None:
        super()._set(values)
        self.p = self._data(values.data)

    def _data(self, data: Data) -> Floats:
        """Values and constants as compiled functions take them, writable: read-only is another type there."""
        return np.concatenate([*data, self._tail])

    def breaks(self, t0: float, t1: float) -> Floats:
        """Return the times in [t0, t1] at which the model jumps by itself, sorted."""
        raise NotImplementedError

    def own_steps(self, t0: float, t1: float) -> int:
        """Return the steps of an interval, where accuracy has no say in them; else 0."""
        raise NotImplementedError

    def discretize(self, dt: float) -> tuple[Floats, Floats, Floats]:
        """Return (Phi, offset, Qd) with X(t+dt) = Phi X(t) + offset + N(0, Qd), of a linear model."""
        raise NotImplementedError

    def __reduce__(self) -> tuple[Any, ...]:
        constructor, arguments = self._recipe
        if "parameters" in arguments:
            arguments = arguments | {"parameters": dict(self.parameters), "inputs": dict(self.inputs)}
        return _rebuild, (constructor, arguments, dict(self.inputs))

    def __repr__(self) -> str:
        return f"{type(self).__name__}(states={self.states}, n_noise={self.n_noise})"

    def _evaluate(self, fill: BatchFunction, X: ArrayLike, t: float, *shape: int) -> Floats:
        X = np.array(X, dtype=float, order="C", ndmin=2)
        if X.ndim != 2 or X.shape[1] != self.dim:
            raise ModelError(f"States have shape {np.shape(X)}, but the model needs (N, {self.dim}).")
        return filled(fill, X, t, self.p, *shape)


class Functions(dict[str, BatchFunction]):
    """Compiled functions by name, made when first asked for and shared by all parameter values."""

    def __init__(self, makers: Mapping[str, Maker]) -> None:
        super().__init__()
        self._makers = makers

    def __missing__(self, name: str) -> BatchFunction:
        self[name] = self._makers[name](self)
        return self[name]


def _rebuild(constructor: Callable[..., Any], arguments: dict[str, Any], inputs: dict[str, float]) -> Any:
    return constructor(**arguments).with_inputs(inputs)
