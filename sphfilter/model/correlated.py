"""Noise of the sensor that is correlated with that of the model: what they share becomes a state."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .. import validate
from .._types import Floats
from ..core.limits import ROUNDING
from ..errors import ModelError
from .discrete import DiscreteModel
from .measurements import GaussianMeasurement


def correlated_noise(
    model: DiscreteModel, sensor: GaussianMeasurement, cross: ArrayLike
) -> tuple[DiscreteModel, GaussianMeasurement]:
    """A model and a sensor whose noises are correlated, as a model and a sensor whose noises are not.

    Of a step x' = F(x) + g w and a reading z = h(x') + v at its end, Cov(w, v) = S. The noise w of the last
    step becomes m more states, w0, w1, ...; v is S^T Q^-1 w and a rest that has nothing to do with it, of
    covariance R - S^T Q^-1 S. That is exact, of linear models Kalman's filter with correlated noise.

    Parameters
    ----------
    model : DiscreteModel
        Of n states and m noises of covariance Q.
    sensor : GaussianMeasurement
        Of k readings, whose R is a matrix.
    cross : array_like, shape (m, k)
        S, covariance of the model's noise with the sensor's.

    Returns
    -------
    DiscreteModel, GaussianMeasurement
        Of n + m states. A filter begins with any numbers for the last m, such as a mean of 0 and covariance
        Q. Parameters and inputs of a transition or an h that is a function keep the values that they have.

    Raises
    ------
    ModelError
        No such model or sensor, or noises that cannot be so correlated. Of equations in continuous time, a
        noise that both see is a state of its own (the recipe "Correlated noise").

    Examples
    --------
    >>> import numpy as np
    >>> import sphfilter as sf
    >>> walk = sf.DiscreteModel.from_matrices(F=[[1.0]], Q=[[0.5]])
    >>> level = sf.GaussianMeasurement(h=[[1.0]], noise_cov=[[0.4]])
    >>> model, sensor = sf.correlated_noise(walk, level, cross=[[-0.3]])
    >>> flt = sf.SPHFilter(model, sensor, x0=[0.0, 0.0], P0=np.diag([1.0, 0.5]), dt=1.0)
    >>> predicted, updated = flt.predict(), flt.update(1.2)
    >>> print(f"{flt.x[0]:.3f} ± {flt.P[0, 0] ** 0.5:.3f}")  # of independent noises .947 ± .562
    1.108 ± 0.626
    """
    if not isinstance(model, DiscreteModel) or not isinstance(sensor, GaussianMeasurement):
        raise ModelError(
            f"correlated_noise takes a DiscreteModel and a GaussianMeasurement, got {validate.short(model)} "
            f"and {validate.short(sensor)}; of an SDE, make what both noises share a state"
        )
    if sensor.noise_cov is None:
        raise ModelError("the noise covariance of the sensor must be a matrix, and not hang on the state")
    n, Q, R = model.dim, model.covariance, sensor.noise_cov
    S = validate.array("cross", cross, (len(Q), len(R)), "the model's noises times the sensor's")
    seen = S.T @ np.linalg.pinv(Q, hermitian=True)
    rest = R - seen @ S
    scale = np.sqrt(np.diag(R))
    off = Q @ seen.T - S  # beyond rounding where noise without variance is to be correlated
    if np.linalg.eigvalsh(rest / np.outer(scale, scale)).min() < ROUNDING or np.abs(off).max() > ROUNDING:
        raise ModelError(
            f"noises of covariances Q = {Q.tolist()} and R = {R.tolist()} cannot have a cross covariance of "
            f"{S.tolist()}: a smaller one can"
        )
    return _with_noise(model), _reading_noise(sensor, n, seen, rest)


def _with_noise(model: DiscreteModel) -> DiscreteModel:
    """The model, with the noise of the last step as further states; from text where it is made of text."""
    n, Q, domain = model.dim, model.covariance, [*model.domain.axes]
    made, recipe = model._recipe
    names = [f"w{k}" for k in range(len(Q))]
    about: dict[str, Any] = {"covariance": Q, "domain": [*domain, *[None] * len(Q)], "period": model.period}
    if made != DiscreteModel.from_expressions or recipe["noises"] is not None or {*names} & {*model.states}:

        def step(X: Floats, W: Floats, t: float) -> Floats:
            return np.hstack([model.transition(X[:, :n], t, W=W), W])

        return DiscreteModel(step, n + len(Q), noises=len(Q), vectorized=True, **about)
    noise = np.eye(n) if recipe["noise"] is None else recipe["noise"]
    about |= {"states": [*model.states, *names], "transition": [*recipe["transition"], *["0"] * len(Q)]}
    about |= {"noise": [*[list(row) for row in noise], *np.eye(len(Q)).tolist()]}
    about |= {"parameters": dict(model.parameters), "inputs": dict(model.inputs), "tables": recipe["tables"]}
    return DiscreteModel.from_expressions(**about)


def _reading_noise(sensor: GaussianMeasurement, n: int, seen: Floats, rest: Floats) -> GaussianMeasurement:
    """The sensor, whose readings see the last states, too, times (k, m), and whose own noise is the rest."""
    if sensor.H is not None:
        return GaussianMeasurement(np.hstack([sensor.H, seen]), rest, sensor.angles)

    def h(X: Floats, t: float) -> Floats:
        return sensor.predict(X[:, :n], t) + X[:, n:] @ seen.T

    return GaussianMeasurement(h, rest, sensor.angles, vectorized=True)
