"""What the stress grid found: rows, table, sentences and files."""

import csv
from collections import Counter

import numpy as np
from rich import box
from rich.table import Table

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
    made = Table(box=box.SIMPLE, pad_edge=False, title="verdicts")
    made.add_column("method")
    for verdict in VERDICTS:
        made.add_column(verdict, justify="right")
    made.add_column("median s", justify="right")
    for method, counts in _counts(rows).items():
        seconds = np.median([row["seconds"] for row in rows if row["method"] == method])
        made.add_row(method, *(str(counts[verdict]) for verdict in VERDICTS), f"{seconds:.2g}")
    return made


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
    out.mkdir(parents=True, exist_ok=True)
    with open(out / "stress.csv", "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    text = ["# Stress grid", "", *(f"- {s}" for s in sentences(rows)), "", *_family_lines(rows), ""]
    for verdict in ("wrong", "timeout", "refused", "no reference"):
        text += _listing(rows, verdict, seed)
    (out / "stress.md").write_text("\n".join(text), encoding="utf-8")


def _family_lines(rows):
    """Markdown table: a line a family, a column a method, counts in the order of `VERDICTS`."""
    methods = list(_counts(rows))
    lines = [f"Counts: {' / '.join(VERDICTS)}.", "", f"| family | {' | '.join(methods)} |"]
    lines += ["|---|" + "---:|" * len(methods)]
    for family in dict.fromkeys(row["family"] for row in rows):
        counts = _counts([row for row in rows if row["family"] == family])
        texts = [" / ".join(str(counts.get(m, Counter())[v]) for v in VERDICTS) for m in methods]
        lines.append(f"| {family} | {' | '.join(texts)} |")
    texts = [" / ".join(str(counts[v]) for v in VERDICTS) for counts in _counts(rows).values()]
    return [*lines, f"| **all** | {' | '.join(texts)} |"]


def _listing(rows, verdict, seed):
    """One line a cell with this verdict, its sentence, and how to see it again."""
    found = [row for row in rows if row["verdict"] == verdict]
    if not found:
        return []
    lines = [f"## {verdict} ({len(found)})", ""]
    if verdict in ("wrong", "timeout"):
        again = f"`python -m experiments stress --only CELL --methods METHOD --seed {seed}`"
        lines += [f"Again: {again}", ""]
    lines += ["| method | cell | sentence |", "|---|---|---|"]
    cleaned = [(row["method"], row["cell"], row["sentence"].replace("|", "\\|")) for row in found]
    return [*lines, *(f"| {m} | `{c}` | {s} |" for m, c, s in cleaned), ""]
