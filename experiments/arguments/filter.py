"""What `filter` takes."""

from pathlib import Path

from experiments.own_data.model_settings import read_data, read_model
from experiments.scene.names import FILTERS, check_filters
from experiments.terminal.options import names_of

__all__ = ["EPILOG", "add_arguments", "check"]

EPILOG = """\
my.csv: a line of names, then a time and what was measured on each line. The times need not be regular, and
may be dates (2024-05-01, 2024-05-01T12:30), counted from the first in data.time_unit. Cells are empty, or
n/a, where nothing was measured. Semicolons may stand between the cells, and then commas in the numbers;
without a line of names the columns are "column 1", "column 2" ...

  t,position
  0.0,3.1
  2.0,
  3.5,-2.7

my.toml: text is allowed wherever a model has functions (see `SDE.from_expressions`).

  [model]                               # dX = drift dt + noise dW, with dW dW' = spectral_density dt
  states = ["x", "v"]
  units = ["m", "m/s"]
  drift = ["v", "-c*v - x*(g + e*x**2)"]
  noise = [["0"], ["1"]]
  spectral_density = [[1.6]]
  parameters = { c = 0.4, g = -1.0, e = 0.1 }

  [sensor]                              # z = h(x) + noise; h is a matrix, or a list such as ["x**2"]
  h = [[1.0, 0.0]]
  noise_cov = [[0.2]]

  [start]                               # belief at the time of the first line, before it is used ...
  mean = [3.0, 0.0]
  cov = [[0.2, 0.0], [0.0, 1.0]]
  # time = -1.0                         # ... unless another time is given

  [data]
  time_unit = "s"                       # that of the model's rates; for the picture, and for dates
  # time = "t"                          # the time is the first column, unless another is named ...
  # columns = ["position"]              # ... and all others are measured, unless some are named

  # [filters]                           # settings, as in the scenarios of the project
  # sph = { n_particles = 400 }

Exit code: 1 if a filter did not come to the end of the data, else 0.
"""


def add_arguments(parser):
    """Add the options of `filter`."""
    parser.add_argument("--model", type=Path, required=True, help="TOML file with model, sensor and start")
    parser.add_argument("--data", type=Path, required=True, help="CSV file: a time and measurements a line")
    parser.add_argument("--filters", type=names_of, help=f"comma-separated, of {', '.join(FILTERS)}")
    parser.add_argument(
        "--seed", type=int, default=1, help="seed of the particle filter (default: %(default)s)"
    )
    parser.add_argument("--out", type=Path, help="folder for results (default: results/NAME of the data)")


def check(args):
    """Raise what is wrong with one of the files, or with the filters."""
    settings = read_model(args.model)
    read_data(settings, args.data)
    check_filters(args.filters)
