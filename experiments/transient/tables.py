"""What a transient solution says, in tables, sentences and files."""

import re

import numpy as np
from rich.markup import escape

from experiments.show import tables
from experiments.show.tables import number
from sphfilter.files.write import write_csv as write_lines

_NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?:e-?\d+)?(?![\w])")
_FAINT = 1e-7  # probability below which none is compared
_MOST_ROWS, _MOST_STATES = 12, 6  # times and states in a printed table; files have all


def comparison(problem, solution, reference):
    """Errors of mean and covariance against a reference, at all times, shape (T, 2).

    The mean's in standard deviations of the reference, the covariance's largest entry in units of its
    standard deviations' products.
    """
    n = problem.model.dim
    (ours, our_cov), (mean, cov) = moments(solution.values, n), moments(reference.values, n)
    scale = np.sqrt(np.maximum(np.diagonal(cov, axis1=1, axis2=2), 1e-300))
    off = np.abs(our_cov - cov) / (scale[:, :, None] * scale[:, None, :])
    return np.stack([np.abs((ours - mean) / scale).max(axis=1), off.max(axis=(1, 2))], axis=1)


def moments(values, n):
    """Means (T, n), covariances (T, n, n) of the first and second moments that rows (T, S) begin with."""
    mean, second, (i, j) = values[:, :n], np.empty((len(values), n, n)), np.triu_indices(n)
    second[:, i, j] = second[:, j, i] = values[:, n : n + len(i)]
    return mean, second - mean[:, :, None] * mean[:, None, :]


def table(problem, solution, reference, every=False):
    """Quantities at some of the times, each with a reference's value and half width below, if there is one.

    If not `every` moment is asked for: means and standard deviations of the first states, and what the file
    asks for.
    """
    columns = _columns(problem, solution, reference, every)
    errors = None if reference is None else comparison(problem, solution, reference)
    off = () if reference is None else ("mean off", "cov off")
    made = tables.table("", ("t", "", *off, *(name for name, *_ in columns)), left=2, frame=None)
    for k in _shown(len(problem.times)):
        off = [] if reference is None else [f"{v:.1g}" for v in errors[k]]
        ours = (_number(value[k], np.nanmax(np.abs(value))) for _, value, *_ in columns)
        made.add_row(f"{problem.times[k]:g}", "SPH", *off, *ours)
        if reference is not None:
            theirs = (_with_width(o[k], w[k], np.nanmax(np.abs(value))) for _, value, o, w in columns)
            made.add_row("", "reference", "", "", *theirs, style="dim")
    return made


def _columns(problem, solution, reference, every):
    """Name, values, and values and half widths of the reference, of what a printed table shows."""
    none = np.full((2, *solution.values.shape), np.nan)
    theirs, width = none if reference is None else (reference.values, reference.half_width)
    n, asked = min(problem.model.dim, _MOST_STATES), problem.settings.statistics.moments
    chosen = [
        (q.name, solution.values[:, j], theirs[:, j], width[:, j])
        for j, q in enumerate(problem.quantities)
        if every or j < n or q.powers is None or q.powers in asked
    ]
    if every:
        return chosen
    std = [_deviations(values, problem.model.dim) for values in (solution.values, theirs)]
    unknown = np.zeros(len(problem.times))  # what is not known of its error stands alone
    names = problem.settings.model.states[:n]
    spread = [(f"std {name}", std[0][:, d], std[1][:, d], unknown) for d, name in enumerate(names)]
    return [column for pair in zip(chosen[:n], spread, strict=True) for column in pair] + chosen[n:]


def _deviations(values, n):
    """Standard deviations, shape (T, n)."""
    variances = np.diagonal(moments(values, n)[1], axis1=1, axis2=2)
    return np.sqrt(np.maximum(variances, 0.0))


def _number(value, size):
    """A number to four digits; what is nothing beside the size of its column is 0."""
    return "0" if abs(value) < 1e-5 * size else number(value, ".4g")


def _with_width(value, width, size):
    text = _number(value, size)
    return f"{text}±{width:.1g}" if width > 1e-4 * max(abs(value), 0.01 * size) else text


def _shown(n):
    return np.unique(np.linspace(0, n - 1, min(n, _MOST_ROWS)).round().astype(int))


def steady_table(problem, solution, rivals):
    """Relative errors against the steady state's moments at the last time, 000 (158)."""
    last, rows = f"SPH, t = {problem.times[-1]:g}", []
    for row in problem.settings.steady:
        at = [q.powers for q in problem.quantities].index(row.powers)
        value = solution.values[-1, at]
        errors = (_relative(v, row.value) for v in (value, *(rival.values[-1, at] for rival in rivals)))
        rows.append((escape(problem.quantities[at].name), f"{row.value:.5g}", f"{value:.5g}", *errors))
    headings = ("steady state", "exact", last, "error", *(rival.name for rival in rivals))
    return tables.table("", headings, rows, left=0, frame=None)


def _relative(value, exact):
    return number(100 * abs(value - exact) / abs(exact), ".2g", " %")


def sentences(problem, solution, reference):
    """What came out, in words."""
    infos, sizes = solution.trajectory.infos, [d.n_particles for d in solution.trajectory.densities]
    schemes = ", ".join(dict.fromkeys(info.scheme for info in infos))
    steps, seconds = sum(info.n_steps for info in infos), solution.seconds.sum()
    yield (
        f"{schemes}, {min(sizes)} to {max(sizes)} particles, {steps} steps, {seconds:.2g} s from t = "
        f"{solution.start.t:g} to {problem.times[-1]:g}"
    )
    regrids = sum(info.n_regrids for info in infos if info.scheme != "log_density")  # it does at every step
    if regrids:
        yield f"{regrids} new lattices on the way"
    if any(info.n_discarded for info in infos):
        left = np.prod([1.0 - info.mass_discarded for info in infos])
        yield (
            f"{sum(info.n_discarded for info in infos)} particles whose smoothing lengths did not converge "
            f"were dropped, and their probability, {1.0 - left:.2g}, given to the others"
        )
    for status, count in _grouped(info.status for info in infos if info.status != "ok"):
        yield f"at {count} of {len(infos)} times: {status}"
    if reference is not None:
        mean, cov = np.nanmax(comparison(problem, solution, reference), axis=0)
        against = f"against the {reference.name}"
        yield f"{against}: mean within {mean:.2g} of a standard deviation, covariance {cov:.2g}"
        yield from _exceedances(problem, solution, reference)
    yield from (f"published: {line}" for line in problem.settings.published)


def _grouped(texts):
    """Texts that differ in numbers only as one, with the ranges of the numbers, and how many they were."""
    groups = {}
    for text in texts:
        groups.setdefault(_NUMBER.sub("#", text), []).append([*map(float, _NUMBER.findall(text))])
    for pattern, found in groups.items():
        ends = iter(zip(np.min(found, axis=0), np.max(found, axis=0), strict=True))
        ranges = (f"{low:g}" if low == high else f"{low:g} to {high:g}" for low, high in ends)
        yield re.sub("#", lambda match, ranges=ranges: next(ranges), pattern), len(found)


def _exceedances(problem, solution, reference):
    for j, quantity in enumerate(problem.quantities):
        if quantity.powers is not None:
            continue
        ours, theirs, width = solution.values[:, j], reference.values[:, j], reference.half_width[:, j]
        sure = (theirs > _FAINT) & (width < 0.2 * theirs)
        if sure.any():
            ratio = ours[sure] / theirs[sure]
            low = theirs[sure].min()
            between = f"{ratio.min():.2f} to {ratio.max():.2f}"
            yield f"{quantity.name}: {between} times the reference, down to {low:.1g}"


def write_csv(path, problem, solution, reference):
    """One line a time: quantities, reference and half widths, particles, steps, seconds."""
    names = [q.name for q in problem.quantities]
    spread = [f"std {name}" for name in problem.settings.model.states]
    header = ["t", *names, *spread]
    if reference is not None:
        header += [f"{name} reference" for name in [*names, *spread]] + [f"{n} half width" for n in names]
    header += ["n_particles", "n_steps", "scheme", "status", "seconds"]
    lines, way = [], solution.trajectory
    ours = _deviations(solution.values, problem.model.dim)
    theirs = None if reference is None else _deviations(reference.values, problem.model.dim)
    for k, (density, info) in enumerate(zip(way.densities, way.infos, strict=True)):
        row = [problem.times[k], *solution.values[k], *ours[k]]
        if reference is not None:
            row += [*reference.values[k], *theirs[k], *reference.half_width[k]]
        done = [density.n_particles, info.n_steps, info.scheme, info.status, solution.seconds[k]]
        lines.append([*row, *done])
    write_lines(path, header, lines)
