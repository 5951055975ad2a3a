"""A filter in a file: its density, where that comes from, and what it said last, as arrays."""

import json
from os import PathLike
from typing import Any

import numpy as np

from ..config import FilterConfig
from ..density.modes import ModeDensities, SplittingError
from ..density.storage import Arrays, density_from, load_arrays, part, stored, under, write_arrays
from ..errors import ModelError
from ..model.dynamics import Dynamics
from ..model.jump_markov import JumpMarkovModel
from ..model.measurements import Sensor
from ..model.named import driven
from ..prediction.predict import Prediction
from ..prediction.switching import ModesPrediction
from .readings import parted
from .state import FilterState, read_only
from .update_again import Update

#: Arguments that make a filter of a model and its measurement, attributes that it is given then, and what is
#: to be replaced in its state.
Restored = tuple[dict[str, Any], dict[str, Any], dict[str, Any]]

#: What a file holds of any state besides the density and where it comes from.
_MOMENTS = "x_prior", "P_prior", "x_post", "P_post"
_READING = "z", "y", "S"
_NUMBERS = "log_likelihood", "log_evidence"


def write(path: str | PathLike[str], state: FilterState[Any], filt: Any) -> None:
    """Write the `FilterState` of a filter to an npz file, and how the filter was made."""
    given = {name: getattr(state, name) for name in (*_MOMENTS, *_READING, *_NUMBERS)}
    arrays = {name: np.asarray(value) for name, value in given.items() if value is not None}
    about = {"states": filt.model.states, "inputs": [*filt.model.inputs], "dim_z": filt.dim_z}
    arrays |= {"config": np.array(filt.config.to_toml()), "about": np.array(json.dumps(about))}
    own = _of_modes if isinstance(state.density, ModeDensities) else _of_particles
    write_arrays(path, arrays | own(state, filt))


def _state_of(arrays: Arrays) -> dict[str, Any]:
    """Fields of any filter's file."""
    state: dict[str, Any] = {name: read_only(arrays[name]) for name in _MOMENTS}
    state |= {name: arrays.get(name) for name in _READING}
    return state | {name: arrays[name].item() for name in _NUMBERS}


def _check(path: str | PathLike[str], arrays: Arrays, model: Any, dim_z: int | None) -> None:
    """Raise `ModelError` where a file is of another model or sensor than those given, as far as it tells."""
    about = json.loads(str(arrays.get("about", "{}")))
    for what, own in (("states", [*model.states]), ("inputs", [*model.inputs])):
        if about.get(what, own) != own:
            was, now = (", ".join(names) or "none" for names in (about[what], own))
            raise ModelError(f"{path} holds a filter of a model with the {what} {was}; that given has {now}")
    if None not in (about.get("dim_z"), dim_z) and about["dim_z"] != dim_z:
        raise ModelError(
            f"{path} holds a filter whose sensor has {about['dim_z']} components; that given has {dim_z}"
        )


def _of_particles(state: FilterState[Any], filt: Any) -> Arrays:
    """Fields of an `SPHFilter`'s file alone."""
    arrays = {"n_particles": np.array(state.n_particles), "adapts": np.array(filt.adapts)}
    arrays |= {} if filt.dt is None else {"dt": np.array(filt.dt)}
    arrays |= {"inputs": np.array(json.dumps(dict(state.inputs)))}
    return arrays | under("density", stored(state.density)) | under("origin", _stored_origin(state))


def restored(path: str | PathLike[str], model: Dynamics, measurement: Sensor | None) -> Restored:
    """Read what `write` wrote of an `SPHFilter`: arguments that make it, its attributes, parts of its state.

    Raises `ModelError` if the file cannot be read or holds no filter.
    """
    arrays = load_arrays(path)
    if "adapts" not in arrays:
        raise ModelError(f"{path} holds no filter: SPHFilter.save writes such files")
    _check(path, arrays, model, getattr(measurement, "dim_z", None))
    n_particles, inputs = int(arrays["n_particles"]), json.loads(str(arrays.get("inputs", "{}")))
    if inputs:
        model = model.with_inputs(inputs)
    options = {
        "n_particles": n_particles,
        "config": FilterConfig.from_toml(str(arrays["config"])),
        "density": density_from(part("density", arrays), (model,)),
    }
    about = {"_adapts": bool(arrays["adapts"]), "dt": float(arrays["dt"]) if "dt" in arrays else None}
    origin = _origin(part("origin", arrays), model, measurement)
    state = _state_of(arrays) | {"n_particles": n_particles, "inputs": inputs, "origin": origin}
    return options, about, state


def _stored_origin(state: FilterState[Any]) -> Arrays:
    """The last prediction or update of a filter, which it may have to repeat, as arrays.

    An update with another sensor than the filter's own is left out: sensors are code, not data. So is one
    that a reading of which nothing came has followed.
    """
    origin = state.origin
    if isinstance(origin, Prediction) and origin.before is not None:
        ends = np.array([t for _, t in origin.earlier])
        numbers = {"lost": np.array(origin.lost), "t": np.array(origin.t), "earlier": ends}
        return under("before", stored(origin.before)) | numbers
    if isinstance(origin, Update) and origin.own:
        z = np.asarray(state.z, dtype=float)
        return under("before", stored(origin.before)) | {"z": z} if np.isfinite(z).any() else {}
    return {}


def _origin(arrays: Arrays, model: Dynamics, measurement: Sensor | None) -> Prediction | Update | None:
    """The origin of arrays that `_stored_origin` made; None if there are none."""
    if not arrays:
        return None
    before = density_from(part("before", arrays), (model,))
    if "z" in arrays:
        if measurement is None:
            return None
        return Update(before, *parted(driven(measurement, model.inputs), arrays["z"]))
    earlier = tuple((model, t) for t in arrays.get("earlier", np.empty(0)).tolist())
    return Prediction(before, float(arrays["lost"]), model, float(arrays["t"]), earlier=earlier)


def _of_modes(state: FilterState[Any], filt: Any) -> Arrays:
    """Fields of a `JumpMarkovFilter`'s file alone."""
    about = {"names": filt.model.names, "n_particles": filt.n_particles, "dt": filt.dt}
    arrays = {"switching": np.array(json.dumps(about | {"inputs": dict(state.inputs)}))}
    arrays |= under("modes", _stored_modes(state.density))
    if state.origin is None:
        return arrays
    how = {"n_substeps": state.origin.n_substeps, "inputs": dict(state.origin.model.inputs)}
    origin = {"how": np.array(json.dumps(how))} | under("before", _stored_modes(state.origin.before))
    return arrays | under("prediction", origin)


def restored_modes(path: str | PathLike[str], model: JumpMarkovModel, _measurement: object) -> Restored:
    """Read what `write` wrote of a `JumpMarkovFilter`, as `restored` does.

    Raises `ModelError` if the file cannot be read, holds no such filter, or one of other modes or states.
    """
    arrays = load_arrays(path)
    if "switching" not in arrays:
        raise ModelError(f"{path} holds no filter of modes: JumpMarkovFilter.save writes such files")
    about = json.loads(str(arrays["switching"]))
    if about["names"] != [*model.names]:
        raise ModelError(f"{path} holds a filter of the modes {about['names']}, not of {[*model.names]}")
    _check(path, arrays, model, None)
    modes = _modes_from(part("modes", arrays))
    mean, cov = modes.moments
    if len(mean) != model.dim:
        raise ModelError(f"{path} holds densities of {len(mean)} states, the model has {model.dim}")
    state = _state_of(arrays) | {"density": modes, "x": read_only(mean), "P": read_only(cov)}
    state |= {"inputs": about["inputs"], "origin": None}
    if last := part("prediction", arrays):
        how = json.loads(str(last["how"]))
        driven_by = model.with_inputs(how["inputs"]) if how["inputs"] else model
        state["origin"] = ModesPrediction(_modes_from(part("before", last)), how["n_substeps"], driven_by)
    made = {"n_particles": about["n_particles"], "config": FilterConfig.from_toml(str(arrays["config"]))}
    return made | {"x0": mean, "P0": cov, "t0": modes.heaviest.t}, {"dt": about["dt"]}, state


def _stored_modes(modes: ModeDensities) -> Arrays:
    """Densities by mode as arrays; `_modes_from` makes the same densities of them, to the last bit."""
    arrays = {"log_w": modes.log_w, "splitting": modes.splitting, "unsure": modes.unsure}
    for i, density in enumerate(modes.densities):
        arrays |= {} if density is None else under(i, stored(density))
    for i, ripple in enumerate(modes.ripples or ()):
        arrays |= under(f"ripple {i}", ripple._asdict())
    return arrays


def _modes_from(arrays: Arrays) -> ModeDensities:
    log_w = arrays["log_w"]
    each = [part(str(i), arrays) for i in range(len(log_w))]
    ripples = []
    for ripple in (part(f"ripple {i}", arrays) for i in range(len(log_w))):
        if ripple:  # files of before tell no mass, nor whether it is exact
            mass, exact = ripple.get("mass", min(ripple["off"].sum(), 1.0)), ripple.get("exact", True)
            ripples.append(SplittingError(ripple["X"], ripple["off"], float(mass), bool(exact)))
    densities = [density_from(some) if some else None for some in each]
    return ModeDensities(log_w, densities, arrays["splitting"], ripples or None, arrays.get("unsure"))
