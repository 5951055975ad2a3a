"""Results of a filter's run, and the one loop that every filter's ``run`` calls."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from os import PathLike
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from .. import drawing
from .._types import Bools, Floats, Readings
from ..consistency.ranks import Ranker, gaussian_ranks
from ..core.limits import OUTLYING
from ..errors import ModelError
from ..info import innovation_of
from ..model.measurements import Reading
from ..model.named import InputRecord, each_input
from ..validate import array, onwards
from .readings import rows_of

#: What a run keeps only if it was told a truth.
RANKS = "pit", "state_pit", "hpd_rank"
#: What is true or false of an epoch.
TRUTHS = "accepted", "flagged"


@dataclass(frozen=True)
class FilterResult:
    """Histories of one run; the first axis is the measurement epoch.

    Attributes
    ----------
    t : ndarray, shape (T,)
        Measurement times, seconds.
    x_prior, x : ndarray, shape (T, n)
        Mean before and after the update.
    P_prior, P : ndarray, shape (T, n, n)
        Covariance before and after the update.
    log_evidence : ndarray, shape (T,)
        Log-density of each measurement given all earlier ones (zero where none came); their sum is the
        log-evidence of the run.
    accepted : ndarray of bool, shape (T,)
        False where a measurement came and the filter rejected it.
    evidence_error : ndarray, shape (T,)
        Estimated error of `log_evidence`, nats; NaN where the filter does not say.
    error : ndarray, shape (T,)
        Estimated error of the posterior mean, in posterior standard deviations; NaN where the filter does not
        say.
    variance_error : ndarray, shape (T,)
        Estimated error of the variances of the states, as a part of each, where it is most.
    flagged : ndarray of bool, shape (T,)
        True where prediction or update said that something was unusual: a status other than "ok", a refusal.
    innovation, innovation_cov : ndarray, shapes (T, k), (T, k, k)
        Measurement minus its prediction, and the covariance of the difference; NaN where no measurement came
        or the filter does not say.
    pit, state_pit, hpd_rank : ndarray, shapes (T, k), (T, n), (T,)
        Probability that the prediction gave to lower readings; probabilities that the posterior gave to lower
        values of each state than the truth, and to the region where it is higher than at the truth. All
        uniform for a filter that is right, see `consistency.ranks`. NaN unless the run was told a truth.

    Examples
    --------
    >>> import sphfilter as sf
    >>> model, sensor = sf.LinearSDE([[-1.0]], noise=[[1.0]]), sf.GaussianMeasurement([[1.0]], [[0.1]])
    >>> flt = sf.SPHFilter(model, sensor, x0=[0.0], P0=[[1.0]])
    >>> result = flt.run(times=[0.5, 1.0], measurements=[0.3, None])
    >>> print(result.x.ravel().round(3), result.log_evidence.round(3), result.accepted)
    [0.262 0.159] [-0.855  0.   ] [ True  True]
    """

    t: Floats
    x_prior: Floats
    P_prior: Floats
    x: Floats
    P: Floats
    log_evidence: Floats
    accepted: Bools
    # an array in every result: what is not given becomes NaN
    innovation: Floats = None  # type: ignore[assignment]
    innovation_cov: Floats = None  # type: ignore[assignment]
    pit: Floats = None  # type: ignore[assignment]
    state_pit: Floats = None  # type: ignore[assignment]
    hpd_rank: Floats = None  # type: ignore[assignment]
    error: Floats = None  # type: ignore[assignment]
    flagged: Bools = None  # type: ignore[assignment]
    evidence_error: Floats = None  # type: ignore[assignment]
    variance_error: Floats = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        lead, n = np.shape(self.x)[:-1], np.shape(self.x)[-1]
        k = 1 if self.innovation is None else np.shape(self.innovation)[-1]
        for name, shape in shapes(n, k).items():
            if getattr(self, name) is None:
                blank = False if name in TRUTHS else np.nan
                object.__setattr__(self, name, np.full((*lead, *shape), blank))

    @property
    def total_evidence_error(self) -> Floats:
        """Estimated error of the log-evidence of a run, or of each, nats: of errors that are independent."""
        told = np.nan if self.evidence_error is None else self.evidence_error  # of a pickle of before
        return np.sqrt(np.sum(np.square(told), axis=-1))

    @property
    def outlying(self) -> Bools:
        """Epochs whose reading lies five standard deviations or more from its prediction."""
        y, S = np.asarray(self.innovation), np.asarray(self.innovation_cov)
        missing = np.isnan(y) | np.isnan(np.diagonal(S, axis1=-2, axis2=-1))
        pairs = missing[..., :, None] | missing[..., None, :]
        y, S = np.where(missing, 0.0, y), np.where(pairs, np.eye(y.shape[-1]), S)
        return np.einsum("...j,...jk,...k->...", y, np.linalg.pinv(S, hermitian=True), y) > OUTLYING**2

    def plot(
        self, truth: ArrayLike | None = None, states: Sequence[str] | None = None, ax: Any = None
    ) -> Any:
        """Draw means with twice their deviations over time, and the epochs that were flagged.

        Needs matplotlib.

        Parameters
        ----------
        truth : array_like, shape (T, n), optional
            Drawn beside them.
        states : sequence of str, optional
            Names of the n states, "x0", "x1", ... if not given.
        ax : matplotlib Axes, or an array of these, optional
            One for each state; a new figure if not given. Returned.
        """
        n = np.shape(self.x)[-1]
        names = [f"x{a}" for a in range(n)] if states is None else list(states)
        if len(names) != n:
            raise ModelError(f"states names {len(names)} states, but the result has {n}")
        known = None if truth is None else array("truth", truth, np.shape(self.x))
        return drawing.result(self, names, range(n), known, ax)

    def __repr__(self) -> str:
        *lead, n = np.shape(self.x)
        names = ", ".join(f.name for f in fields(self))
        return f"FilterResult({' x '.join(map(str, lead))} epochs of {n} states: {names})"

    def save(self, path: str | PathLike[str]) -> None:
        """Write the arrays to a ``.npz`` file."""
        np.savez_compressed(path, **{f.name: getattr(self, f.name) for f in fields(self)})

    @classmethod
    def load(cls, path: str | PathLike[str]) -> "FilterResult":
        """Read what `save` wrote."""
        with np.load(path) as data:
            return cls(**{f.name: data[f.name] for f in fields(cls) if f.name in data})


class AnyFilter(Protocol):
    """What can be put through a record of measurements: `SPHFilter`, or a filter of a user's own."""

    def run(self, times: Any, measurements: Any, /) -> FilterResult:
        """Predict to each time and update with its measurement."""


def shapes(n: int, k: int) -> dict[str, tuple[int, ...]]:
    """Shapes of what a run of n states and k readings keeps of an epoch, by name."""
    return {
        "x_prior": (n,),
        "P_prior": (n, n),
        "x": (n,),
        "P": (n, n),
        "log_evidence": (),
        "accepted": (),
        "innovation": (k,),
        "innovation_cov": (k, k),
        "pit": (k,),
        "state_pit": (n,),
        "hpd_rank": (),
        "error": (),
        "flagged": (),
        "evidence_error": (),
        "variance_error": (),
    }


def run_filter(
    filt: Any,
    times: ArrayLike,
    measurements: Readings,
    truth: ArrayLike | None = None,
    observer: Ranker | None = None,
    each: Callable[[Any], object] | None = None,
    inputs: InputRecord | None = None,
) -> FilterResult:
    """Predict to each time and update with its measurement.

    The filter has ``predict(t=)``, ``update(z)``, ``t``, ``x``, ``P`` and ``log_likelihood``. Times (T,),
    seconds, do not decrease, and none is before ``filt.t``; one equal to the filter's own is not predicted
    to, so that repeated times and ``times[0] == t0`` are updates only. A measurement is None or NaN where
    none came.

    A truth (T, n) is ranked in the densities of a filter with ``spread()``; a filter without it is taken for
    Gaussian. An observer knows the truth, instead of it; `each` is called with the filter after every update.
    Inputs, (T, m) or (T,) by name, are those of the model over the interval that ends at each time.
    """
    times, n = array("times", times, (None,)), len(filt.x)
    if len(times) != len(measurements):
        raise ModelError(
            f"run needs as many measurements as times; got times of shape {times.shape} "
            f"and {len(measurements)} measurements"
        )
    times = onwards(times, filt.t)
    if len(times) and (np.any(np.diff(times) < 0) or times[0] < filt.t):
        raise ModelError(f"times must be not decreasing and not before the filter's own time {filt.t:g}")
    if observer is None and truth is not None:
        observer = Ranker(truth)
    if observer is not None and np.shape(observer.truth) != (len(times), n):
        expected = f"{(len(times), n)}, a state a time"
        raise ModelError(f"truth must have shape {expected}; got {np.shape(observer.truth)}")
    driving = [None] * len(times) if inputs is None else each_input(filt.model.inputs, inputs, len(times))
    readings = rows_of(getattr(filt, "measurement", None), measurements)
    known = getattr(getattr(filt, "measurement", None), "dim_z", None)
    k = max((np.size(z) for z in readings if z is not None), default=known or 1)
    looker = observer if hasattr(filt, "spread") else None
    rows: list[dict[str, Any]] = []
    alone = inputs is None and observer is None and each is None
    glide = filt._glide() if alone and hasattr(filt, "_glide") else None
    while len(rows) < len(times):
        if glide is not None:
            rows += glide.through(times[len(rows) :], readings[len(rows) :])
        if (epoch := len(rows)) == len(times):
            break
        rows.append(_epoch(filt, times[epoch], readings[epoch], driving[epoch], k, epoch, looker))
        if each is not None:
            each(filt)
    kept = {name: shape for name, shape in shapes(n, k).items() if looker is not None or name not in RANKS}
    columns = {
        name: np.array([row[name] for row in rows], bool if name in TRUTHS else float).reshape(-1, *shape)
        for name, shape in kept.items()
    }
    if observer is not None and looker is None:
        moments = (columns[name] for name in ("x", "P", "innovation", "innovation_cov"))
        columns |= gaussian_ranks(observer.truth, *moments)
    return FilterResult(t=times, **columns)


def _epoch(
    filt: Any,
    t: float,
    z: ArrayLike | None,
    u: Mapping[str, float] | None,
    k: int,
    epoch: int,
    observer: Ranker | None,
) -> dict[str, Any]:
    """Predict to t with inputs u, update with z, and return what the result keeps of it."""
    given = {} if u is None else {"u": u}
    # over no time too: sensors read inputs
    predicted_by = filt.predict(t=t, **given) if t > filt.t or given else None
    row = {"x_prior": filt.x.copy(), "P_prior": filt.P.copy()}
    if observer is not None:
        pit, *predicted = observer.before(filt, z, k)
    info = filt.update(z)
    y, S = innovation_of(info, Reading.of(z).seen, k)
    if observer is not None:
        row["pit"], (row["state_pit"], row["hpd_rank"]) = pit, observer.after(filt, epoch)
        y, S = predicted if info.innovation is None else (y, S)
    row |= {"x": filt.x.copy(), "P": filt.P.copy(), "log_evidence": filt.log_likelihood}
    said = predicted_by, info  # filters of others say nothing
    row |= {name: getattr(info, name, np.nan) for name in ("error", "variance_error", "evidence_error")}
    row["flagged"] = any(getattr(step, "flagged", False) for step in said)
    return row | {"accepted": info.accepted, "innovation": y, "innovation_cov": S}
