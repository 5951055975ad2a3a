"""What a model file may say to the experiments: besides what the library reads, settings of other filters."""

from pydantic import Field

from experiments.scene.settings import Filters
from sphfilter.files import model_file
from sphfilter.settings import settings


@settings
class ModelFile(model_file.ModelFile):
    """The file. Model, sensor and filters are those of a scenario; times and measurements come from data."""

    filters: Filters = Field(default_factory=Filters)


def read_model(path):
    """The `ModelFile` settings of a TOML file; raises `ConfigError`."""
    return model_file.read_settings(path, ModelFile)
