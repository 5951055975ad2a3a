"""Models compared by the evidence of the same measurements."""

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._types import Floats, Ints, Readings, Rows, in_a_line
from ..errors import ModelError
from ..filter.readings import rows_of
from ..filter.results import AnyFilter
from ..model.named import InputRecord
from ..validate import short
from .estimation import ParameterFit
from .evidence import error_of_run, fingerprint, n_readings

#: Kass and Raftery (1995), J. Am. Stat. Assoc. 90, section 3.2: twice the log of a Bayes factor, up to which
#: the evidence against a model is called so.
_WORDS = (2.0, "not worth more than a bare mention"), (6.0, "positive"), (10.0, "strong")


@dataclass(frozen=True)
class ModelComparison:
    """Models in the order of their Bayes factors, the best first.

    Attributes
    ----------
    names : tuple of str, length M
    log_evidence : ndarray, shape (M,)
        Log-evidence of each model, nats; of a fitted model the largest.
    n_parameters : ndarray of int, shape (M,)
        Number of parameters fitted to these measurements.
    n_rejected : ndarray of int, shape (M,)
        Measurements that the model's filter did not use. They count in the log-evidence all the same.
    n_readings : int
        Measured numbers.
    span : tuple of float
        First and last time, seconds.
    data : str
        Fingerprint of times, measurements and inputs.
    evidence_error : ndarray, shape (M,)
        Estimated errors of the log-evidences, nats, by what filters approximate; NaN where one does not say.

    Examples
    --------
    >>> import sphfilter as sf
    >>> level, start = sf.GaussianMeasurement([[1.0]], [[0.1]]), ([0.0], [[0.1]])
    >>> rates = {"wanders": [[0.0]], "returns": [[-2.0]]}
    >>> rivals = {k: sf.SPHFilter(sf.LinearSDE(A, noise=[[1.0]]), level, *start) for k, A in rates.items()}
    >>> found = sf.compare_models(rivals, [1.0, 2.0, 3.0, 4.0], [0.4, -0.2, 0.3, 0.1])
    >>> for name, factor, word in zip(found.names, found.log_bayes_factor, found.words):
    ...     print(f"{name}: {factor:.1f} nat, {word}")
    returns: 0.0 nat, the best
    wanders: -2.3 nat, positive
    """

    names: tuple[str, ...]
    log_evidence: Floats
    n_parameters: Ints
    n_rejected: Ints
    n_readings: int
    span: tuple[float, float]
    data: str
    evidence_error: Floats

    __repr__ = in_a_line

    @property
    def aic(self) -> Floats:
        """Akaike's criterion, shape (M,): lower is better."""
        return 2.0 * self.n_parameters - 2.0 * self.log_evidence

    @property
    def bic(self) -> Floats:
        """Schwarz' criterion, shape (M,): lower is better."""
        return self.n_parameters * np.log(self.n_readings) - 2.0 * self.log_evidence

    @property
    def log_bayes_factor(self) -> Floats:
        """Log of the Bayes factor of each model against the best, nats, shape (M,), none above zero.

        Without fitted parameters it is the difference of the log-evidences. Fitted ones would have to be
        averaged over what was known of them before: Schwarz' criterion stands for that, −(BIC − BIC₀) / 2.
        """
        return 0.5 * (self.bic[0] - self.bic)

    @property
    def words(self) -> tuple[str, ...]:
        """Words of Kass and Raftery for the evidence against each model, beside the best."""
        return tuple(
            "the best" if k == 0 else next((w for top, w in _WORDS if -2.0 * b <= top), "very strong")
            for k, b in enumerate(self.log_bayes_factor)
        )

    def as_dict(self) -> dict[str, Any]:
        """Numbers and words by model, for files."""
        told = ("log_evidence", "evidence_error", "n_parameters", "n_rejected")
        columns = {name: getattr(self, name) for name in (*told, "aic", "bic", "log_bayes_factor")}
        rows = {
            name: {key: values[k].item() for key, values in columns.items()} | {"against": self.words[k]}
            for k, name in enumerate(self.names)
        }
        return {"n_readings": self.n_readings, "span": list(self.span), "data": self.data, "models": rows}

    def __str__(self) -> str:
        width = max(len("model"), *map(len, self.names))
        heads = "log-evidence    error  fitted  rejected       AIC       BIC  log Bayes factor"
        lines = [f"{'model':{width}}  {heads}"]
        counts, criteria = (self.n_parameters, self.n_rejected), (self.aic, self.bic, self.log_bayes_factor)
        for name, value, error, fitted, rejected, aic, bic, factor, word in zip(
            self.names, self.log_evidence, self.evidence_error, *counts, *criteria, self.words, strict=True
        ):
            told = f"{name:{width}}  {value:12.3f}  {error:7.2g}  {fitted:6d}  {rejected:8d}"
            lines.append(f"{told}  {aic:8.2f}  {bic:8.2f}  {factor:16.3f}  {word}")
        first, last = self.span
        return "\n".join([*lines, f"{self.n_readings} readings from {first:g} to {last:g} ({self.data})"])


def compare_models(
    candidates: Mapping[str, AnyFilter | ParameterFit],
    times: ArrayLike | None = None,
    measurements: Readings | None = None,
    inputs: InputRecord | None = None,
) -> ModelComparison:
    """Compare models by the evidence of the same measurements.

    Parameters
    ----------
    candidates : mapping of str to filter or ParameterFit
        A filter at the start of the measurements, which stays there, is run; a fit has been made to them.
    times : array_like, shape (T,), optional
        Seconds. Without times and measurements, those are taken, and the inputs, that the fits were made to.
    measurements : sequence of length T, optional
        None or NaN where none came.
    inputs : array_like (T, m), or mapping of str to array_like (T,), optional
        As of ``SPHFilter.run``, for candidates whose models have inputs; others have none.

    Returns
    -------
    ModelComparison

    Raises
    ------
    ModelError
        No candidates, one that is neither, a fit to other measurements, or neither fits nor measurements.
    PropagationError
        A filter cannot go on.

    Examples
    --------
    >>> import numpy as np
    >>> import sphfilter as sf
    >>> model = sf.SDE.from_expressions(["x"], ["-a*x"], [["1"]], parameters={"a": 0.6})
    >>> level = sf.GaussianMeasurement(h=[[1.0]], noise_cov=[[0.1]])
    >>> times = 0.4 * np.arange(1, 31)
    >>> _, z = sf.simulate(model, level, x0=[0.0], times=times, rng=3)
    >>> flt = sf.SPHFilter(model, level, x0=[0.0], P0=[[0.1]])
    >>> wanders = sf.SPHFilter(model.with_parameters(a=0.0), level, x0=[0.0], P0=[[0.1]])
    >>> print(sf.compare_models({"wanders": wanders, "returns": flt}, times, z))
    model    log-evidence    error  fitted  rejected       AIC       BIC  log Bayes factor
    returns       -34.237  ...       0         0     68.47     68.47             0.000  the best
    wanders       -36.378  ...       0         0     72.76     72.76            -2.141  positive
    30 readings from 0.4 to 12 (...)
    """
    candidates = dict(candidates)
    if not candidates:
        raise ModelError("there is no model to compare; give filters or fits by name")
    if times is None or measurements is None:
        fit = next((one for one in candidates.values() if isinstance(one, ParameterFit)), None)
        if times is not None or measurements is not None or fit is None:
            raise ModelError(
                "filters are compared by times and measurements: give both, or neither and a fit, which has "
                "them"
            )
        times, measurements, inputs = fit.times, fit.measurements, fit.inputs if inputs is None else inputs
    sensors = [found for one in candidates.values() if (found := getattr(one, "measurement", None))]
    numbers = rows_of(sensors[0] if sensors else None, measurements)
    data = fingerprint(times, numbers, inputs)
    rows = [
        (str(name), *_judged(name, candidate, times, numbers, inputs, data))
        for name, candidate in candidates.items()
    ]
    readings, span = n_readings(numbers), np.asarray(times, dtype=float)
    rows.sort(key=lambda row: row[3] * np.log(max(readings, 1)) - 2.0 * row[1])
    names, evidence, errors, n_parameters, n_rejected = zip(*rows, strict=True)
    return ModelComparison(
        names=names,
        log_evidence=np.array(evidence),
        n_parameters=np.array(n_parameters),
        n_rejected=np.array(n_rejected),
        n_readings=readings,
        span=(float(span[0]), float(span[-1])),
        data=data,
        evidence_error=np.array(errors),
    )


def _judged(
    name: str,
    candidate: AnyFilter | ParameterFit,
    times: ArrayLike,
    measurements: Rows,
    inputs: InputRecord | None,
    data: str,
) -> tuple[float, float, int, int]:
    """Log-evidence and its error, number of fitted parameters, and measurements not used."""
    if isinstance(candidate, ParameterFit):
        if candidate.data != data:
            raise ModelError(
                f"{name!r} was fitted to other measurements ({candidate.data}) than those given ({data}); "
                f"evidence is comparable on the same times, measurements and inputs only"
            )
        result, fitted = candidate.result, len(candidate.names)
    elif hasattr(candidate, "run"):
        driven = inputs is not None and bool(getattr(getattr(candidate, "model", None), "inputs", ()))
        given: dict[str, Any] = {"inputs": inputs} if driven else {}
        result, fitted = copy.deepcopy(candidate).run(times, measurements, **given), 0
    else:
        raise ModelError(f"{name!r} must be a filter or a ParameterFit, got {short(candidate)}")
    unused = int(np.count_nonzero(~result.accepted))
    return float(np.sum(result.log_evidence)), error_of_run(result), fitted, unused
