"""Attributes that a filter refuses to be given, with the name to use instead."""

from collections.abc import Iterable
from difflib import get_close_matches

from ..errors import ModelError
from .state import Shown

__all__ = ["check_assigned"]

#: Names of filterpy's filters, and what stands for them here.
_FILTERPY = {
    "R": "give update(z, R=...), or a measurement=GaussianMeasurement(h, noise_cov=R)",
    "H": "give update(z, R, H), or a measurement=GaussianMeasurement(h=H, noise_cov=R)",
    "hx": "give a measurement=GaussianMeasurement(h=hx, noise_cov=R)",
    "Q": "process noise belongs to the model: SDE(..., noise=g, spectral_density=Q)",
    "F": "dynamics belong to the model: SDE(drift=...) or LinearSDE(A)",
    "fx": "dynamics belong to the model: SDE(drift=fx, ...), in continuous time",
    "B": "write the control into the drift of the model",
    "K": "a filter that carries the density has no gain",
    "inv": "a filter that carries the density inverts no innovation covariance",
    "residual_x": "say which states go round with SDE(..., domain=)",
    "residual_z": "say which readings are angles with GaussianMeasurement(..., angles=)",
}
_MIXED = {"x": "mean", "P": "covariance"}
_NEAR = 0.75  # likeness of two names from which one is taken for the other mistyped


def check_assigned(name: str, cls: type, base: type) -> None:
    """Raise `ModelError` if a filter of a class must not be given an attribute of this name.

    Parameters
    ----------
    name : str
    cls : type
        The filter's: subclasses of `base` may carry what attributes they like.
    base : type
        The library's own filter.
    """
    subclasses = (parent for parent in cls.__mro__ if parent not in base.__mro__)
    own = (known for parent in subclasses for known in _declared(parent))
    if name.startswith("_") or name in _SETTABLE or name in own:
        return
    if name in _MIXED:
        raise ModelError(
            f"the {_MIXED[name]} of a density filter cannot be overwritten (IMM mixing does that); "
            f"make a new {base.__name__} with x0 and P0"
        )
    if hasattr(Shown, name):
        raise ModelError(f"{name} is what a density filter has found: it is read, not set")
    if cls is base and name in _FILTERPY:
        raise ModelError(f"{base.__name__} has no {name} to be set: {_FILTERPY[name]}")
    near = get_close_matches(name, _SETTABLE, n=1, cutoff=_NEAR)
    if cls is base and near:
        raise ModelError(f"{base.__name__} has no attribute {name!r} (did you mean {near[0]!r}?)")


_SETTABLE = "model", "measurement", "config", "dt", "n_particles", "log_evidence"


def _declared(cls: type) -> Iterable[str]:
    return {*vars(cls), *vars(cls).get("__annotations__", {})}
