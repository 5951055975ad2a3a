"""Names that a filter refuses, to be read, set or given, with what to use instead."""

from collections.abc import Callable
from difflib import get_close_matches

from .. import validate
from ..errors import MissingNameError, ModelError
from ..validate import Given, Returned

_IN_MODEL = (
    "dynamics belong to the model: SDE, LinearSDE(A), in discrete time DiscreteModel.from_matrices(F, Q)"
)
_SIGMAS = "a filter that carries the density has no sigma points"
_LINEARISED = "nothing is linearised: give h alone, update(z, R, h), or as the h of a GaussianMeasurement"
_INPUTS = "controls are inputs of the model, SDE(..., inputs=[...]), LinearSDE(A, B=B): predict(dt, u=...)"
#: What stands here for names of filterpy's filters.
_INSTEAD = {
    "R": "give update(z, R=...), or a measurement=GaussianMeasurement(h, noise_cov=R), its noise_cov",
    "H": "give update(z, R, H), or a measurement=GaussianMeasurement(h=H, noise_cov=R), its H",
    "hx": "give update(z, R, hx), or a measurement=GaussianMeasurement(h=hx, noise_cov=R)",
    "Q": "process noise belongs to the model: SDE(..., spectral_density=Q), DiscreteModel(..., covariance=Q)",
    "F predict_x": _IN_MODEL,
    "fx": "dynamics belong to the model: DiscreteModel(fx, dim, covariance=Q), or an SDE in continuous time",
    "B u dim_u": _INPUTS,
    "K": "a filter that carries the density has no gain",
    "inv": "a filter that carries the density inverts no innovation covariance; SI is its inverse",
    "alpha": "fading memory is process noise: a larger spectral_density of the model",
    "M": "noise of process and measurement that is correlated is made by sf.correlated_noise",
    "residual_x x_mean": "say which states go round with SDE(..., domain=)",
    "residual_z residual z_mean": "say which readings are angles with GaussianMeasurement(..., angles=)",
    "residual_of": "take z - measurement.predict(flt.x_prior, flt.t)[0]",
    "measurement_of_state": "take measurement.predict(x, flt.t)[0]",
    "log_likelihood_of": "take sf.update(flt.density, measurement, z)[1].log_evidence",
    "get_prediction": "take sf.predict(flt.density, model, dt)",
    "get_update": "take sf.update(flt.density, measurement, z)",
    "predict_update": "call predict(dt), then update(z)",
    "predict_steadystate": "call predict(dt)",
    "update_steadystate": "call update(z)",
    "update_correlated": "take model and sensor of sf.correlated_noise(model, sensor, cross), and update(z)",
    "update_sequential": "call update(z, measurement=...) once a sensor",
    "batch_filter": "give the whole record to run(times, measurements)",
    "rts_smoother": "take sf.smooth(flt, times, measurements)",
    "test_matrix_dimensions": "shapes are checked when the model, the sensor and the filter are made",
    "HJacobian Hx": _LINEARISED,
    "dim_x dim_z": "the model and the sensor say it: SPHFilter(model, measurement, x0, P0)",
    "points points_fn sigmas_f sigmas_h UT compute_process_sigmas Wm Wc": _SIGMAS,
    "args hx_args": "a function of other arguments is written as lambda x: h(x, ...)",
    "fx_args": "numbers that a model depends on are its parameters: SDE(..., parameters={...})",
    "window": "the number of steps that are kept is given when the filter is made: SPHFilter(..., window=)",
    "compute_log_likelihood": "the log_likelihood is always there",
}
_FILTERPY = {name: said for names, said in _INSTEAD.items() for name in names.split()}
_MIXED = {"x": "mean", "P": "covariance"}
#: Likeness of two names, 2 · letters alike / letters of both, from which one is taken for the other mistyped:
#: of eight letters two may differ, 2 · 6 / 16 = .75.
_NEAR = 0.75


def check_assigned(name: str, cls: type, base: type) -> None:
    """Raise `ModelError` if a filter of a class must not be given an attribute of this name.

    `base` is the library's own filter: subclasses of it may carry what attributes they like.
    """
    if name.startswith("_") or name in _SETTABLE:
        return
    subclasses = (parent for parent in cls.__mro__ if parent not in base.__mro__)
    if any(name in {*vars(kind), *vars(kind).get("__annotations__", {})} for kind in subclasses):
        return
    if name in _MIXED:
        raise ModelError(
            f"the {_MIXED[name]} of a density filter cannot be overwritten (IMM mixing does that); "
            f"make a new {base.__name__} with x0 and P0"
        )
    if isinstance(getattr(base, name, None), property):
        raise ModelError(f"{name} is what a density filter has found: it is read, not set")
    if cls is base and name in _FILTERPY:
        raise ModelError(f"{base.__name__} has no {name} to be set: {_FILTERPY[name]}")
    near = get_close_matches(name, _SETTABLE, n=1, cutoff=_NEAR)
    if cls is base and near:
        raise ModelError(f"{base.__name__} has no attribute {name!r} (did you mean {near[0]!r}?)")


def check_read(name: str, cls: type) -> None:
    """Raise `MissingNameError` if a filter has another word for an attribute that it has not."""
    if name in _FILTERPY:
        raise MissingNameError(f"{cls.__name__} has no {name}: {_FILTERPY[name]}")


def suggest_keyword(method: Callable[Given, Returned]) -> Callable[Given, Returned]:
    """Let a method say what to give instead of a keyword that it has not: one of filterpy's, or a typo."""
    return validate.keywords(method, _FILTERPY)


_SETTABLE = "model", "measurement", "config", "dt", "n_particles", "log_evidence"
