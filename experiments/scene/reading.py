"""Scenario files as settings, without the models that they describe."""

from pathlib import Path

from sphfilter.errors import ConfigError, nearest
from sphfilter.files.model_file import with_tables
from sphfilter.settings import from_table, read_toml

from .files import change, file_names, find_file
from .settings import ScenarioSettings

_FOLDER = Path(__file__).parents[1] / "scenarios"


def scenario_names():
    """Names of the scenarios that come with the project."""
    return file_names(_FOLDER)


def read_settings(name, changes=None):
    """Read the settings of a scenario, by its name or the path of a TOML file, without its model.

    The `changes` are values by dotted key: ``{"times.interval": 3.0}``. The scheme of the SPH filter, and
    keys of the published one's configuration, may be given short: ``{"scheme": "cloud"}``,
    ``{"scheme.kernel": "gaussian"}``. Raises `ConfigError` for an unknown scenario or key (the nearest valid
    one is named), or a value that is not valid.
    """
    path = find_file(name, _FOLDER, "scenario")
    tree = read_toml(path)
    found = _settings(tree, path, path)  # what is wrong with the file is not the changes' fault
    if not changes:
        return found
    for key, value in changes.items():
        _check_parameter(tree, key, changes)
        _change(tree, key, value)
    return _settings(tree, path, f"{name} with {', '.join(changes)} changed")


def _settings(tree, path, source):
    return from_table(ScenarioSettings, with_tables(tree, path), source)


def _check_parameter(tree, key, changes):
    """Refuse a parameter that a text does not have, unless the text changes too: compiling tells later."""
    of, _, name = key.partition(".parameters.")
    others = [other for other in changes if other.startswith(f"{of}.") and ".parameters." not in other]
    known = tree.get(of, {}).get("parameters", {}) if name and not others else {}
    if known and name not in known:
        listed = ", ".join(known)
        raise ConfigError(f"the {of} has no parameter {name!r}{nearest(name, known)}; it has {listed}")


def _change(tree, key, value):
    """As `change`; the schemes of the two SPH filters may be given short."""
    parts = key.split(".")
    if parts[0] in ("scheme", "acceptance"):
        key = ".".join(["filters", "sph" if len(parts) == 1 else "sph_paper", "config", *parts])
    change(tree, key, value)
