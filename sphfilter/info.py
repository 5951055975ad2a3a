"""What a prediction, an update or a re-gridding did, as values."""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, fields
from enum import IntFlag, auto
from functools import reduce
from operator import or_
from typing import Self

import numpy as np

from ._types import Bools, Floats, Noted, in_a_line
from .core.limits import EDGE, WRONG

#: The reason of an update without a reading, which is none to worry about.
NOTHING_CAME = "no measurement came"
#: Times what is estimated, within which errors lie: .98 of 7,100 by `experiments benchmark`.
WITHIN = 3.0
DOUBTFUL = WRONG / WITHIN  # estimated error of a mean, in standard deviations, that is said in words


def may_be_off(error: float) -> str:
    """Sentence on an estimated error of a mean, standard deviations, that is worth one."""
    if not error < EDGE:
        return "how far the mean is off is not known"
    return f"the mean may be off by {WITHIN * error:.2g} standard deviations"


def target_missed(error: float, target: float) -> str:
    """Sentence for a density whose error is more than was asked for."""
    return f"the mean is good to {error:.2g} standard deviations, not to the {target:g} asked for"


class Code(IntFlag):
    """What was unusual about a step, for programs; `status` says it in words.

    Several flags may be set: ``Code.FINER in info.code`` asks for one, ``info.code == Code.OK`` for none.

    Examples
    --------
    >>> import sphfilter as sf
    >>> start = sf.initialize(sf.Gaussian([0.0], [[0.5]]), n_particles=60)
    >>> _, info = sf.predict(start, sf.LinearSDE([[-1.0]], noise=[[1.0]]), 1.0)
    >>> print(info.code == sf.Code.OK, sf.Code.REPEATED in info.code)
    True False
    """

    OK = 0  # nothing was unusual
    FINER = auto()  # the density is on more particles than it may have
    REPEATED = auto()  # the step before was made again, on more particles
    FALLBACK = auto()  # another scheme than the first choice carried the density
    REGRIDDED = auto()  # the particles were put on a new lattice on the way, or should have been
    MIXED = auto()  # of files of before: particles carried less than moment-corrected SPH asked of them
    LATE = auto()  # the time budget was exceeded, or left no time for a try on more particles
    CLOUD = auto()  # the density goes on as a cloud of weighted points
    UNRESOLVED = auto()  # the estimated error is above what the answer may be trusted with
    COARSE = auto()  # the estimated error is above two and a half targets


#: What schemes put in the place of a density.
_RUNGS = {
    "exact_linear": "closed form",
    "family": "family",
    "pieces": "pieces",
    "log_density": "lattice",
    "cloud": "cloud",
}


class _Marked(Noted):
    """Infos of all steps: a status in words, and a code for programs."""

    code: Code
    status: str
    scheme: str
    error: float
    variance_error: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "code", Code(self.code))  # files know it as a number
        if math.isnan(self.variance_error):
            object.__setattr__(self, "variance_error", math.sqrt(2.0) * self.error)
        for name in (name for name in ("error", "variance_error") if math.isnan(getattr(self, name))):
            object.__setattr__(self, name, math.nan)  # the one that equals itself where infos are compared

    def marked(self, code: Code, status: str) -> Self:
        """The info with another status, whose flags come to those it has."""
        return self.noted(code=self.code | code, status=status)

    def also(self, code: Code, sentence: str) -> Self:
        """The info whose status says one more sentence, whose flags come to those it has."""
        return self.marked(code, sentence if self.status == "ok" else f"{self.status}; {sentence}")

    @property
    def rung(self) -> str:
        """What stood for the density: "closed form", "family", "pieces", "lattice", "cloud" or
        "particles"."""
        return ", ".join(
            dict.fromkeys(_RUNGS.get(name, "particles") for name in self.scheme.split(", ") if name)
        )

    @property
    def flagged(self) -> bool:
        """Was anything unusual: a status other than "ok"?"""
        return self.status != "ok"


@dataclass(frozen=True, kw_only=True)
class PredictInfo(_Marked):
    """Info of one prediction: steps, what carried the density, how wrong it may be.

    Attributes
    ----------
    n_steps, n_evaluations : int
        Time steps, and evaluations of the velocity at all particles.
    n_searches, n_bypassed : int
        Evaluations for which neighbour lists were found anew, and steps that used the lists of a step before.
    n_regrids : int
        Times the particles were put on a new lattice because steps had become too small, or because
        `SolverConfig.remesh` says so.
    n_rejected : int
        Time steps repeated because the error control refused them.
    mass_error : float
        Probability that the lattices lost or gained on the way, before the masses were normalised again
        (log-density scheme): a measure of the cost of the resolution.
    n_smoothing_failed : int
        Particle-steps whose smoothing-length equation had no root (the old length was kept), or whose
        iteration had not converged when it was stopped.
    n_discarded, mass_discarded : int, float
        Particles dropped because their iteration had not converged, and the probability they carried, which
        the other particles share; zero unless `PaperScheme.discard_unconverged` asks for it.
    residual : float
        Error of the representation that the prediction ended with: the mean over the mass of |p/p' - 1|,
        where p' is the density and p what was asked between its nodes (log-density scheme).
    error : float
        Estimated error of the mean after the prediction, in standard deviations, accumulated over the record;
        NaN where a scheme makes no estimate.
    variance_error : float
        Estimated error of the variances of the states, as a part of each, where it is most: √2 of `error`
        unless more is known, as a Hermite polynomial in log p makes of a variance and of a mean.
    mass_left_out : float
        Probability that lies beyond the cut of the density.
    skipped : tuple of str
        Work the scene made unnecessary.
    scheme, status : str
        What carried the density; "ok", or why another scheme than the first choice did.
    code : Code
        What the status says, for programs.
    seconds : float
        Wall-clock time of the call, compiling included. Two infos are equal whatever it is.

    Examples
    --------
    >>> import sphfilter as sf
    >>> start = sf.initialize(sf.Gaussian([0.0], [[0.5]]), n_particles=60)
    >>> _, info = sf.predict(start, sf.LinearSDE([[-1.0]], noise=[[1.0]]), 1.0)
    >>> print(info.scheme, info.status, info.n_steps, info.mass_error < 1e-3)
    log_density ok 3 True
    """

    n_steps: int = 0
    n_evaluations: int = 0
    n_searches: int = 0
    n_bypassed: int = 0
    n_regrids: int = 0
    n_rejected: int = 0
    mass_error: float = 0.0
    n_smoothing_failed: int = 0
    n_discarded: int = 0
    mass_discarded: float = 0.0
    residual: float = 0.0
    error: float = 0.0
    variance_error: float = math.nan
    mass_left_out: float = 0.0
    skipped: tuple[str, ...] = ()
    scheme: str = "paper"
    status: str = "ok"
    code: Code = Code.OK
    seconds: float = field(default=0.0, compare=False, repr=False)

    @classmethod
    def joined(cls, infos: Sequence["PredictInfo"]) -> "PredictInfo":
        """One info of several predictions, one after the other; schemes and statuses without repetition.

        Of sentences that differ in their numbers only the last one stays.
        """
        if len(infos) == 1:
            return infos[0]
        said = (sentence for info in infos for sentence in info.status.split("; ") if sentence != "ok")
        totals = {f.name: sum(getattr(i, f.name) for i in infos) for f in fields(cls) if f.name not in _WORDS}
        totals |= {name: getattr(infos[-1], name) for name in _LATEST if infos}
        return cls(
            **totals,
            skipped=tuple(dict.fromkeys(note for info in infos for note in info.skipped)),
            scheme=schemes_of(infos),
            status="; ".join({_NUMBER.sub("", sentence): sentence for sentence in said}.values()) or "ok",
            code=codes_of(infos),
        )

    @property
    def bypass_ratio(self) -> float:
        """Bypassed steps per search (002 section 4.3)."""
        return self.n_bypassed / max(self.n_searches, 1)


def codes_of(infos: Iterable[_Marked]) -> Code:
    """All flags of several infos."""
    return reduce(or_, (info.code for info in infos), Code.OK)


def schemes_of(infos: Iterable[_Marked]) -> str:
    """Schemes of several infos, without repetition."""
    return ", ".join(dict.fromkeys(info.scheme for info in infos))


_NUMBER = re.compile(r"\d+(\.\d+)?(e[+-]?\d+)?")
_WORDS = "skipped", "scheme", "status", "code"
_LATEST = "residual", "error", "variance_error", "mass_left_out"  # of the last of several predictions


@dataclass(frozen=True, kw_only=True)
class ResampleInfo:
    """One re-gridding (002 4.7): lattice, tried candidates, and how well the chosen one fits.

    Examples
    --------
    >>> import sphfilter as sf
    >>> _, info = sf.resample(sf.initialize(sf.Gaussian([0.0], [[1.0]]), n_particles=60), 40)
    >>> print(info.n_particles <= 40, info.n_candidates)
    True 1
    """

    n_particles: int
    lattice_dims: tuple[int, ...]
    spacing: tuple[float, ...]
    n_candidates: int
    fitness: float
    volume_fraction: float
    log_evidence: float = 0.0


@dataclass(frozen=True, kw_only=True)
class UpdateInfo(_Marked):
    """Info of one measurement update: was the reading used, its evidence, how wrong it may be.

    Attributes
    ----------
    accepted : bool
        False where the measurement was refused, by the acceptance test or because the posterior would lie far
        outside of all particles: the density is still the prior.
    log_evidence : float
        Log of the integral of prior times likelihood; zero if no measurement came. For a refused
        measurement, which lies where the prior has no particles, the log-evidence of the Gaussian with the
        prior's mean and covariance.
    innovation, innovation_cov : ndarray or None
        z minus its prediction, shape (k,), and the covariance of the prediction plus R, for the observed
        components of a Gaussian measurement.
    reason : str
        Why the measurement was refused, or why the acceptance test was not made; empty if neither.
    n_particles : int
    extrapolated : float
        Probability of the posterior where the prior had no particles (log-density scheme): the share that
        rests on a guess about the prior's tails.
    residual : float
        Error of the representation of the posterior: the mean over the mass of |p/p' - 1| between its nodes.
    error : float
        Estimated error of the posterior mean, in posterior standard deviations, accumulated over the record;
        NaN where a scheme makes no estimate.
    variance_error : float
        Estimated error of the posterior variances, as of a prediction.
    evidence_error : float
        Estimated error of `log_evidence`, in nats; NaN where a scheme makes no estimate.
    mass_left_out : float
        Probability that lies beyond the cut of the posterior, remote modes that were found included.
    status : str
        "ok", or that the prediction before was repeated (`SPHFilter` does that where much is extrapolated).
    code : Code
        What the status says, for programs.
    seconds : float
        Wall-clock time of the call, compiling included. Two infos are equal whatever it is.
    scheme : str
        What holds the posterior; empty where nothing came.
    kernel_ratio : float
        Variance of the kernels over the smallest variance of the posterior along any direction. Above about
        one the kernels are wider than the posterior somewhere: more particles, or states of like scale.
    resample : ResampleInfo or None

    Examples
    --------
    >>> import sphfilter as sf
    >>> prior = sf.initialize(sf.Gaussian([0.0], [[1.0]]), n_particles=60)
    >>> _, info = sf.update(prior, sf.GaussianMeasurement([[1.0]], [[1.0]]), [9.0])
    >>> print(info.accepted, info.reason)
    True outlying measurement: 6.4 sigma from its prediction
    """

    accepted: bool
    log_evidence: float
    innovation: Floats | None = None
    innovation_cov: Floats | None = None
    reason: str = ""
    n_particles: int = 0
    extrapolated: float = 0.0
    residual: float = 0.0
    error: float = 0.0
    variance_error: float = math.nan
    evidence_error: float = 0.0
    mass_left_out: float = 0.0
    status: str = "ok"
    code: Code = Code.OK
    seconds: float = field(default=0.0, compare=False, repr=False)
    scheme: str = ""
    kernel_ratio: float = 0.0
    resample: ResampleInfo | None = field(default=None, repr=False)

    __repr__ = in_a_line

    @property
    def flagged(self) -> bool:
        """Was the reading refused, or the status other than "ok"? That a used one lies far out is no flag."""
        return not self.accepted or self.status != "ok"


def innovation_of(info: UpdateInfo, seen: Bools, k: int) -> tuple[Floats, Floats]:
    """Innovation (k,) and covariance (k, k) of an update in the shapes of its sensor.

    `seen`, bool (k,), says which components came; the others are NaN, as all are if the update told none.
    """
    if info.innovation is not None and len(info.innovation) == k:
        return np.array(info.innovation), np.array(info.innovation_cov)
    y, S = np.full(k, np.nan), np.full((k, k), np.nan)
    if info.innovation is not None:
        y[seen], S[np.ix_(seen, seen)] = info.innovation, info.innovation_cov
    return y, S
