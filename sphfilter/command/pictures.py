"""Pictures of results, where matplotlib is installed."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from .. import drawing
from ..errors import ModelError
from ..files.csv_data import Measurements
from ..files.read_model import ModelOfFile
from ..filter.results import FilterResult
from ..filter.sph_filter import SPHFilter


def listed(folder: Path, written: list[str], pictures: dict[str, Callable[[], Any]]) -> str:
    """Draw pictures by name, and say what is in the folder; or why there is no picture."""
    told = f"{', '.join([*written, *pictures])} written to {folder}"
    try:
        for name, draw in pictures.items():
            drawing.save(draw(), folder / name)
    except ModelError as problem:
        if not isinstance(problem.__cause__, ImportError):
            raise
        told = f"{', '.join(written)} written to {folder}; {problem}"
    return told


def estimates(file: ModelOfFile, data: Measurements, result: FilterResult) -> Any:
    """Draw estimates of all states over time, and readings as dots where the sensor reads them one by one."""
    ax, observed = over_time(result.plot(), file, data), file.sensor.directly_observed
    for column, (state, scale) in enumerate(zip(*observed, strict=True) if observed else ()):
        panel = np.ravel(ax)[state]
        panel.plot(data.times, data.z[:, column] / scale, ".", ms=4, color="0.15", label="reading")
        panel.legend(loc="best", frameon=False, fontsize=8)
    return ax


def density(file: ModelOfFile, data: Measurements, flt: SPHFilter) -> Any:
    """Draw the density that a filter has after the data, of as many states as a picture has."""
    ax = drawing.density(flt.density, file.labels, range(min(6, len(file.labels))))
    np.ravel(ax)[0].set_title(f"{data.heading} = {data.stamp(flt.t)}", loc="left", fontsize=9)
    return ax


def over_time(ax: Any, file: ModelOfFile, data: Measurements) -> Any:
    """Axes of all states over time, with their names, and below its name and unit, or dates."""
    lowest, unit = np.ravel(ax)[-1], file.settings.data.time_unit
    for panel, label in zip(np.ravel(ax), file.labels, strict=True):
        panel.set_ylabel(label)
    lowest.set_xlabel(data.heading if data.dated or not unit else f"{data.heading} ({unit})")
    if data.dated:
        lowest.xaxis.set_major_formatter(lambda t, place: str(data.stamp(t)))
        lowest.figure.autofmt_xdate()
    return ax
