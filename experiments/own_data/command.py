"""`python -m experiments filter`: run filters on measurements of one's own, from a CSV file.

The model, the sensor and the start come from a TOML file (see `model_file.ModelFile`).
"""

import time
from pathlib import Path

import numpy as np

from experiments.scene.filters import factories, name_of
from experiments.show.tables import counted, print_table, table
from experiments.terminal.running import new_console
from sphfilter.campaign.one_run import Case, put_through
from sphfilter.errors import SphfilterError
from sphfilter.files.model_file import read_data
from sphfilter.files.write import write_estimates

from .model_file import load_model
from .plots import draw


def main(args):
    """Run the command; prints to standard output. Returns 1 if a filter did not come to the end, else 0."""
    console = new_console()
    scenario = load_model(args.model)
    data = read_data(scenario.settings, args.data)
    filters = factories(args.filters, scenario)
    out = args.out or Path("results") / args.data.stem

    n_missing = int(np.isnan(data.z).sum())
    missing = f", {counted(n_missing, 'value')} missing" if n_missing else ""
    console.print(f"[bold]{scenario.name}[/]: {len(data.times)} lines of {args.data}{missing}\n")
    if data.dated and not scenario.settings.data.time_unit:
        console.print(
            "• Dates are counted in seconds: rates of the model in other units need data.time_unit."
        )
    results, seconds, problems = _run(filters, case_of(scenario, data), args.seed)
    for name, problem in problems.items():
        console.print(f"{name_of(name)} stopped: {problem}", style="red")
    if not results:
        raise SphfilterError("no filter came to the end of the data")
    _tell(console, results, seconds)
    for name, result in results.items():
        write_estimates(out / f"{name}.csv", result, scenario.settings.model.states, data.time_name)
    draw(out / "estimates.png", scenario, data, results)
    listed = ", ".join(f"{name}.csv" for name in results)
    console.print(
        f"Estimates are in {out}: {listed}; the picture is {out / 'estimates.png'}.", soft_wrap=True
    )
    return int(bool(problems))


def case_of(scenario, data):
    """Measurements, inputs and start as a `Case` whose truth nobody knows."""
    start, inputs = scenario.settings.start, scenario.model.inputs
    columns = [np.broadcast_to(data.inputs.get(name, inputs[name]), len(data.times)) for name in inputs]
    return Case(
        times=data.times,
        truth=np.full((len(data.times), scenario.model.dim), np.nan),
        z=data.z,
        x0=np.array(start.mean),
        P0=np.array(start.cov),
        t0=float(data.times[0] if start.time is None else start.time),
        inputs=np.column_stack(columns) if columns else None,
    )


def _run(filters, case, seed):
    """Results, run times in seconds and what went wrong, each by filter."""
    results, seconds, problems = {}, {}, {}
    for name, make in filters.items():
        begin = time.perf_counter()
        try:
            results[name] = put_through(make(case, np.random.default_rng(seed)), case)
        except SphfilterError as problem:
            problems[name] = str(problem)
        seconds[name] = time.perf_counter() - begin
    return results, seconds, problems


def _tell(console, results, seconds):
    rows = []
    for name, result in results.items():
        evidence, lines = f"{result.log_evidence.sum():.2f}", (~result.accepted, result.flagged)
        rows.append((name_of(name), evidence, *(str(int(np.sum(k))) for k in lines), f"{seconds[name]:.2f}"))
    heading = "filter", "log-evidence (nat)", "lines rejected", "lines flagged", "run time (s)"
    print_table(console, table("", heading, rows))
    for name, result in results.items():
        if result.flagged.any():
            first = f"{result.t[np.argmax(result.flagged)]:g}"
            doubted = counted(int(result.flagged.sum()), "line")
            console.print(
                f"• {name_of(name)} doubts its answer in {doubted}, the first at {first}: an error above its "
                f"target (columns flagged and error of {name}.csv)."
            )
        if result.outlying.any():
            first = f"{result.t[np.argmax(result.outlying)]:g}"
            console.print(
                f"• {counted(int(result.outlying.sum()), 'reading')}, the first at {first}, more than five "
                f"standard deviations from what {name_of(name)} predicted (column outlying of {name}.csv)."
            )
    console.print(
        "• The log-evidence is the log-density that a filter gave to all measurements before it saw them. "
        "Compare models by it (one filter, the same data): the larger explains the data better, and a "
        "difference of 3 is odds of 20 to 1. Between filters of one model it tells whose forecasts were "
        "better."
    )
    console.print("• The run time includes compiling at a filter's first use.")
