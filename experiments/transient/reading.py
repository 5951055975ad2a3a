"""Transient files as settings, without the models that they describe."""

from pathlib import Path

from experiments.scene.files import change, file_names, find_file, read_toml
from experiments.scene.tables import with_tables
from sphfilter.settings import from_table

from .settings import TransientSettings

__all__ = ["problem_names", "read_problem"]

_FOLDER = Path(__file__).parents[1] / "scenarios" / "transient"


def problem_names():
    """Names of the transient scenarios that come with the project."""
    return file_names(_FOLDER)


def read_problem(name, changes=None):
    """Read a transient scenario by name, or from the path of a TOML file; `changes` by dotted key.

    Returns
    -------
    path : Path
    settings : TransientSettings

    Raises
    ------
    ConfigError
    """
    path = find_file(name, _FOLDER, "transient scenario")
    tree = read_toml(path)
    for key, value in (changes or {}).items():
        change(tree, key, value)
    return path, from_table(TransientSettings, with_tables(tree, path), path)
