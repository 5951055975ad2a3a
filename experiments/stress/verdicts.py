"""The verdict on a case: by its reference, and by the relations it was tried by."""

from dataclasses import dataclass, field

import numpy as np

from sphfilter.consistency import nees

from .referees import LIMITS, Referee, errors_of
from .relations import RELATIONS

#: Verdicts, and what each means.
VERDICTS = {
    "right": "every epoch within the limits of its reference, and no flag",
    "right, flagged": "the same, though the filter said that something was unusual",
    "wrong, flagged": "an epoch beyond the limits, with a flag at that epoch or before",
    "refused": "an exception of the library ended the record",
    "no answer": "the model blew up or the likelihood was zero everywhere, and no reference knows better",
    "no reference": "none good enough, no relation broken, and a known truth not absurd",
    "crash": "another exception, a process that died, or one stopped after the time limit",
    "wrong, silent": "an epoch beyond the limits or a relation broken without a flag, or what none may do",
}
#: Verdicts on a relation.
RELATED = ("holds", "differs, flagged", "refused", "crash", "differs, silent")
#: Sentences that a user's own model or reading may be the cause of.
_NO_ANSWER = "blew up", "likelihood is zero"
_LARGE = np.array(list(LIMITS.values()))[:, None]
#: NEES a state that no filter may exceed in the mean of its epochs, be there a reference or not.
_ABSURD = 25.0


@dataclass(frozen=True)
class Verdict:
    """Verdict, and the errors behind it.

    Attributes
    ----------
    verdict, sentence : str
    errors : ndarray, shape (3, k)
        Of the epochs that a reference could judge, in the units of `LIMITS`.
    related : dict of str to str
        Verdicts on relations.
    """

    verdict: str
    sentence: str = ""
    errors: np.ndarray = field(default_factory=lambda: np.empty((3, 0)))
    related: dict = field(default_factory=dict)


def judge(record, referee, partners=(), truth=None):
    """Judge the `Record` of a case by its `Referee`.

    `partners` are records of the same filter on related problems by relation, in the coordinates and with the
    evidence of the first; `truth` (T, n) the states, if their readings are what the model says.
    """
    errors = errors_of(record.x, record.P, record.log_evidence, referee)[:, : referee.n_trusted]
    verdict, sentence = _alone(record, referee, errors, truth)
    related = {}
    if record.end == "finished":
        for name, partner in dict(partners).items():
            related[name], how = relation(record, partner, RELATIONS[name][1])
            worse = {"differs, silent": "wrong, silent", "crash": "crash"}.get(related[name])
            if worse and verdict not in ("wrong, silent", "crash"):
                verdict, sentence = worse, f"relation {name!r}: {how}"
    return Verdict(verdict, sentence, errors, related)


def relation(record, partner, share=1.0):
    """Verdict on a relation between two records, and a sentence; `share` of the limits is allowed."""
    if partner.end in ("crash", "timeout"):
        return "crash", partner.sentence
    base = Referee("", record.x, record.P, record.log_evidence)
    errors = errors_of(partner.x, partner.P, partner.log_evidence, base)
    k = errors.shape[1]
    flags = record.flags[:k] | partner.flags[:k]
    silent, sentence = _first(errors, share, ~flags)
    if silent:
        return "differs, silent", sentence
    if partner.end == "refused":
        return "refused", partner.sentence
    flagged, sentence = _first(errors, share, flags)
    return ("differs, flagged", sentence) if flagged else ("holds", "")


def _alone(record, referee, errors, truth):
    """Verdict by the reference alone, and a sentence."""
    if record.fault:
        return "wrong, silent", record.fault
    k = errors.shape[1]
    silent, sentence = _first(errors, 1.0, ~record.flags[:k])
    if not silent:
        broken = ~(np.isfinite(record.x).all(axis=1) & np.isfinite(record.log_evidence)) & ~record.flags
        silent, sentence = broken.any(), sentence or "a mean or an evidence is not finite"
    if silent:
        return "wrong, silent", sentence
    if record.end in ("crash", "timeout"):
        return "crash", record.sentence
    if record.end == "refused":
        unanswerable = any(words in record.sentence for words in _NO_ANSWER)
        known = referee.n_trusted > len(record.x)
        return "no answer" if unanswerable and not known else "refused", record.sentence
    flagged, sentence = _first(errors, 1.0, record.flags[:k])
    if flagged:
        return "wrong, flagged", sentence
    if k < len(record.x):
        return _by_truth(record, truth) or ("no reference", referee.why)
    return "right, flagged" if record.flags.any() else "right", record.said


def _by_truth(record, truth):
    """Verdict and sentence on a run that is absurdly far from the truth; None of others."""
    if truth is None:
        return None
    level = nees(truth, record.x, record.P).mean() / record.x.shape[1]
    sentence = f"no reference, and a NEES of {level:.3g} a state where one is expected"
    flagged = "flagged" if record.flags[-1] else "silent"
    return None if level < _ABSURD else (f"wrong, {flagged}", sentence)


def _first(errors, share, counted):
    """Whether an epoch of those `counted` is beyond the limits, and a sentence about the first."""
    beyond = ~(errors <= share * _LARGE)
    epochs = np.flatnonzero(beyond.any(axis=0) & counted)
    if not len(epochs):
        return False, ""
    k = epochs[0]
    what = [f"{name} off by {errors[i, k]:.2g}" for i, name in enumerate(LIMITS) if beyond[i, k]]
    return True, f"{', '.join(what)} at epoch {k + 1}"
