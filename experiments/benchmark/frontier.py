"""Which representation reaches an error first: the forced schemes beside each other and the default."""

from itertools import pairwise

import numpy as np

from experiments.show import tables

from .methods import short

_OURS = ("sph:", "auto")
_ERRORS = (0.1, 0.03, 0.01, 0.003, 0.001)


def seconds_for(lines, error):
    """Run time at which lines of one family reach an error of the mean, between sizes by powers; or NaN.

    Errors below a line's reference are that reference's: they are not relied on.
    """
    known = [i for i in lines if not i.failed and np.isfinite(i.mean)]
    reached = [i.seconds for i in known if i.mean <= error]
    between = [
        i.seconds * (j.seconds / i.seconds) ** (np.log(error / i.mean) / np.log(j.mean / i.mean))
        for i, j in pairwise(known)
        if i.mean > error > j.mean
    ]
    return min([*between, *reached], default=np.nan)


def markdown(outcomes):
    """The table as markdown: milliseconds of each family at every error, the fastest scheme's in bold.

    What the default takes over that is its regret.
    """
    families = list(dict.fromkeys(i.family for o in outcomes for i in o.lines if i.family.startswith(_OURS)))
    lines, regrets = [], []
    for outcome in outcomes:
        for error in _ERRORS:
            took = [seconds_for([i for i in outcome.lines if i.family == f], error) for f in families]
            forced = [s for f, s in zip(families, took, strict=True) if f.startswith("sph:")]
            if np.isfinite(forced).any():
                best = np.nanmin(forced)
                cells = [_cell(s, f != "auto" and s == best) for f, s in zip(families, took, strict=True)]
                regrets += [s / best for f, s in zip(families, took, strict=True) if f == "auto"]
                own = [tables.number(r, ".2g") if np.isfinite(r) else "" for r in regrets[-1:]]
                lines.append([outcome.scenario, f"{error:g}", *cells, *own])
    if not lines:
        return ""
    heading = ["scene", "error", *(f"{short(f)}, ms" for f in families)]
    known = np.array(regrets)[np.isfinite(regrets)]
    said = [_said(known), ""] if known.size else []
    heading += ["regret"] if regrets else []
    return "\n".join(["## Frontier of the schemes", "", *tables.markdown(heading, lines), "", *said])


def _said(regrets):
    """A sentence on the default's time over that of the fastest scheme."""
    mean, most = np.exp(np.mean(np.log(regrets))), regrets.max()
    above = f"{np.sum(regrets > 2.0)} of {regrets.size} above 2"
    return (
        f"Regret, the default's time over that of the fastest scheme: {mean:.2g} in the geometric mean, "
        f"{most:.2g} at most, {above}."
    )


def _cell(seconds, best):
    """Milliseconds; in bold where no other forced scheme is faster."""
    text = tables.number(1e3 * seconds, ".3g") if np.isfinite(seconds) else ""
    return f"**{text}**" if best else text
