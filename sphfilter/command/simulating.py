"""Simulate a model file: readings as a CSV file that ``filter`` reads, the truth in another beside it."""

from argparse import ArgumentParser, Namespace
from pathlib import Path

import numpy as np

from .._types import Floats
from ..errors import ConfigError
from ..files.csv_data import usual_columns
from ..files.read_model import ModelOfFile, read_model
from ..files.write import write_csv
from ..model.simulate import simulate
from .options import numbers
from .progress import Say


def add_arguments(parser: ArgumentParser) -> None:
    """Add the options of ``simulate``."""
    parser.add_argument("--model", type=Path, required=True, help="TOML file with model, sensor and start")
    parser.add_argument("--times", required=True, help="start:end:step, in the unit of the model's rates")
    parser.add_argument("--seed", type=int, default=1, help="seed of everything random (default: 1)")
    parser.add_argument("--out", type=Path, help="CSV file (default: NAME.csv of the model)")


def main(args: Namespace, say: Say) -> str:
    """Run the command, and return what it found; inputs are what the model says."""
    file, times = read_model(args.model), _times(args.times)
    say(f"simulating {len(times)} times")
    rng = np.random.default_rng(args.seed)
    t0 = float(times[0]) if file.t0 is None else file.t0
    x0 = rng.multivariate_normal(file.x0, file.P0)
    truth, z = simulate(file.model, file.sensor, x0, [t0, *times], rng)
    out = args.out or Path(f"{args.model.stem}.csv")
    beside, time = out.with_name(f"{out.stem}_truth.csv"), file.settings.data.time or "t"
    driving = file.settings.data.inputs
    inputs = {driving.get(name, name): value for name, value in file.model.inputs.items()}
    rows = np.column_stack([times, z[1:], np.tile([*inputs.values()], (len(times), 1))])
    write_csv(out, [time, *_columns(file), *inputs], rows.tolist())
    write_csv(beside, [time, *file.model.states], np.column_stack([times, truth[1:]]).tolist())
    return f"{len(times)} lines written to {out}, the truth to {beside}"


def _times(text: str) -> Floats:
    """Times start, start + step, ... up to end; raises `ConfigError`."""
    given = numbers("--times", text, ":")
    if len(given) != 3 or not given[2] > 0.0 or not given[1] >= given[0]:
        raise ConfigError(f"--times takes start:end:step, such as 0:30:0.5, not {text!r}")
    start, end, step = given
    steps = np.arange(int((end - start) / step * (1.0 + 1e-12)) + 1)
    return np.asarray(start + step * steps, dtype=np.float64)


def _columns(file: ModelOfFile) -> list[str]:
    """Names of columns of readings, by which the model file finds them."""
    given, counts = file.settings.data.columns, file.settings.n_readings
    if isinstance(counts, int):
        return [*given] or (["z"] if counts == 1 else [f"z{k}" for k in range(counts)])
    named = given if isinstance(given, dict) else {}
    return [column for name, n in counts.items() for column in named.get(name) or usual_columns(name, n)]
