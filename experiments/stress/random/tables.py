"""What random cases found: rows, tables and files."""

from collections import Counter

import numpy as np

from experiments.show import tables
from experiments.show.files import write_rows
from experiments.show.tables import number, percent

from .referees import LIMITS
from .verdicts import RELATED, VERDICTS

__all__ = ["failures", "row_of", "sections", "write"]

#: Verdicts that are listed one by one.
_LISTED = "wrong, silent", "crash", "refused", "wrong, flagged", "no answer"
#: Estimated errors, that of the reference included, within which an error must lie.
_SIGMAS = 3.0


def row_of(case, seed, problem, record, referee, verdict):
    """Return the flat row of a case."""
    k = verdict.errors.shape[1]
    worst = verdict.errors.max(axis=1, initial=0.0) if k else np.full(3, np.nan)
    own = referee.own[:, :k].max(axis=1, initial=0.0) if k else np.full(3, np.nan)
    last = k and k == len(record.x)
    return {
        "seed": seed, "number": case.number, "states": len(problem.x0), "verdict": verdict.verdict,
        "sentence": " ".join(verdict.sentence.split()),
        **dict(zip((f"{name}_error" for name in LIMITS), worst, strict=True)),
        "last_mean_error": verdict.errors[0, -1] if last else np.nan,
        "info_error": record.error[-1] if len(record.x) else np.nan,
        "flagged": bool(record.flagged.any()), "said": " ".join(record.said.split()),
        "schemes": record.schemes, "seconds": record.seconds, "epochs": len(record.x),
        "reference": referee.name or "none", "judged": k,
        **dict(zip((f"reference_{name}_error" for name in LIMITS), own, strict=True)),
        "relations": "; ".join(f"{name}: {found}" for name, found in verdict.related.items()),
        "drift": problem.kind, "noise": _noise_of(problem), "n_particles": problem.n_particles,
        "sensors": " and ".join(reader.kind for reader in problem.readers), "problem": str(problem),
    }  # fmt: skip


def _noise_of(problem):
    model = problem.model
    words = [f"rank {len(problem.equation.noise[0])}"]
    words += ["of the state"] if model.state_dependent_noise else []
    words += [] if model.autonomous else ["clock"]
    return ", ".join(words)


def sections(rows):
    """Title, headings and lines of each table."""
    dims = sorted({row["states"] for row in rows})
    by_dim = {f"{n}-D": [row for row in rows if row["states"] == n] for n in dims} | {"all": rows}
    return [
        ("verdicts", ("states", "cases", *VERDICTS), [
            (name, str(len(some)), *(str(Counter(row["verdict"] for row in some)[v]) for v in VERDICTS))
            for name, some in by_dim.items()
        ]),
        ("relations", ("relation", *RELATED), _relations(rows)),
        ("errors where there is a reference", _ERRORS, [
            (name, *_errors(some)) for name, some in by_dim.items()
        ]),
    ]  # fmt: skip


def _relations(rows):
    found = {}
    for row in rows:
        for pair in filter(None, row["relations"].split("; ")):
            name, verdict = pair.split(": ")
            found.setdefault(name, Counter())[verdict] += 1
    return [(name, *(str(counts[v]) for v in RELATED)) for name, counts in sorted(found.items())]


_ERRORS = ("states", "mean 50 %", "95 %", "variance 50 %", "95 %", "evidence 50 %", "95 %",
           "right: flagged", "unflagged: error within 3 info.error", "median s")  # fmt: skip


def _errors(rows):
    """Quantiles of the errors, and what flags and estimated errors are worth."""
    judged = [row for row in rows if row["judged"]]
    values = []
    for name in LIMITS:
        errors = [row[f"{name}_error"] for row in judged]
        values += [
            number(q, ".2g") for q in (np.nanquantile(errors, [0.5, 0.95]) if errors else [np.nan] * 2)
        ]
    right = [row["flagged"] for row in rows if row["verdict"].startswith("right")]
    within = [
        row["last_mean_error"] <= _SIGMAS * (row["info_error"] + row["reference_mean_error"])
        for row in judged
        if not row["flagged"] and np.isfinite(row["last_mean_error"])
    ]
    seconds = number(np.median([row["seconds"] for row in rows]), ".2g")
    return *values, *(percent(np.mean(some)) if some else tables.UNKNOWN for some in (right, within)), seconds


def failures(rows):
    """Lines about the cases that are crashed or silently wrong, and how to see each again."""
    return [
        f"{row['verdict']}: --random-case {row['seed']}:{row['number']}: {row['sentence']} [{row['problem']}]"
        for row in rows
        if row["verdict"] in _LISTED[:2]
    ]


def write(out, rows):
    """Write random.csv (all rows) and random.md (tables, and every case that is not right)."""
    write_rows(out / "random.csv", rows)
    mean, variance, evidence = LIMITS.values()
    said = (
        f"Wrong: a mean off by more than {mean} posterior standard deviations, a variance by {variance:.0%}, "
        f"or the evidence of the record by {evidence} nat."
    )
    text = ["# Random problems", "", said, "", *(f"- {v}: {what}." for v, what in VERDICTS.items()), ""]
    for title, headings, lines in sections(rows):
        text += [f"## {title}", "", *tables.markdown(headings, lines), ""]
    auto = ", with --auto where the filter chose its particles"
    text += [f"Again: `python -m experiments stress --random-case SEED:NUMBER`{auto}.", ""]
    for verdict in _LISTED:
        found = [row for row in rows if row["verdict"] == verdict]
        cells = [
            (f"{row['seed']}:{row['number']}", *(str(row[name]).replace("|", "\\|") for name in _TOLD))
            for row in found
        ]
        if cells:
            text += [f"## {verdict} ({len(cells)})", ""]
            text += [*tables.markdown(("case", *_TOLD), cells, left=1 + len(_TOLD)), ""]
    (out / "random.md").write_text("\n".join(text), encoding="utf-8")


_TOLD = "states", "drift", "noise", "sensors", "sentence"
