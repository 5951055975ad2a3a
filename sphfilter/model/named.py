"""Values by name: parameters of models and sensors, and inputs."""

from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from .. import validate
from ..errors import ModelError, nearest, plain
from .compile import Data

#: Names of inputs, or their values where a prediction gives none.
Inputs: TypeAlias = Sequence[str] | Mapping[str, float]
#: Values of inputs, in their order or by name.
InputValues: TypeAlias = ArrayLike | Mapping[str, float]
#: Values of inputs at each of T times: (T, m), (T,) of one input, or columns (T,) by name.
InputRecord: TypeAlias = ArrayLike | Mapping[str, ArrayLike]


class Values(NamedTuple):
    """Values of parameters and inputs by name."""

    parameters: dict[str, float]
    inputs: dict[str, float]

    @classmethod
    def of(cls, parameters: Mapping[str, float] | None, inputs: Inputs | None) -> "Values":
        """Values as they are given; inputs of which there are names only are zero."""
        given = inputs if isinstance(inputs, Mapping) else dict.fromkeys(_listed(inputs), 0.0)
        found = cls(_named("parameter", parameters), _named("input", given))
        twice = set(found.parameters) & set(found.inputs)
        if twice:
            raise ModelError(f"{min(twice)!r} is a parameter and an input; each needs a name of its own")
        return found

    @property
    def data(self) -> Data:
        """Values as compiled functions take them."""
        p, u = (np.array([*values.values()], dtype=float) for values in self)
        return Data(p, u)


def _listed(inputs: Inputs | None) -> list[str]:
    """Names of inputs, each once."""
    names = [] if inputs is None else inputs
    listed = isinstance(names, Sequence) and not isinstance(names, str)
    if not listed or not all(isinstance(n, str) for n in names):
        raise ModelError(f"inputs lists names, such as inputs=['a'], or maps them to values; got {inputs!r}")
    if len(set(names)) < len(names):
        raise ModelError(f"inputs names one twice: {list(names)}")
    return list(names)


def _named(kind: str, values: Mapping[str, float] | None) -> dict[str, float]:
    """Finite numbers by name; kind says what they are, for messages."""
    return {str(name): validate.real(f"{kind} {name}", value) for name, value in dict(values or {}).items()}


def changed(
    kind: str, known: Mapping[str, float], changes: Mapping[str, float], whose: str
) -> dict[str, float]:
    """Values by name with some of them changed.

    Raises `ModelError` for an unknown name (the nearest is named), or a value that is not one finite number.
    """
    known_as = {plain(name): name for name in known}
    own = {known_as.get(plain(name), name): value for name, value in changes.items()}
    for name in own:
        if name not in known:
            listed = ", ".join(known) or "none"
            raise ModelError(f"{whose} has no {kind} {name!r}{nearest(name, known)}; it has: {listed}.")
    return _named(kind, {**known, **own})


def check_parameters(names: Iterable[str], *owners: Any) -> None:
    """Raise `ModelError` for a name that is a parameter of neither model nor sensor: the nearest is named."""
    known = [*dict.fromkeys(name for owner in owners for name in getattr(owner, "parameters", {}))]
    for name in names:
        if name not in known:
            listed = ", ".join(known) or "none"
            raise ModelError(
                f"model and sensor have no parameter {name!r}{nearest(name, known)}; they have: {listed}"
            )


def parametrised(owner: Any, parameters: Mapping[str, float]) -> Any:
    """A model, sensor or None with those of the parameters that it has."""
    known = getattr(owner, "parameters", {})
    own = {name: value for name, value in parameters.items() if name in known}
    return owner.with_parameters(**own) if own else owner


def shared(kind: str, parts: Mapping[str, Any]) -> Mapping[str, float]:
    """Parameters or inputs of all parts by name; raises `ModelError` where two have different values."""
    found: dict[str, float] = {}
    for whose, part in parts.items():
        for name, value in getattr(part, kind, {}).items():
            if found.setdefault(name, value) != value:
                raise ModelError(
                    f"{whose!r} and one before it give {name!r} different values, {value:g} and "
                    f"{found[name]:g}: give it one value in all, or two names"
                )
    return MappingProxyType(found)


class Adjustable:
    """A thing that has parameters and inputs by name: with other values of them nothing is compiled again."""

    _called: ClassVar[str]
    _values: Values
    parameters: Mapping[str, float]
    inputs: Mapping[str, float]

    def with_parameters(self, **changes: float) -> Self:
        """Return the same with other parameter values; nothing is compiled again.

        Raises `ModelError` for an unknown name, or a value that is not one finite number.
        """
        return self._with(parameters=changed("parameter", self.parameters, changes, self._called))

    def with_inputs(self, u: InputValues) -> Self:
        """Return the same with these values of its inputs; nothing is compiled again.

        Parameters
        ----------
        u : array_like (m,), number, or mapping of str to float
            Values in the order of `inputs`, or by name; those that a mapping does not name stay.

        Raises `ModelError` for an unknown name, another number of values, or one that is not finite.
        """
        return self._with(inputs=input_values(self.inputs, u, self._called))

    def _with(self, **changes: dict[str, float]) -> Self:
        new = self._copied()
        new._set(self._values._replace(**changes))
        return new

    def _copied(self) -> Self:
        new = object.__new__(type(self))
        new.__dict__.update(self.__dict__)
        return new

    def _set(self, values: Values) -> None:
        """Take values, and what follows from them."""
        self._values, (self.parameters, self.inputs) = values, map(MappingProxyType, values)


def input_values(known: Mapping[str, float], u: InputValues, whose: str = "The model") -> dict[str, float]:
    """Values of inputs, given in their order or by name; those that a mapping does not name stay.

    Raises `ModelError` for an unknown name, another number of values, or one that is not finite.
    """
    if isinstance(u, Mapping):
        return changed("input", known, u, whose)
    if not known:
        raise ModelError(f"u = {validate.short(u)} is given, but {whose.lower()} has no inputs: inputs=[...]")
    row = np.ravel(np.asanyarray(u))
    if row.dtype == bool:
        raise ModelError(f"u must be numbers, got {validate.short(u)}")
    values = validate.array("u", row, (len(known),), f"a value for each input: {', '.join(known)}")
    return dict(zip(known, map(float, values), strict=True))


def each_input(names: Iterable[str], record: InputRecord | None, count: int) -> list[dict[str, float] | None]:
    """Values of inputs by name, for each of `count` intervals; None each where nothing is given.

    Raises `ModelError` for another number of rows or columns, a name that is no input, or values that are not
    finite.
    """
    if record is None:
        return [None] * count
    names = [*names]
    if isinstance(record, Mapping):
        changed("input", dict.fromkeys(names, 0.0), dict.fromkeys(record, 0.0), "The model")
        what = "a value for each time, held over the interval that ends there"
        columns = [validate.array(f"input {name}", column, (count,), what) for name, column in record.items()]
        rows: Any = np.column_stack(columns) if columns else np.empty((count, 0))
        return [dict(zip(record, row, strict=True)) for row in rows.tolist()]
    what = f"a row for each time, a column for each input ({', '.join(names) or 'the model has none'})"
    known: Any = record
    column = isinstance(known, Sequence | np.ndarray) and all(np.ndim(value) == 0 for value in known)
    given = [[value] for value in known] if column else known
    rows = validate.array("inputs", given, (count, len(names)), what)
    return [dict(zip(names, row, strict=True)) for row in rows.tolist()]


def driven(sensor: Any, inputs: Mapping[str, float]) -> Any:
    """Return a sensor with these values of inputs, as far as it has inputs of their names."""
    shared = {name: inputs[name] for name in getattr(sensor, "inputs", ()) if name in inputs}
    return sensor.with_inputs(shared) if shared else sensor
