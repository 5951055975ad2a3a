"""The numbers of a campaign: errors, consistency, rejections and divergences of each filter. No pictures."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from html import escape
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._types import Bools
from ..consistency import p_values
from ..errors import ModelError, nearest
from ..filter.results import FilterResult
from . import tables
from .campaign import CampaignResult
from .figures import FilterReport, filter_report
from .verdict import unseen, verdict

_HISTORIES = tuple(f.name for f in fields(FilterResult) if f.name != "t")
#: Heading of each row, field, and what it has one of for each.
_ROWS = (
    ("Max peak error", "max_peak_error", "state"),
    ("Mean peak error", "mean_peak_error", "state"),
    ("RMS error", "rms_error", "state"),
    ("Standard error of RMS", "rms_error_std", "state"),
    ("Run time, median (s)", "run_time", ""),
    ("NEES, average", "nees", ""),
    ("NEES inside interval", "nees_inside", ""),
    ("NEES inside, one-sided", "nees_inside_one_sided", ""),
    ("NEES above interval", "nees_above", ""),
    ("NEES below interval", "nees_below", ""),
    ("p of that, by the referee", "exits_p", ""),
    ("NMEE, average", "nmee", "state"),
    ("NMEE inside interval", "nmee_inside", "state"),
    ("NIS per degree of freedom", "innovations.nis", ""),
    ("NIS inside interval", "innovations.nis_inside", ""),
    ("Innovations' correlation", "innovations.whiteness", ""),
    ("p of white innovations", "innovations.whiteness_p", ""),
    ("p of uniform PIT", "ranks.pit_p", "measurement"),
    ("p of uniform truth", "ranks.state_pit_p", "state"),
    ("p of uniform HPD rank", "ranks.hpd_p", ""),
    ("Truth outside 95 % region", "ranks.outside_95", ""),
    ("Measurements rejected", "n_rejected", ""),
    ("Measurements used", "innovations.acceptance", ""),
    ("NIS of those", "innovations.nis_accepted", ""),
    ("Runs diverged", "n_diverged", ""),
    ("Runs failed", "n_failed", ""),
    ("Log-evidence of a run", "log_evidence", ""),
    ("Standard error of it", "log_evidence_std", ""),
)


@dataclass(frozen=True)
class Report:
    """Numbers of all filters of a campaign, with a verdict each.

    Attributes
    ----------
    scenario : str
    dim, n_runs, n_epochs : int
        States, runs, measurement times in a run.
    filters : dict of str to FilterReport
    labels : tuple of str, length dim or empty
        Names of the states.

    Examples
    --------
    >>> import numpy as np
    >>> import sphfilter as sf
    >>> result = sf.FilterResult(
    ...     t=np.array([1.0]), x_prior=np.zeros((1, 1)), P_prior=np.ones((1, 1, 1)), x=np.array([[0.3]]),
    ...     P=np.array([[[0.09]]]), log_evidence=np.zeros(1), accepted=np.ones(1, dtype=bool),
    ... )
    >>> numbers = sf.report(result, truth=[[0.0]])
    >>> print(f"{numbers.n_epochs} epoch, NEES {numbers.filters['filter'].nees:.2f}")
    1 epoch, NEES 1.00
    """

    scenario: str
    dim: int
    n_runs: int
    n_epochs: int
    filters: dict[str, FilterReport]
    labels: tuple[str, ...] = ()

    def __repr__(self) -> str:
        said = "; ".join(f"{name}: {f.verdict}" for name, f in self.filters.items())
        return f"Report({self.scenario!r}, {self.n_runs} runs of {self.n_epochs} epochs; {said})"

    def rows(self) -> list[tuple[str, dict[str, float]]]:
        """Return the table as a list of (label, {filter: number}).

        States have the names that `report` was given, or are counted from 1, as in 002.
        """
        table = []
        for label, field, each in _ROWS:
            values = {name: attrgetter(field)(f) for name, f in self.filters.items()}
            if not each:
                table.append((label, values))
                continue
            for d in range(len(next(iter(values.values())))):
                cells = {name: float(v[d]) for name, v in values.items()}
                named = each == "state" and self.labels
                table.append((f"{label} ({self.labels[d] if named else f'{each} {d + 1}'})", cells))
        return table

    def as_dict(self) -> dict[str, Any]:
        """Return everything as plain dictionaries, lists and numbers, as JSON wants them."""
        return asdict(self, dict_factory=lambda pairs: {k: _plain(v) for k, v in pairs})

    @property
    def title(self) -> str:
        """The scenario, and how much was run."""
        runs = "1 run" if self.n_runs == 1 else f"{self.n_runs} runs"
        return f"{self.scenario}: {runs} of {self.n_epochs} updates".lstrip(": ")

    @property
    def verdicts(self) -> list[str]:
        """A sentence for each filter, and one about what so many runs may have missed."""
        return [*(f"{name}: {f.verdict}" for name, f in self.filters.items()), unseen(self.n_runs, self.dim)]

    def to_markdown(self) -> str:
        """Return title, table and verdicts in Markdown; what no filter tells is left out."""
        said = (f"- {sentence}" for sentence in self.verdicts)
        return "\n".join([f"## {self.title}", "", *tables.in_markdown(*self._table), "", *said, ""])

    def to_latex(self) -> str:
        """Return the table as a LaTeX tabular; it needs the package booktabs."""
        return tables.in_latex(*self._table)

    def to_html(self) -> str:
        """Return title, table and verdicts as a part of an HTML page."""
        said = "".join(f"<li>{escape(sentence)}</li>" for sentence in self.verdicts)
        return f"<h2>{escape(self.title)}</h2>\n{tables.in_html(*self._table)}\n<ul>{said}</ul>\n"

    @property
    def _table(self) -> tuple[list[str], list[list[str]]]:
        return ["", *self.filters], tables.cells_of(self.rows())

    def __str__(self) -> str:
        return "\n".join([self.title, *tables.in_text(*self._table), *self.verdicts])


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


def report(
    campaign_or_result: CampaignResult | FilterResult,
    truth: ArrayLike | None = None,
    *,
    referee: str | None = None,
    labels: Sequence[str] | None = None,
) -> Report:
    """Work out the numbers of a campaign, or of one filter's result.

    Parameters
    ----------
    campaign_or_result : CampaignResult or FilterResult
        A FilterResult may hold one run, or many, stacked with the runs first.
    truth : array_like, shape (T, n) or (R, T, n)
        True states at the measurement times; for a FilterResult only, a campaign carries its own. Errors are
        plain differences: angles have to be on the same turn as the means.
    referee : str, optional
        Name of a filter of the campaign that is right: the NEES of a posterior that is no Gaussian is only
        nearly χ², so that the right filter leaves its interval too, and others need be no better than it.
    labels : sequence of str, length n, optional
        Names of the states, for table and verdicts.

    Returns
    -------
    Report

    Raises
    ------
    ModelError
        A truth that is missing, superfluous or of another shape than the means; an unknown referee.

    Examples
    --------
    >>> import numpy as np
    >>> import sphfilter as sf
    >>> model, sensor = sf.LinearSDE([[-1.0]], noise=[[1.0]]), sf.GaussianMeasurement([[1.0]], [[0.1]])
    >>> truth, z = sf.simulate(model, sensor, [0.0], np.arange(9.0), rng=1)
    >>> result = sf.SPHFilter(model, sensor, [0.0], [[1.0]], n_particles=60).run(np.arange(1.0, 9.0), z[1:])
    >>> print(sf.report(result, truth=truth[1:]).filters["filter"].rms_error.round(2))
    [0.12]
    """
    if not isinstance(campaign_or_result, FilterResult) and hasattr(campaign_or_result, "results"):
        if truth is not None:
            raise ModelError("a campaign carries its truth: leave truth= out")
        c = campaign_or_result
        scenario, true = c.scenario, c.truth
        came: Bools = np.any(np.isfinite(np.reshape(c.z, (*true.shape[:2], -1))), axis=2)
        filters = {name: filter_report(r, true, c.run_time[name], came) for name, r in c.results.items()}
    else:
        if truth is None:
            raise ModelError("report of a filter's result needs truth=, shape (T, n)")
        result: Any = campaign_or_result
        scenario, true = "", np.asarray(truth, dtype=float)
        if true.shape != np.shape(result.x):
            raise ModelError(f"truth has shape {true.shape}, but the means have {np.shape(result.x)}")
        if true.ndim == 2:
            true = true[None]
            result = FilterResult(result.t, *(np.asarray(getattr(result, name))[None] for name in _HISTORIES))
        filters = {"filter": filter_report(result, true, np.full(len(true), np.nan))}
    n_runs, n_epochs, dim = true.shape
    given = () if labels is None else tuple(labels)
    labels = given or [f"state {d + 1}" for d in range(dim)]
    if len(labels) != dim:
        raise ModelError(f"labels must name {dim} states, got {labels}")
    if referee is not None and referee not in filters:
        raise ModelError(f"no filter {referee!r}{nearest(referee, filters)} to be the referee")
    right = None if referee is None else filters[referee]
    for name, numbers in filters.items():
        if right is not None and right.n_failed < right.n_runs:
            p = p_values.more_exits(numbers.exits, right.exits, n_epochs)
            numbers = replace(numbers, exits_p=p)
        filters[name] = replace(numbers, verdict=verdict(numbers, labels, right))
    return Report(scenario=scenario, dim=dim, n_runs=n_runs, n_epochs=n_epochs, filters=filters, labels=given)
