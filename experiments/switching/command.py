"""`python -m experiments switching`: targets that turn now and then, by densities and by an IMM."""

import time
from dataclasses import dataclass

import numpy as np

import sphfilter as sf
from reference_filters.imm import ImmFilter

from ..show.tables import number, percent, print_table, table
from ..terminal.running import new_console, status
from .scene import SwitchingScene
from .settings import read_settings

_HEADINGS = ("filter", "modes: rms", "worst", "mean: rms", "right mode", "a step")
_OFF = "off the referee: probabilities of modes, and the mean in standard deviations"


@dataclass(frozen=True)
class Held:
    """A filter held against a referee, over all epochs of all runs."""

    modes: np.ndarray  # shape (R, T, M): its mode probabilities less the referee's
    mean: np.ndarray  # shape (R, T, n): its means less the referee's, in the referee's standard deviations
    right: np.ndarray  # shape (R, T): whether the mode that it finds the most probable is that of the truth
    seconds: float  # of a prediction and an update, on average

    def cells(self):
        """What the table tells of it."""
        rms, worst = np.sqrt(np.mean(self.modes**2)), np.abs(self.modes).max()
        figures = (number(value, ".2g") for value in (rms, worst, np.sqrt(np.mean(self.mean**2))))
        return *figures, percent(self.right.mean()), f"{1e3 * self.seconds:.1f} ms"


def main(args):
    """Run the command; prints to standard output."""
    console, scene = new_console(), SwitchingScene(read_settings(args.scenario))
    makers = {"sph": sf.JumpMarkovFilter, "imm": ImmFilter}
    told = {name: [] for name in (*makers, "referee")}
    with status(console) as say:
        for make in makers.values():  # what compiles does not count
            _followed(make(*scene.start), [scene.settings.interval], [None])
        for run in range(args.runs):
            times, paths = scene.draw(args.seed + run)
            say(f"run {run + 1} of {args.runs}: the referee")
            rough, fine = (_followed(referee, times, paths.z) for referee in scene.referees(paths.truth))
            told["referee"].append(_held(rough, fine, paths.modes))
            for name, make in makers.items():
                say(f"run {run + 1} of {args.runs}: {name}")
                told[name].append(_held(_followed(make(*scene.start), times, paths.z), fine, paths.modes))
    console.print(f"{scene.settings.description}\n{_OFF}")
    print_table(
        console, table("", _HEADINGS, [(name, *_joined(held).cells()) for name, held in told.items()])
    )


def _followed(flt, times, z):
    """Mode probabilities, means and standard deviations after every reading, and seconds a step."""
    rows, start = [], time.perf_counter()
    for t, reading in zip(times, z, strict=True):
        flt.predict(t=t)
        flt.update(reading)
        rows.append((flt.mode_probabilities, flt.x, np.sqrt(np.diag(flt.P))))
    seconds = (time.perf_counter() - start) / len(rows)
    return (*(np.array(column) for column in zip(*rows, strict=True)), seconds)


def _held(found, referee, modes):
    """One run of a filter beside that of the referee."""
    w, x, _, seconds = found
    exact, mean, std, _ = referee
    return Held(w - exact, (x - mean) / std, w.argmax(axis=1) == modes, seconds)


def _joined(runs):
    arrays = (np.array([getattr(held, name) for held in runs]) for name in ("modes", "mean", "right"))
    return Held(*arrays, float(np.mean([held.seconds for held in runs])))
