"""What a sweep found: rows, table and sentences."""

import numpy as np

from experiments.scene.filters import name_of
from experiments.show import tables
from experiments.show.files import write_rows

#: Filter whose error the others' are compared with, and part of the runs that is much to lose.
_REFERENCE, _MUCH = "pf", 0.1

_CRITERION = (
    "A run counts as lost if the filter failed or diverged: its NEES averaged over 5 updates exceeds its "
    "99.99 % point, so that the error is far larger than the filter believes. A filter that is right loses a "
    "few per cent of the runs by this criterion too; what the PF loses tells how many."
)


def rows_of(cell, numbers):
    """Return a flat row for each filter of a cell, of a `sphfilter.report.Report`.

    `lost` is the part of the runs that diverged or failed, `rms_ratio` the RMS error over the particle
    filter's, geometric mean over the states; NaN without a particle filter.
    """
    reference = numbers.filters.get(_REFERENCE)
    rows = []
    for name, f in numbers.filters.items():
        row = {"interval": cell.interval, "q": cell.q, "r": cell.r, "filter": name, "runs": f.n_runs,
               "diverged": f.n_diverged, "failed": f.n_failed, "lost": (f.n_diverged + f.n_failed) / f.n_runs,
               "rejected": f.n_rejected, "nees": f.nees, "nees_inside": f.nees_inside,
               "rms_ratio": _rms_ratio(f, reference), "run_time": f.run_time}  # fmt: skip
        for d in range(numbers.dim):
            row |= {f"rms_{d + 1}": float(f.rms_error[d]), f"rms_std_{d + 1}": float(f.rms_error_std[d])}
        rows.append(row)
    return rows


def _rms_ratio(f, reference):
    if reference is None:
        return np.nan
    return float(np.exp(np.mean(np.log(f.rms_error / reference.rms_error))))


def _cells_of(rows):
    """Group rows: {(interval, q, r): {filter: row}}."""
    cells = {}
    for row in rows:
        cells.setdefault((row["interval"], row["q"], row["r"]), {})[row["filter"]] = row
    return cells


def _text(rows):
    """Return headings and lines of the table."""
    compared = any(np.isfinite(row["rms_ratio"]) for row in rows)
    names = dict.fromkeys(row["filter"] for row in rows)
    columns = ["lost", f"RMS/{_REFERENCE.upper()}"] if compared else ["lost"]
    lines = []
    for cell, values in _cells_of(rows).items():
        line = [f"{v:g}" for v in cell]
        for row in values.values():
            line += [f"{row['diverged'] + row['failed']} of {row['runs']}", f"{row['rms_ratio']:.2f}"][
                : len(columns)
            ]
        lines.append(line)
    return ["Interval (s)", "Q ×", "R ×", *(f"{name_of(name)} {c}" for name in names for c in columns)], lines


def table(rows, name):
    """Return runs lost and RMS ratios of all filters as a rich table, a line a combination."""
    return tables.table(f"{name}: runs lost, and RMS error against the PF's", *_text(rows), left=0)


def sentences(rows):
    """What the sweep found, as a list of sentences."""
    cells = _cells_of(rows)
    said = [_CRITERION, "RMS errors are at the updates; their ratio is a geometric mean over the states."]
    names = list(next(iter(cells.values())))
    if "ekf" not in names:
        return said
    hard = {cell: values for cell, values in cells.items() if values["ekf"]["lost"] >= _MUCH}
    if not hard:
        return [*said, f"The EKF keeps track: it loses less than {_MUCH:.0%} of the runs everywhere."]
    lost = [f"{t:g} s, Q × {q:g}, R × {r:g} ({v['ekf']['lost']:.0%})" for (t, q, r), v in hard.items()]
    share = f"{_MUCH:.0%} of the runs or more at {len(hard)} of {len(cells)} combinations"
    said.append(f"The EKF loses {share}: {'; '.join(lost)}.")
    return said + [_where_hard(name, list(hard.values())) for name in names if name != "ekf"]


def _where_hard(name, hard):
    """What another filter does where the EKF loses much."""
    lost = np.mean([values[name]["lost"] for values in hard])
    ratio = np.mean([values["ekf"]["rms_ratio"] / values[name]["rms_ratio"] for values in hard])
    text = f"There the {name_of(name)} loses {lost:.0%}"
    return (
        f"{text}, and the EKF's RMS error is {ratio:.1f} times its own." if np.isfinite(ratio) else f"{text}."
    )


def write(out, rows, name):
    """Write the rows to sweep.csv, table and sentences to sweep.md."""
    write_rows(out / "sweep.csv", rows)
    said = [f"- {sentence}" for sentence in sentences(rows)]
    text = [f"# Sweep of {name}", "", *tables.markdown(*_text(rows), left=0), "", *said, ""]
    (out / "sweep.md").write_text("\n".join(text), encoding="utf-8")
