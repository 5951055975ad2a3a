"""A filter in a file: its density, where that comes from, and what it said last, as arrays."""

import json
from os import PathLike
from typing import Any

import numpy as np

from ..config import FilterConfig
from ..density.storage import Arrays, density_from, load_arrays, part, stored, under, write_arrays
from ..errors import ModelError
from ..model.measurements import Sensor
from ..model.named import driven
from ..model.sde import SDE
from ..prediction.predict import Prediction
from .found import found
from .readings import parted
from .state import FilterState
from .update_again import Update

__all__ = ["restored", "write"]

#: What a file holds besides the density and where it comes from.
_MOMENTS = "x_prior", "P_prior", "x_post", "P_post"
_STATE = ("n_particles", "z", "y", "S", "log_likelihood", "log_evidence", *_MOMENTS)


def write(path: str | PathLike[str], state: FilterState, filt: Any) -> None:
    """Write the `FilterState` of a filter to an npz file, and how the filter was made."""
    given = {name: getattr(state, name) for name in _STATE} | {"dt": filt.dt}
    arrays = {name: np.asarray(value) for name, value in given.items() if value is not None}
    arrays |= {"config": np.array(filt.config.to_toml()), "adapts": np.array(filt.adapts)}
    arrays |= {"inputs": np.array(json.dumps(dict(state.inputs)))}
    arrays |= under("density", stored(state.density))
    write_arrays(path, arrays | under("origin", _stored_origin(state)))


def restored(
    path: str | PathLike[str], model: SDE, measurement: Sensor | None
) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Read what `write` wrote.

    Returns
    -------
    dict, dict, dict
        Arguments that make a filter of the model and the measurement, attributes that it is given then, and
        what is to be replaced in its state.

    Raises
    ------
    ModelError
        The file cannot be read or holds no filter.
    """
    arrays = load_arrays(path)
    if "adapts" not in arrays:
        raise ModelError(f"{path} holds no filter: SPHFilter.save writes such files")
    options: dict[str, Any] = {
        "n_particles": int(arrays["n_particles"]),
        "config": FilterConfig.from_toml(str(arrays["config"])),
    }
    state: dict[str, Any] = {name: arrays.get(name) for name in _STATE}
    for name in _MOMENTS:
        state[name] = found(state[name])
    state = {k: v.item() if v is not None and v.ndim == 0 else v for k, v in state.items()}
    state["inputs"] = json.loads(str(arrays.get("inputs", "{}")))
    if state["inputs"]:
        model = model.with_inputs(state["inputs"])
    options["density"] = density_from(part("density", arrays), (model,))
    state["origin"] = _origin(part("origin", arrays), model, measurement)
    about = {"_adapts": bool(arrays["adapts"]), "dt": float(arrays["dt"]) if "dt" in arrays else None}
    return options, about, state


def _stored_origin(state: FilterState) -> Arrays:
    """The last prediction or update of a filter, which it may have to repeat, as arrays.

    An update with another sensor than the filter's own is left out: sensors are code, not data. So is one
    that a reading of which nothing came has followed.
    """
    origin = state.origin
    if isinstance(origin, Prediction) and origin.before is not None:
        numbers = {"lost": np.array(origin.lost), "t": np.array(origin.t)}
        return under("before", stored(origin.before)) | numbers
    if isinstance(origin, Update) and origin.own:
        z = np.asarray(state.z, dtype=float)
        return under("before", stored(origin.before)) | {"z": z} if np.isfinite(z).any() else {}
    return {}


def _origin(arrays: Arrays, model: SDE, measurement: Sensor | None) -> Prediction | Update | None:
    """The origin of arrays that `_stored_origin` made; None if there are none."""
    if not arrays:
        return None
    before = density_from(part("before", arrays), (model,))
    if "z" in arrays:
        if measurement is None:
            return None
        return Update(before, *parted(driven(measurement, model.inputs), arrays["z"]))
    return Prediction(before, float(arrays["lost"]), model, float(arrays["t"]))
