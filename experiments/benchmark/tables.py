"""What a benchmark found, as tables, as sentences, and as files."""

from dataclasses import fields

import numpy as np

from experiments.show import tables
from sphfilter.files.write import write_csv as write_lines

from .methods import label, short, size_text
from .summary import Line, fastest_to_reach, particle_law
from .told import ratios, sentence

#: Errors of the mean at which run times are compared.
LEVELS = (0.1, 0.03, 0.01, 0.003, 0.001)


def _columns():
    """Headings of the table for people, and what stands below them."""
    return {
        "N": lambda i: _size(i) + (f" × {i.threads} thr." if i.threads > 1 else ""),
        "Time (s)": lambda i: _number(i.seconds),
        "Mean": lambda i: _number(i.mean) + ("" if i.certified or not np.isfinite(i.mean) else " †"),
        "Worst": lambda i: _number(i.worst),
        "Cov.": lambda i: _number(i.cov),
        "Evidence": lambda i: _number(i.total),
        "Hellinger": lambda i: _number(i.hellinger),
        "RMSE": lambda i: " ".join(_number(v) for v in i.rmse),
        "NEES": lambda i: _number(i.nees),
        "Evaluations": lambda i: f"{i.evaluations:,.0f}" if i.evaluations else "",
        "Drift calls": lambda i: f"{i.drift:.2g}" if np.isfinite(i.drift) else "",
        "Fall-backs": lambda i: f"{i.fallbacks:.0%}" if i.fallbacks else "",
        "Refused": lambda i: str(i.refused or ""),
        "MB": lambda i: f"{i.memory:.0f}" if i.memory >= 0.5 else "",
        "Failed": lambda i: f"{i.failed} of {i.runs}" if i.failed else "",
    }


def _size(line):
    return size_text(line.family, line.size).removeprefix("N = ").replace(" error", "")


def _called(line):
    """Filter and size in words."""
    who = "SPH filter" if line.family == "auto" else label(line.series)
    return ", ".join(filter(None, (who, size_text(line.family, line.size))))


def rows(outcome, leave_out=()):
    """Headings, and lines of text of a scenario's table, without columns that are empty or not wanted."""
    columns = {"Filter": lambda i: short(i.family)} | _columns()
    filled = {
        heading: [cell(line) for line in outcome.lines]
        for heading, cell in columns.items()
        if heading not in leave_out
    }
    filled = {
        heading: cells
        for heading, cells in filled.items()
        if any(cell not in ("", tables.UNKNOWN) for cell in cells)
    }
    return list(filled), [list(cells) for cells in zip(*filled.values(), strict=True)]


def table(outcome):
    """The most telling columns of a scenario's table, as a rich table."""
    headings, lines = rows(outcome, leave_out=("Worst", "RMSE", "Evaluations", "MB"))
    made = tables.table(f"{outcome.scenario}: reference {outcome.reference.kind}", headings)
    for column in made.columns:
        column.no_wrap = True
    family = None
    for line, cells in zip(outcome.lines, lines, strict=True):
        if family not in (None, line.family):
            made.add_section()
        made.add_row(*cells if family != line.family else ["", *cells[1:]])
        family = line.family
    return made


def sentences(outcome):
    """What the table means."""
    own, lines = outcome.reference, outcome.lines
    said = []
    if own.mean or own.cov:
        said.append(
            f"The reference's own error is at most {_number(own.mean)} (mean), {_number(own.cov)} "
            f"(covariance), {_number(own.total)} nat (evidence of a run). Errors of the mean marked † are "
            "less than five times as large: they are not to be relied on."
        )
    elif lines:
        said.append("The reference is exact.")
    if any(i.family in ("pf", "pf4") and np.isfinite(i.hellinger) for i in lines):
        said.append(
            "The densities of particle filters are Gaussian kernel estimates of Silverman's width, which is "
            "too wide for densities in several pieces."
        )
    if outcome.left_out:
        said.append(f"Left out, as a run would take too long: {', '.join(outcome.left_out)}.")
    if any(i.family == "auto" for i in lines):
        said.append("SPH, auto: in place of N stands the error of the mean that was asked for.")
    said += [told for i in lines if (told := sentence(i))]
    said += [f"{_called(i)}: {i.failure}" for i in lines if i.failed]
    said += [s for error in LEVELS if (s := _at_level(lines, error))]
    return said


def _at_level(lines, error):
    """Who reaches an error first, and what the best particle filter needs for it."""
    sph = fastest_to_reach([i for i in lines if i.family in ("sph", "auto")], error)
    rivals = [i for i in lines if not i.family.startswith(("sph", "auto", "kf", "benes"))]
    rival = fastest_to_reach(rivals, error)
    if sph is None and rival is None:
        return ""
    parts = []
    if sph is not None:
        parts.append(f"{_called(sph)}, in {_number(sph.seconds)} s")
    if rival is not None:
        parts.append(f"the fastest other, {_called(rival)}, in {_number(rival.seconds)} s")
    law = particle_law(lines)
    if np.isfinite(law):
        parts.append(f"the particle filter by its law in {_number(law / error**2)} s")
    return f"Error {error:g}: {'; '.join(parts)}."


def markdown(outcomes, title):
    """All tables as one markdown text."""
    said = [f"# {title}", ""]
    for outcome in outcomes:
        headings, lines = rows(outcome)
        said += [f"## {outcome.scenario}", "", f"Reference: {outcome.reference.kind}.", ""]
        said += [*tables.markdown(headings, lines), ""]
        said += [f"- {sentence}" for sentence in sentences(outcome)] + [""]
    return "\n".join(said)


def write_csv(path, outcomes):
    """All lines with all their numbers as one CSV file."""
    names = [f.name for f in fields(Line) if f.name not in ("rmse", "schemes", "told", "failure")]
    own = ("mean", "cov", "evidence", "total")
    shares = [f"told_over_left_{share}" for share in (10, 50, 90)]
    heading = [*names, *shares, "rmse", "schemes", "failure", *(f"reference_{name}" for name in own)]
    found = []
    for outcome in outcomes:
        reference = [getattr(outcome.reference, name) for name in own]
        for line in outcome.lines:
            rmse = " ".join(f"{v:.6g}" for v in line.rmse)
            schemes = " ".join(f"{name}:{count}" for name, count in line.schemes.items())
            numbers = [getattr(line, name) for name in names]
            found.append([*numbers, *ratios(line), rmse, schemes, line.failure, *reference])
    write_lines(path, heading, found)


def _number(value):
    return tables.number(value, ",.0f" if 1000 <= abs(value) < 1e6 else ".3g")
