"""Filter a record and forecast: quantiles at times to come, as CSV and as a picture."""

from argparse import ArgumentParser, Namespace
from pathlib import Path

import numpy as np

from ..errors import ConfigError
from ..files.csv_data import Measurements
from ..files.read_model import read_model
from ..files.write import mean_and_std, write_csv
from ..filter.forecast import Forecast
from . import pictures
from .options import add_files, numbers, place
from .progress import Say, through


def add_arguments(parser: ArgumentParser) -> None:
    """Add the options of ``forecast``."""
    add_files(parser)
    parser.add_argument(
        "--until", required=True, help="last time: a number, or a date where the data has any"
    )
    parser.add_argument("--steps", type=int, default=20, help="times, evenly spaced (default: 20)")
    parser.add_argument("--quantiles", default=".05,.5,.95", help="probabilities (default: .05,.5,.95)")


def main(args: Namespace, say: Say) -> str:
    """Run the command, and return what it found; inputs stay as they are in the last line."""
    file = read_model(args.model)
    data, folder = file.read(args.data), place(args)
    until, levels = data.number(args.until), numbers("--quantiles", args.quantiles)
    if args.steps < 1 or until <= data.times[-1]:
        raise ConfigError(f"--until must be after the last time, {data.stamps[-1]}, and --steps one or more")
    flt = file.filter(data)
    for _ in through(flt, data.times, data.z, data.inputs, say):
        pass
    say("forecasting")
    ahead = flt.forecast(np.linspace(data.times[-1], until, args.steps + 1)[1:], levels)
    _write(folder / "forecast.csv", ahead, data)
    lines = [f"{args.steps} times from {data.stamp(float(ahead.t[0]))} to {data.stamp(float(ahead.t[-1]))}"]
    lines.append(f"{'state, at the end':24}{'mean':>14}{'± std':>14}")
    for a, label in enumerate(file.labels):
        lines.append(f"{label[:23]:24}{ahead.mean[-1, a]:14.5g}{np.sqrt(ahead.cov[-1, a, a]):14.3g}")
    drawn = {"forecast.png": lambda: pictures.over_time(ahead.plot(), file, data)}
    return "\n".join([*lines, pictures.listed(folder, ["forecast.csv"], drawn)])


def _write(path: Path, ahead: Forecast, data: Measurements) -> None:
    """Write a line for every time: mean, standard deviation and quantiles of each state, and doubts."""
    names, moments = mean_and_std(ahead.states, ahead.mean, ahead.cov)
    names += [f"{state}_q{level:g}" for state in ahead.states for level in ahead.levels]
    within = ahead.quantiles.reshape(len(ahead.t), -1).tolist()
    doubts = zip(ahead.error.tolist(), ahead.flagged.astype(int).tolist(), strict=True)
    stamps = [data.stamp(t) for t in ahead.t.tolist()]
    rows = ([t, *m, *q, *d] for t, m, q, d in zip(stamps, moments, within, doubts, strict=True))
    write_csv(path, [data.heading, *names, "error", "flagged"], rows)
