"""Where a density of a filter comes from and what it said last, as arrays that go into a file."""

import numpy as np

from .adapt import Prediction, Update
from .storage import density_from, part, stored, under

__all__ = ["origin_from", "stored_origin"]


def stored_origin(origin, measurement):
    """The last prediction or update of a filter, which it may have to repeat, as arrays.

    An update with another sensor than the filter's own is left out: sensors are code, not data.
    """
    if isinstance(origin, Prediction) and origin.before is not None:
        numbers = {"lost": np.array(origin.lost), "t": np.array(origin.t)}
        return under("before", stored(origin.before)) | numbers
    if isinstance(origin, Update) and origin.measurement is measurement:
        return under("before", stored(origin.before)) | {"z": np.asarray(origin.z, dtype=float)}
    return {}


def origin_from(arrays, model, measurement):
    """The origin of arrays that `stored_origin` made; None if there are none."""
    if not arrays:
        return None
    before = density_from(part("before", arrays))
    if "z" in arrays:
        return Update(before, measurement, arrays["z"])
    return Prediction(before, float(arrays["lost"]), model, float(arrays["t"]))
