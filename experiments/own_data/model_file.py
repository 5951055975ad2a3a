"""A model with a sensor and a start from a file: what filters need for measurements from outside."""

from pathlib import Path

from experiments.scene.scenario import Scenario, check_parts

from .model_settings import read_model


def load_model(path):
    """Read a model file and check that its parts fit each other.

    A `Scenario` with `ModelFile` settings: nothing can be drawn from it, but filters can be made for it.
    Raises `ConfigError`, `ExpressionError` or `ModelError`.
    """
    path = Path(path)
    scenario = Scenario(path.stem, read_model(path))
    check_parts(scenario, path)
    return scenario
