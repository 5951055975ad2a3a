"""What cases found: rows, tables and files."""

from collections import Counter

import numpy as np

from experiments.show import tables
from experiments.show.files import write_rows
from experiments.show.tables import number, percent
from sphfilter.campaign.store import versions

from .referees import LIMITS
from .verdicts import RELATED, VERDICTS

#: Verdicts that are listed one by one, and filters whose first two of these are printed.
_LISTED = "wrong, silent", "crash", "refused", "wrong, flagged", "no answer"
_OWN = "default", "auto"
#: What the list says of a case.
_TOLD = "case", "filter", "states", "system", "noise", "sensors", "sentence"
#: Estimated errors, that of the reference included, within which an error must lie.
_SIGMAS = 3.0


def row_of(case, name, problem, record, referee, verdict):
    """Return the flat row of a case and a filter."""
    k = verdict.errors.shape[1]
    worst = verdict.errors.max(axis=1, initial=0.0) if k else np.full(3, np.nan)
    own = referee.own[:, :k].max(axis=1, initial=0.0) if k else np.full(3, np.nan)
    last = k and k == len(record.x)
    return {
        "seed": case.seed, "case": case.name, **case.place(problem), "filter": name,
        "states": len(problem.x0), "verdict": verdict.verdict, "sentence": " ".join(verdict.sentence.split()),
        **dict(zip((f"{name}_error" for name in LIMITS), worst, strict=True)),
        "last_mean_error": verdict.errors[0, -1] if last else np.nan,
        "info_error": record.told[0, -1] if len(record.x) else np.nan,
        "flagged": bool(record.flagged.any()), "said": " ".join(record.said.split()),
        "schemes": record.schemes, "seconds": record.seconds, "epochs": len(record.x),
        "reference": referee.name or "none", "judged": k,
        **dict(zip((f"reference_{name}_error" for name in LIMITS), own, strict=True)),
        "relations": "; ".join(f"{name}: {found}" for name, found in verdict.related.items()),
        "noise": _noise_of(problem), "n_particles": problem.n_particles,
        "sensors": " and ".join(reader.kind for reader in problem.readers),
        "problem": str(problem), "again": case.again,
    }  # fmt: skip


def _noise_of(problem):
    model = problem.model
    words = [f"rank {len(problem.equation.noise[0])}"]
    words += ["of the state"] if model.state_dependent_noise else []
    words += [] if model.autonomous else ["clock"]
    return ", ".join(words)


def _by(rows, name):
    """Rows by what stands in a column."""
    found = {}
    for row in rows:
        found.setdefault(row[name], []).append(row)
    return found


def sections(rows):
    """Title, headings and lines of each table: a line a filter, or a line a family of the only filter."""
    what, some = "filter", _by(rows, "filter")
    if len(some) == 1:
        what, some = f"family, {next(iter(some))}", dict(sorted(_by(rows, "family").items())) | {"all": rows}
    found = [
        ("verdicts", (what, "cases", *VERDICTS), [
            (name, str(len(own)), *(str(Counter(row["verdict"] for row in own)[v]) for v in VERDICTS))
            for name, own in some.items()
        ]),
        ("relations", ("relation", *RELATED), _relations(rows)),
        ("errors where there is a reference", (what, *_ERRORS), [
            (name, *_errors(own)) for name, own in some.items()
        ]),
    ]  # fmt: skip
    return [section for section in found if section[-1]]


def _relations(rows):
    found = {}
    for row in rows:
        for pair in filter(None, row["relations"].split("; ")):
            name, verdict = pair.split(": ")
            found.setdefault(name, Counter())[verdict] += 1
    return [(name, *(str(counts[v]) for v in RELATED)) for name, counts in sorted(found.items())]


_ERRORS = ("mean 50 %", "95 %", "variance 50 %", "95 %", "evidence 50 %", "95 %",
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
    """Lines about where the SPH filter crashed or is silently wrong, and how to see each again."""
    return [
        f"{row['verdict']}: {row['again']}: {row['sentence']} [{row['problem']}]"
        for row in rows
        if row["verdict"] in _LISTED[:2] and row["filter"] in _OWN
    ]


def sentences():
    """What verdicts mean."""
    mean, variance, evidence = LIMITS.values()
    limits = (
        f"Limits of every epoch: a mean within {mean} posterior standard deviations, "
        f"variances within {variance:.0%}, the evidence so far within {evidence} nat."
    )
    return [limits, *(f"{verdict}: {what}." for verdict, what in VERDICTS.items())]


def write(path, rows, more, args):
    """Write all rows as CSV; beside it tables, `more` among them, and every case that is not right."""
    write_rows(path, rows)
    text = ["# Stress", "", *(f"- {sentence}" for sentence in sentences()), ""]
    text += [f"At most {args.limit:g} s a run; {', '.join(f'{k} {v}' for k, v in versions().items())}.", ""]
    filters = _by(rows, "filter")
    for part in (rows, *(filters.values() if len(filters) > 1 else ())):
        for title, headings, lines in [*sections(part), *(more if part is rows else ())]:
            text += [f"## {title}", "", *tables.markdown(headings, lines), ""]
    text += ["Again: `python -m experiments stress` with `--random-case`, or `--only` and `--seed`.", ""]
    for verdict, found in ((v, own) for v, own in _by(rows, "verdict").items() if v in _LISTED):
        cells = [[str(row[name]).replace("|", "\\|") for name in _TOLD] for row in found]
        text += [f"## {verdict} ({len(cells)})", "", *tables.markdown(_TOLD, cells, left=len(_TOLD)), ""]
    path.with_suffix(".md").write_text("\n".join(text), encoding="utf-8")
