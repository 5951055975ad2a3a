"""The table of a campaign beside the published figures, and what it means in sentences."""

from functools import partial

import numpy as np

from ..scene.filters import FILTERS, name_of
from .style import quantity
from .tables import counted, number, percent, table

#: Rows of 002 Tables 7, 9 and 11: heading, field of the report, field of the publication.
_PER_STATE = (
    ("Max peak error, {}", "max_peak_error", "max_peak"),
    ("Avg peak error, {}", "mean_peak_error", "avg_peak"),
    ("RMS error, {}", "rms_error", "rms"),
    ("  ± sampling error", "rms_error_std", ""),
)


def result_table(report, scenario):
    """Rows of 002 Tables 7, 9, 11 for every filter, with the published figure beside, as a rich table."""
    published = scenario.settings.published
    made = table(f"{scenario.name}: {counted(report.n_runs, 'run')}", [""])
    for name in report.filters:
        made.add_column(name_of(name), justify="right", style="bold")
        if name in published:
            made.add_column("(paper)", justify="right", style="dim")

    def add(label, cell, printed=lambda figures: ""):
        cells = []
        for name, f in report.filters.items():
            cells += [cell(f), printed(published[name])] if name in published else [cell(f)]
        made.add_row(label, *cells)

    def of_state(field, d):
        return lambda f: _number(getattr(f, field)[d]) if field else ""

    for d in range(report.dim):
        for heading, field, printed in _PER_STATE:
            add(heading.format(quantity(scenario, d)), of_state(field, d), of_state(printed, d))
        made.add_section()
    add("Run time (s)", lambda f: _number(f.run_time), lambda figures: _number(figures.run_time))
    add(f"NEES, average ({report.dim} is right)", lambda f: _number(f.nees))
    add("NEES in its 95 % interval", lambda f: percent(f.nees_inside))
    add("Measurements rejected", lambda f: str(f.n_rejected))
    add("Runs diverged", lambda f: f"{f.n_diverged} of {f.n_runs}", partial(_diverged, scenario))
    add("Runs failed", lambda f: str(f.n_failed))
    add("Log-evidence of a run", lambda f: _number(f.log_evidence))
    return made


def _diverged(scenario, figures):
    """Runs that diverged in the publication."""
    n = figures.n_diverged
    return "" if n is None else f"{n} of {scenario.settings.runs.published}"


def distance_table(distances, reference):
    """Distance of each filter from the reference, as a rich table."""
    title = f"Distance from the {FILTERS[reference]}, root mean square"
    rows = (
        ("Mean (exact standard deviations)", "mean"),
        ("Covariance (relative)", "cov"),
        ("Log-evidence of a measurement (nat)", "evidence"),
    )
    cells = [[label, *(number(getattr(d, key), ".2g") for d in distances.values())] for label, key in rows]
    return table(title, ["", *map(name_of, distances)], cells)


def sentences(report, scenario):
    """What the table means, as a list of sentences."""
    said = [
        f"Errors are those of the estimate right after each of the {report.n_epochs} measurements of a run. "
        "A filter is consistent if its errors are as large as its covariance says: "
        f"its NEES is then {report.dim} on average, and its average over the runs lies in the 95 % interval "
        "at 95 % of the measurements."
    ]
    said += [
        s for name, f in report.filters.items() if (s := _verdict(name, f, report, scenario.settings.exact))
    ]
    said += _against_particles(report, scenario)
    published = scenario.settings.runs.published
    if scenario.settings.published and published and report.n_runs < published:
        said.append(
            f"The paper's figures are from {published} runs with truths of its own; ours, of "
            f"{counted(report.n_runs, 'run')}, agree with them to within the sampling error at best. "
            f"For as many runs add --runs {published}."
        )
    return said


def _verdict(name, f, report, exact):
    """What is wrong with a filter, or an empty string; what befalls the exact filter too is bad luck."""
    who = name_of(name)
    unlucky = report.filters[exact].n_diverged if exact in report.filters else 0
    if f.n_failed:
        return f"{who} failed in {f.n_failed} of {f.n_runs} runs: see the messages below."
    if name == exact and unlucky:
        return (
            f"{who} is exact, and yet its NEES averaged over five measurements passed its 99.99 % point in "
            f"{unlucky} of {f.n_runs} runs: bad luck in the noise, for every filter."
        )
    if f.n_diverged > unlucky:
        return (
            f"{who} lost the truth in {f.n_diverged} of {f.n_runs} runs (the NEES averaged over five "
            "measurements passed its 99.99 % point): it believes in an estimate that is wrong."
        )
    if f.n_rejected:
        share = f.n_rejected / (f.n_runs * report.n_epochs)
        return (
            f"{who} rejected {f.n_rejected} of the measurements ({share:.1%}): too far out for its "
            "particles, by its own acceptance test. A larger acceptance.f_edge or domain_mass makes it "
            "rarer."
        )
    return ""


def _against_particles(report, scenario):
    """Compare the SPH filter with the particle filter, and its speed with the published one."""
    said = []
    sph, pf = report.filters.get("sph"), report.filters.get("pf")
    if sph and pf and np.all(np.isfinite([*sph.rms_error, *pf.rms_error])):
        ratio = (sph.rms_error / pf.rms_error - 1) * 100
        listed = ", ".join(f"{r:+.1f} % ({s})" for r, s in zip(ratio, scenario.labels, strict=True))
        n = scenario.settings.filters
        said.append(
            f"RMS error of SPH{_sized(n.sph.n_particles)} against PF with {n.pf.n_particles} particles: "
            f"{listed}."
        )
    published = scenario.settings.published.get("sph_paper")
    for name in ("sph", "sph_paper"):
        f = report.filters.get(name)
        if f and published and np.isfinite(f.run_time):
            said.append(
                f"{name_of(name)} took {f.run_time:.3g} s a run, the paper's {published.run_time:.3g} s on "
                f"its machine: a ratio of {_ratio(published.run_time / f.run_time)}."
            )
    return said


def _sized(n_particles):
    return "" if n_particles == "auto" else f" with at most {n_particles} particles"


def _ratio(value):
    """Two digits, and no power of ten."""
    return f"{float(f'{value:.2g}'):,g}"


def _number(value):
    return number(value, ".3f" if 0.01 <= abs(value) < 100 else ".4g")
