"""`python -m experiments run sunspots`: forecasts of the yearly sunspot number, filter against filter.

The sunspot number s is the squared amplitude of a Van der Pol oscillator under noise (Mininni, Gómez and
Mindlin 2000), for the magnetic field of the Sun turns over in each cycle and spots do not show its sign. The
sensor is y = √s = |x + v|; on the scale of the root the noise v is about as large in busy years as in quiet
ones. The sign is left open: the oscillator is the same for (x, u) and (−x, −u), so both branches make the
same forecasts of s, and filters that carry a density count both. EKF and UKF cannot, and take the sign of
their own prediction. To alternate signs at each minimum beforehand, as is usual, would tell a filter of 1976
that the minimum had been reached, which was known years later.
"""

import time
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from experiments.arguments.sunspots import DATA
from experiments.own_data.command import case_of
from experiments.own_data.csv_data import read_measurements
from experiments.own_data.model_file import load_model
from experiments.own_data.plots import draw_forecasts
from experiments.scene.filters import factories, name_of
from experiments.show.files import write_toml
from experiments.show.tables import print_table
from experiments.terminal.running import new_console, tell
from reference_filters.grid import GridFilter
from sphfilter.errors import ConfigError, SphfilterError

from .forecast import fold, score_forecasts, score_history
from .tables import score_table, sentences, write_scores

__all__ = ["fit", "main", "roots", "split", "training_evidence"]

#: One line for `list`.
SUMMARY = "Measured data: the sunspot number as an oscillator whose sign is not seen, forecast 1 and 5 years"
#: Years ahead, and the first year that is forecast; the model is fitted to the years before.
HORIZONS, FIRST = (1, 5), 1949
#: First steps of the simplex search, in logarithms: of parameters, and of R.
_STEP, _MAX_EVALUATIONS = 0.2, 250


def main(args):
    """Run the command; prints to standard output. Returns 1 if a filter stopped."""
    console = new_console()
    args.out.mkdir(parents=True, exist_ok=True)
    data = roots(read_measurements(DATA / "sunspots.csv", 1))
    scenario = load_model(args.model)
    console.print(f"[bold]sunspots[/]: {scenario.settings.description}\n")
    if args.fit:
        scenario = _fitted(console, args.model, scenario, data, args.out / "sunspots.toml")
    filters = factories(args.filters, scenario)
    scores = _scores(console, filters, scenario, data, args.seed)
    learnt, tested = split(data)
    history = {h: score_history(learnt.z[:, 0], tested.times, tested.z[:, 0]) for h in HORIZONS}
    print_table(console, score_table(scores | {"history": history}, HORIZONS))
    tell(console, sentences(scores, history, FIRST))
    write_scores(args.out / "forecasts.csv", scores)
    draw_forecasts(args.out / "forecasts.png", scores)
    console.print(f"\nForecasts are in {args.out}/forecasts.csv and forecasts.png.", soft_wrap=True)
    return int(len(scores) < len(filters))


def roots(data):
    """Square roots of measured numbers; a negative number is refused."""
    if np.any(data.z < 0):
        year = data.times[np.argmax(np.any(data.z < 0, axis=1))]
        raise ConfigError(f"the sunspot number of {year:g} is negative")
    return replace(data, z=np.sqrt(data.z))


def split(data):
    """Years before `FIRST`, and from it on."""
    before = data.times < FIRST
    return (replace(data, times=data.times[part], z=data.z[part]) for part in (before, ~before))


def _scores(console, filters, scenario, data, seed):
    """Scores of all filters that came to the end, by name and horizon."""
    scores, case = {}, case_of(scenario, data)
    for name, make in filters.items():
        begin = time.perf_counter()
        try:
            filt = make(case, np.random.default_rng(seed))
            scores[name] = score_forecasts(
                filt, data.times, data.z[:, 0], scenario.measurement, HORIZONS, FIRST
            )
            console.print(f"{name_of(name)} took {time.perf_counter() - begin:.1f} s", style="dim")
        except SphfilterError as problem:
            console.print(f"{name_of(name)} stopped: {problem}", style="red")
    if not scores:
        raise SphfilterError("no filter came to the end of the data")
    return scores


def training_evidence(scenario, data, parameters, variance):
    """Log-evidence of the measurements, both signs counted, by the grid filter.

    The grid draws nothing, so the evidence is smooth in the parameters, and its error is small beside the
    differences that matter; minus infinity where the grid does not resolve the density.

    Parameters
    ----------
    scenario : Scenario
    data : Measurements
        Roots y.
    parameters : dict of str to float
    variance : float
        R.

    Returns
    -------
    float
    """
    case, grid = case_of(scenario, data), scenario.settings.filters.grid
    model = scenario.model.with_parameters(**parameters)
    try:
        filt = GridFilter(model, fold(variance), case.x0, case.P0, case.t0, size=grid.size, tol=grid.tol)
        return float(filt.run(case.times, case.z).log_evidence.sum())
    except SphfilterError:
        return -np.inf


def fit(scenario, data, max_evaluations=_MAX_EVALUATIONS, report=None):
    """Parameters and R of largest evidence, searched by the simplex method from those of the scenario.

    All are positive and searched by their logarithms.

    Parameters
    ----------
    scenario : Scenario
    data : Measurements
        Roots y.
    max_evaluations : int
    report : callable, optional
        Called with the number of evaluations and the best evidence so far.

    Returns
    -------
    parameters : dict of str to float
    variance : float
    evidence : float
    """
    names, made = list(scenario.model.parameters), []

    def cost(logs):
        *values, variance = np.exp(logs)
        made.append(training_evidence(scenario, data, dict(zip(names, values, strict=True)), variance))
        if report is not None:
            report(len(made), max(made))
        return -made[-1]

    begin = np.log([*scenario.model.parameters.values(), scenario.measurement.noise_cov[0, 0]])
    simplex = np.vstack([begin, begin + _STEP * np.eye(len(begin))])
    options = {"initial_simplex": simplex, "maxfev": max_evaluations, "xatol": 5e-3, "fatol": 1e-2}
    found = minimize(cost, begin, method="Nelder-Mead", options=options)
    if not np.isfinite(found.fun):
        raise SphfilterError("the fit found no parameters whose evidence can be computed; start from others")
    *values, variance = np.exp(found.x)
    return dict(zip(names, map(float, values), strict=True)), float(variance), -float(found.fun)


def _fitted(console, path, scenario, data, out):
    """Fit, write the model file with the parameters found, and read it."""
    learnt, _ = split(data)

    def report(n, best):
        if n % 10 == 0:
            console.print(f"fit: {n} evaluations, log-evidence {best:.2f}", style="dim")

    parameters, variance, evidence = fit(scenario, learnt, report=report)
    tree = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    tree["model"]["parameters"], tree["sensor"]["noise_cov"] = parameters, [[variance]]
    write_toml(out, tree)
    listed = ", ".join(f"{name} = {value:.4g}" for name, value in parameters.items())
    console.print(f"fitted: {listed}, R = {variance:.4g}; log-evidence {evidence:.2f}; written to {out}\n")
    return load_model(out)
