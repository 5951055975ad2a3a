"""A filter of a model that switches in a file: the densities of its modes, and what it said last."""

import json
from os import PathLike
from typing import Any

import numpy as np

from ..config import FilterConfig
from ..density.modes import ModeDensities, Ripple
from ..density.storage import Arrays, density_from, load_arrays, part, stored, under, write_arrays
from ..errors import ModelError
from ..model.jump_markov import JumpMarkovModel
from ..prediction.switching import ModesPrediction
from .found import found
from .jump_markov_state import JumpMarkovState

__all__ = ["restored_modes", "write_modes"]

_MOMENTS = "x_prior", "P_prior", "x_post", "P_post"
_NUMBERS = "log_likelihood", "log_evidence"
_READING = "z", "y", "S"


def write_modes(path: str | PathLike[str], state: JumpMarkovState, filt: Any) -> None:
    """Write the state of a filter to an npz file, and how the filter was made."""
    given = {name: getattr(state, name) for name in (*_MOMENTS, *_NUMBERS, *_READING)}
    arrays = {name: np.asarray(value) for name, value in given.items() if value is not None}
    about = {"names": filt.model.names, "n_particles": filt.n_particles, "dt": filt.dt}
    arrays |= {"switching": np.array(json.dumps(about | {"inputs": dict(state.inputs)}))}
    arrays |= {"config": np.array(filt.config.to_toml())} | under("modes", _stored(state.modes))
    write_arrays(path, arrays | under("prediction", _stored_prediction(state.prediction)))


def restored_modes(
    path: str | PathLike[str], model: JumpMarkovModel
) -> tuple[dict[str, Any], JumpMarkovState]:
    """Read what `write_modes` wrote: arguments that make a filter of the model, and its state.

    Raises
    ------
    ModelError
        The file cannot be read, holds no such filter, or one of other modes or states.
    """
    arrays = load_arrays(path)
    if "switching" not in arrays:
        raise ModelError(f"{path} holds no filter of modes: JumpMarkovFilter.save writes such files")
    about = json.loads(str(arrays["switching"]))
    if about["names"] != [*model.names]:
        raise ModelError(f"{path} holds a filter of the modes {about['names']}, not of {[*model.names]}")
    modes = _modes_from(part("modes", arrays))
    mean, cov = modes.moments
    if len(mean) != model.dim:
        raise ModelError(f"{path} holds densities of {len(mean)} states, the model has {model.dim}")
    values: dict[str, Any] = {name: found(arrays[name]) for name in _MOMENTS}
    values |= {name: arrays[name].item() for name in _NUMBERS}
    values |= {name: arrays.get(name) for name in _READING}
    values["prediction"] = _prediction(part("prediction", arrays), model)
    state = JumpMarkovState(modes=modes, inputs=about["inputs"], **values)
    made = {name: about[name] for name in ("n_particles", "dt")}
    config = FilterConfig.from_toml(str(arrays["config"]))
    return made | {"x0": mean, "P0": cov, "t0": modes.heaviest.t, "config": config}, state


def _stored_prediction(prediction: ModesPrediction | None) -> Arrays:
    """The last prediction of a filter, which it may have to repeat, as arrays."""
    if prediction is None:
        return {}
    how = {"n_substeps": prediction.n_substeps, "inputs": dict(prediction.model.inputs)}
    return {"how": np.array(json.dumps(how))} | under("before", _stored(prediction.before))


def _prediction(arrays: Arrays, model: JumpMarkovModel) -> ModesPrediction | None:
    """The prediction of arrays that `_stored_prediction` made; None if there are none."""
    if not arrays:
        return None
    how = json.loads(str(arrays["how"]))
    driven = model.with_inputs(how["inputs"]) if how["inputs"] else model
    return ModesPrediction(_modes_from(part("before", arrays)), how["n_substeps"], driven)


def _stored(modes: ModeDensities) -> Arrays:
    """Densities by mode as arrays; `_modes_from` makes the same of them, to the last bit."""
    arrays = {"log_w": modes.log_w, "splitting": modes.splitting}
    for i, density in enumerate(modes.densities):
        arrays |= {} if density is None else under(i, stored(density))
    for i, ripple in enumerate(modes.ripples or ()):
        arrays |= under(f"ripple {i}", ripple._asdict())
    return arrays


def _modes_from(arrays: Arrays) -> ModeDensities:
    log_w = arrays["log_w"]
    each = [part(str(i), arrays) for i in range(len(log_w))]
    ripples = [Ripple(**part(f"ripple {i}", arrays)) for i in range(len(log_w)) if f"ripple {i}.X" in arrays]
    densities = [density_from(some) if some else None for some in each]
    return ModeDensities(log_w, densities, arrays["splitting"], ripples or None)
