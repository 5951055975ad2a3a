"""Densities, models and settings in Stone Soup's YAML: arrays, numbers and text, nothing that could run."""

import base64
import json
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from typing import Any, NoReturn

import numpy as np
from ruamel.yaml.constructor import ConstructorError
from stonesoup.base import Base

from ...config import FilterConfig
from ...density.modes import ModeDensities
from ...density.particle_density import ParticleDensity
from ...density.storage import from_bytes, to_bytes
from ...errors import ModelError, SphfilterError
from ...info import PredictInfo, ResampleInfo, UpdateInfo
from ...model.discrete import DiscreteModel
from ...model.domain import Domain
from ...model.dynamics import Dynamics
from ...model.jump_markov import JumpMarkovModel
from ...model.likelihood import LikelihoodMeasurement
from ...model.measurements import GaussianMeasurement
from ...model.sde import SDE, LinearSDE
from ...model.tables import Table

_OURS = "sphfilter.adapters.stonesoup."
_CODE = (
    "{} is a Python function, which YAML cannot hold: write the model as text (from_expressions), or keep it "
    "with pickle"
)


def extend(yaml: Any) -> None:
    """Teach a `stonesoup.serialise.YAML` the classes of this package.

    Installed, the package has this done by its entry point in the group stonesoup.serialise.yaml.
    """
    for kind, (write, read) in _FORMS.items():
        tag = f"!sphfilter.{kind.__name__}"
        yaml.representer.add_representer(kind, partial(_represented, tag, write))
        yaml.constructor.add_constructor(tag, partial(_constructed, read))
    yaml.constructor.add_multi_constructor(f"!{_OURS}", _component_from_yaml)


def _represented(tag: str, write: Callable[[Any], str], representer: Any, value: Any) -> Any:
    text = write(value)
    return representer.represent_scalar(tag, text, style="|" if "\n" in text else None)


def _constructed(read: Callable[[str], Any], constructor: Any, node: Any) -> Any:
    try:
        return read(str(constructor.construct_scalar(node)))
    except (SphfilterError, ValueError, TypeError, KeyError) as problem:
        raise ConstructorError(f"while reading a {node.tag}", node.start_mark, str(problem)) from problem


def _component_from_yaml(constructor: Any, tag_suffix: str, node: Any) -> Base:
    """As Stone Soup makes its own components, of the classes of this package."""
    name = _OURS + tag_suffix
    found = [kind for kind in Base.subclasses if f"{kind.__module__}.{kind.__qualname__}" == name]
    if not found:
        raise ConstructorError("while reading a component", node.start_mark, f"there is no {name}")
    constructor.deep_construct = True  # parts have to be complete before the whole is made
    (properties,) = list(constructor.construct_yaml_omap(node))  # yielded empty, filled when asked on
    try:
        return found[0](**properties)
    except (SphfilterError, TypeError) as problem:
        raise ConstructorError("while reading a component", node.start_mark, str(problem)) from problem


def _model_text(model: Dynamics) -> str:
    _, (constructor, arguments, inputs) = model.__reduce__()
    if constructor in (SDE, DiscreteModel):
        raise ModelError(_CODE.format(f"a function of this {constructor.__name__}"))
    if isinstance(model, LinearSDE):
        arguments = arguments | {"u": inputs}
    return _json(arguments)


def _linear_from(text: str) -> LinearSDE:
    parts = json.loads(text)
    inputs = parts.pop("u", {})
    return LinearSDE(**parts).with_inputs(inputs)


def _sensor_from(text: str) -> GaussianMeasurement:
    parts = json.loads(text)
    make: Any = GaussianMeasurement.from_expressions if "states" in parts else GaussianMeasurement
    return make(**parts)


def _refused(sensor: object) -> NoReturn:
    raise ModelError(_CODE.format("the likelihood of a LikelihoodMeasurement"))


def _refused_modes(value: object) -> NoReturn:
    raise ModelError(
        f"YAML holds no {type(value).__name__}, nor other parts of models that switch: keep them with pickle"
    )


def _info_text(info: PredictInfo | UpdateInfo) -> str:
    return json.dumps(_plain("info", asdict(info)))


def _prediction_from(text: str) -> PredictInfo:
    parts = json.loads(text)
    return PredictInfo(**parts | {"skipped": tuple(parts["skipped"])})


def _update_from(text: str) -> UpdateInfo:
    parts = json.loads(text)
    for name in ("innovation", "innovation_cov"):
        if parts[name] is not None:
            parts[name] = np.array(parts[name])
    if parts["resample"] is not None:
        whole: dict[str, Any] = {
            k: tuple(v) if isinstance(v, list) else v for k, v in parts["resample"].items()
        }
        parts["resample"] = ResampleInfo(**whole)
    return UpdateInfo(**parts)


def _json(arguments: dict[str, Any]) -> str:
    given = {name: value for name, value in arguments.items() if value is not None}
    return json.dumps({name: _plain(name, value) for name, value in given.items()})


def _plain(name: str, value: Any) -> Any:
    """Numbers, text, lists and mappings of a value."""
    if callable(value):
        raise ModelError(_CODE.format(f"the {name} of this model"))
    if isinstance(value, Domain):
        value = value.axes
    if isinstance(value, Table):
        value = (value.at, value.values, value.kind)
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, dict):
        return {key: _plain(key, part) for key, part in value.items()}
    return [_plain(name, part) for part in value] if isinstance(value, list | tuple) else value


#: Class: how it becomes text, and is made of it.
_FORMS: dict[type, tuple[Callable[[Any], str], Callable[[str], Any]]] = {
    ParticleDensity: (
        lambda density: base64.encodebytes(to_bytes(density)).decode(),
        lambda text: from_bytes(base64.decodebytes(text.encode())),
    ),
    SDE: (_model_text, lambda text: SDE.from_expressions(**json.loads(text))),
    DiscreteModel: (_model_text, lambda text: DiscreteModel.from_expressions(**json.loads(text))),
    LinearSDE: (_model_text, _linear_from),
    GaussianMeasurement: (lambda sensor: _json(sensor.__reduce__()[1][1]), _sensor_from),
    LikelihoodMeasurement: (_refused, _refused),
    JumpMarkovModel: (_refused_modes, _refused_modes),
    ModeDensities: (_refused_modes, _refused_modes),
    FilterConfig: (FilterConfig.to_toml, FilterConfig.from_toml),
    PredictInfo: (_info_text, _prediction_from),
    UpdateInfo: (_info_text, _update_from),
}
