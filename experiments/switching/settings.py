"""What a scenario whose model switches between modes may say."""

from pathlib import Path
from typing import Any

from sphfilter.errors import ConfigError
from sphfilter.settings import from_table, read_toml, settings

from ..scene.files import file_names, find_file

_FOLDER = Path(__file__).parents[1] / "scenarios" / "switching"
NAMES = tuple(file_names(_FOLDER))


@settings
class SwitchingSettings:
    """A model that switches, a sensor, times and a start."""

    description: str
    interval: float  # between measurements, seconds
    epochs: int
    # of a Gaussian, that the truth is drawn from too
    x0: list[float]
    P0: list[list[float]]
    begins: str  # mode at the start, of the truth; filters do not know it
    rates: list[list[float]]  # shape (M, M)
    # what `SDE.from_expressions` takes: of all modes, and of each; and `GaussianMeasurement`
    model: dict[str, Any]
    modes: dict[str, dict[str, Any]]
    sensor: dict[str, Any]
    # of the grid: how far `beyond` the truth it goes, its `size` and `step`; or a number of particles
    referee: dict[str, float]


def read_settings(name):
    """Read a scenario by its name, or from a path that ends in .toml."""
    path = find_file(name, _FOLDER, "switching scenario")
    found = from_table(SwitchingSettings, read_toml(path), path)
    if found.begins not in found.modes:
        raise ConfigError(f"begins must be one of the modes {list(found.modes)}, got {found.begins!r}")
    return found
