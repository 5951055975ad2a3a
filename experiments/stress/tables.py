"""What the stress grid found: rows, table, sentences and files."""

from collections import Counter

import numpy as np

from experiments.show import tables
from experiments.show.files import write_rows

from .judge import LIMITS, VERDICTS, judge

__all__ = ["row_of", "sentences", "table", "write"]


def row_of(cell, method, outcome, reference, seed):
    """Return the flat row of one run."""
    v = judge(outcome, reference)
    return {
        "family": cell.family, "system": cell.system, "level": cell.level, "unit": cell.unit,
        "method": method, "verdict": v.verdict, "sentence": " ".join(v.sentence.split()),
        "mean_error": v.mean, "cov_error": v.cov, "worst_mean_error": v.worst, "evidence_error": v.evidence,
        "reference": reference.name or "none", "reference_mean_error": reference.mean_error,
        "reference_cov_error": reference.cov_error, "updates": len(outcome.x), "seconds": outcome.seconds,
        "n_particles": outcome.n_particles, "schemes": outcome.schemes, "warning": outcome.warning,
        "cell": cell.name, "seed": seed,
    }  # fmt: skip


def _counts(rows):
    """Count verdicts: {method: Counter}."""
    found = {}
    for row in rows:
        found.setdefault(row["method"], Counter())[row["verdict"]] += 1
    return found


def table(rows):
    """Return the verdicts of each method as a rich table."""
    lines = []
    for method, counts in _counts(rows).items():
        seconds = np.median([row["seconds"] for row in rows if row["method"] == method])
        lines.append((method, *(str(counts[verdict]) for verdict in VERDICTS), f"{seconds:.2g}"))
    return tables.table("verdicts", ("filter", *VERDICTS, "median s"), lines)


def sentences(rows):
    """How to read the verdicts, and each method's record, as a list of sentences."""
    limits = f"mean error below {LIMITS['mean']:.0%} and covariance error below {LIMITS['cov']:.0%}"
    said = [f"ok: {limits} of a posterior standard deviation against the reference named in stress.csv, "
            "rms over the updates; the reference's own error is at most a fifth of that."]  # fmt: skip
    said += [f"{verdict}: {meaning}." for verdict, meaning in VERDICTS.items() if verdict != "ok"]
    for method, counts in _counts(rows).items():
        total, wrong = sum(counts.values()), counts["wrong"]
        what = "never wrong" if wrong == 0 else f"wrong in {wrong}"
        said.append(f"{method}: ok in {counts['ok']} of {total} cells, {what}.")
    return said


def write(out, rows, seed):
    """Write stress.csv (all rows) and stress.md (counts by family, every cell that is not ok)."""
    write_rows(out / "stress.csv", rows)
    text = ["# Stress grid", "", *(f"- {s}" for s in sentences(rows)), "", *_family_lines(rows), ""]
    for verdict in ("wrong", "timeout", "refused", "no reference"):
        text += _listing(rows, verdict, seed)
    (out / "stress.md").write_text("\n".join(text), encoding="utf-8")


def _family_lines(rows):
    """Markdown table: a line a family, a column a method, counts in the order of `VERDICTS`."""
    methods, families = list(_counts(rows)), dict.fromkeys(row["family"] for row in rows)
    of = {family: _counts([row for row in rows if row["family"] == family]) for family in families}
    lines = []
    for name, counts in (of | {"**all**": _counts(rows)}).items():
        told = (" / ".join(str(counts.get(m, Counter())[v]) for v in VERDICTS) for m in methods)
        lines.append((name, *told))
    return [f"Counts: {' / '.join(VERDICTS)}.", "", *tables.markdown(["family", *methods], lines)]


def _listing(rows, verdict, seed):
    """One line a cell with this verdict, its sentence, and how to see it again."""
    found = [row for row in rows if row["verdict"] == verdict]
    if not found:
        return []
    lines = [f"## {verdict} ({len(found)})", ""]
    if verdict in ("wrong", "timeout"):
        again = f"`python -m experiments stress --only CELL --methods METHOD --seed {seed}`"
        lines += [f"Again: {again}", ""]
    cells = [(row["method"], f"`{row['cell']}`", row["sentence"].replace("|", "\\|")) for row in found]
    return [*lines, *tables.markdown(("filter", "cell", "sentence"), cells, left=3), ""]
