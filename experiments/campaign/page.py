"""The consistency report as a page: markdown beside its pictures, and one HTML file that holds everything."""

import base64
import html
import re
from operator import attrgetter

from markdown_it import MarkdownIt

from experiments.scene.filters import name_of
from experiments.show.style import quantity
from experiments.show.tables import UNKNOWN, counted, markdown, number

#: Rows of the tables: heading, field of the report, format, and what it has one of for each.
_ERRORS = (
    ("RMS error, {}", "rms_error", "number", "state"),
    ("± sampling error, {}", "rms_error_std", "number", "state"),
    ("largest error of a run on average, {}", "mean_peak_error", "number", "state"),
    ("largest error of all, {}", "max_peak_error", "number", "state"),
    ("run time, median (s)", "run_time", "number", ""),
    ("runs diverged", "n_diverged", "count", ""),
    ("runs failed", "n_failed", "count", ""),
)
_CONSISTENCY = (
    ("NEES, average ({dim} is right)", "nees", "number", ""),
    ("NEES in its 95 % interval, of epochs", "nees_inside", "percent", ""),
    ("… above it", "nees_above", "percent", ""),
    ("… below it", "nees_below", "percent", ""),
    ("p of so many epochs outside, at the referee's rate", "exits_p", "p", ""),
    ("NMEE, average, {} (0 is right)", "nmee", "number", "state"),
    ("NMEE in its 95 % interval, {}", "nmee_inside", "percent", "state"),
    ("truth outside the 95 % region of highest density", "ranks.outside_95", "percent", ""),
    ("p of uniform HPD ranks of the truth", "ranks.hpd_p", "p", ""),
    ("p of uniform ranks of the truth, {}", "ranks.state_pit_p", "p", "state"),
)
_MEASUREMENTS = (
    ("NIS per degree of freedom (1 is right)", "innovations.nis", "number", ""),
    ("NIS in its 95 % interval, of epochs", "innovations.nis_inside", "percent", ""),
    ("correlation of successive innovations (0 is right)", "innovations.whiteness", "number", ""),
    ("p of white innovations", "innovations.whiteness_p", "p", ""),
    ("p of uniform PIT, reading {}", "ranks.pit_p", "p", "reading"),
    ("measurements that came", "innovations.n_measurements", "count", ""),
    ("… used", "innovations.acceptance", "percent", ""),
    ("NIS per degree of freedom of those", "innovations.nis_accepted", "number", ""),
    ("log-evidence of a run", "log_evidence", "number", ""),
    ("± sampling error of it", "log_evidence_std", "number", ""),
)
_MOST = 20  # failures that are told one by one
_READING = """\
**How to read it.** A filter is consistent if the truth lies where its densities say. *NEES* and *NIS* are
squared errors of the estimate and of the predicted measurement, in units of what the filter believes them
to be; *NMEE* is the error with its sign. Shaded bands and "95 % interval" say where the average over the
runs lies 95 times of 100 if the filter is right and its density Gaussian. *PIT* ranks each measurement in
its predicted density, *HPD* ranks the truth by the probability of the region where the posterior is higher:
both are uniform if the filter is right, whatever the shape of its densities, and EKF and UKF are taken at
their word that theirs are Gaussian. A particle cloud has no density, so no HPD rank. p is the probability
of a figure at least as far off by chance; verdicts fault a filter that is right with a probability of one
per cent."""
_STYLE = """\
body{font:16px/1.5 system-ui,sans-serif;max-width:62rem;margin:2rem auto;padding:0 1rem;color:#222}
table{border-collapse:collapse;margin:1rem 0;font-size:.9rem}
th,td{padding:.2rem .7rem;border-bottom:1px solid #ddd;text-align:right}
th:first-child,td:first-child{text-align:left}
img{max-width:100%}code{background:#f4f4f4;padding:.1rem .3rem}h1,h2{line-height:1.2}"""


def write(out, scenario, numbers, facts, failures, pictures):
    """Write report.md and report.html into the folder `out`; returns the path of the latter.

    `numbers` are a `sphfilter.report.Report`; `facts` have seed, filters, referee, command and versions. The
    pictures, by what they show, lie in `out`.
    """
    text = _markdown(scenario, numbers, facts, failures, pictures)
    (out / "report.md").write_text(text, encoding="utf-8")
    body = MarkdownIt("commonmark").enable("table").render(text)
    for path in pictures.values():
        data = base64.b64encode(path.read_bytes()).decode()
        body = body.replace(f'src="{path.name}"', f'src="data:image/png;base64,{data}"')
    title = html.escape(f"Consistency of {scenario.name}")
    head = f'<meta charset="utf-8"><title>{title}</title><style>{_STYLE}</style>'
    page = f'<!doctype html><html lang="en"><head>{head}</head><body>{body}</body></html>'
    (out / "report.html").write_text(page, encoding="utf-8")
    return out / "report.html"


def _markdown(scenario, numbers, facts, failures, pictures):
    lines = [f"# Consistency of {scenario.name}", "", f"{scenario.settings.description}.", ""]
    lines += [
        f"{counted(numbers.n_runs, 'run')} of {counted(numbers.n_epochs, 'measurement')}, "
        f"seed {facts['seed']}; every filter saw the same. `{facts['command']}`",
        "",
        "## Verdicts",
        "",
    ]
    said = numbers.verdicts[-1]
    lines += [f"- **{name_of(name)}**: {f.verdict}." for name, f in numbers.filters.items()]
    lines += ["", f"{said[0].upper()}{said[1:]}."]
    if facts["referee"]:
        lines += ["", _refereed(numbers, facts["referee"])]
    for heading, rows in (("Errors", _ERRORS), ("Truth", _CONSISTENCY), ("Measurements", _MEASUREMENTS)):
        lines += ["", f"## {heading}", "", *_table(numbers, scenario, rows)]
    lines += ["", _READING, ""]
    for shows, path in pictures.items():
        lines += [f"## {shows}", "", f"![{shows}]({path.name})", ""]
    if failures:
        lines += ["## Failures", ""]
        lines += [f"- run {f.run}, {name_of(f.filter)}: {_escaped(f.message)}" for f in failures[:_MOST]]
        if len(failures) > _MOST:
            lines.append(f"- and {len(failures) - _MOST} more, in report.json")
        lines.append("")
    versions = ", ".join(f"{name} {number}" for name, number in facts["versions"].items())
    return "\n".join([*lines, f"Versions: {versions}.", ""])


def _refereed(numbers, referee):
    """Which filters leave the interval of the NEES no more often than the one that is right."""
    n, exits = numbers.n_epochs, numbers.filters[referee].exits
    worse = [name_of(k) for k, f in numbers.filters.items() if f.exits_p < 0.01]
    who = f"{name_of(referee)} is the referee"
    said = f"{who}: its run-averaged NEES leaves the interval in {exits} of {n} epochs. "
    return said + (
        f"Significantly more often do {', '.join(worse)}."
        if worse
        else "No filter does so significantly more often."
    )


def _table(numbers, scenario, rows):
    table = []
    for heading, field, form, each in rows:
        values = [attrgetter(field)(f) for f in numbers.filters.values()]
        if not each:
            table.append([heading.format(dim=numbers.dim), *(_cell(v, form) for v in values)])
            continue
        for d in range(len(values[0])):
            state = quantity(scenario, d) if form == "number" else scenario.labels[d]
            label = state if each == "state" else str(d + 1)
            table.append([heading.format(label), *(_cell(v[d], form) for v in values)])
    return markdown(["", *map(name_of, numbers.filters)], table)


def _escaped(message):
    """The first line of a message, with nothing that markdown or HTML would take for its own."""
    first = html.escape(message.splitlines()[0] if message else "", quote=False)
    return re.sub(r"([\\`*_\[\]|])", r"\\\1", first)


def _cell(value, form):
    text = number(value, {"p": ".2f", "percent": ".0%", "count": ".0f", "number": ".3g"}[form])
    rare = form == "p" and text != UNKNOWN and value < 0.01
    return f"**{max(value, 1e-99):.0e}**" if rare else text
