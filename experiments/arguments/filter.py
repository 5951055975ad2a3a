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
  # domain = [["periodic", -3.1416, 3.1416], "unbounded"]   # an angle; ["bounded", 0.0, "none"] has a wall

  [sensor]                              # z = h(x) + noise; h is a matrix, or a list such as ["x**2"]
  h = [[1.0, 0.0]]
  noise_cov = [[0.2]]
  # angles = [0]                        # components of z that are angles, in radians; h is a list then

  [start]                               # belief at the time of the first line, before it is used ...
  mean = [3.0, 0.0]
  cov = [[0.2, 0.0], [0.0, 1.0]]
  # time = -1.0                         # ... unless another time is given

  [data]
  time_unit = "s"                       # that of the model's rates; for the picture, and for dates
  # time = "t"                          # the time is the first column, unless another is named ...
  # columns = ["position"]              # ... and all others are measured, unless some are named

Exit code: 1 if a filter did not come to the end of the data, else 0.

With inputs, tables and several sensors: driven.csv has a column for each input and each sensor, of several
readings columns gps.0, gps.1 ...; cells are empty in lines without a reading of that sensor. The input in a
line is held over the interval that ends at that line; it is never empty.

  t,throttle,gps.0,gps.1,speed
  0.5,1.0,,,0.4
  1.0,1.0,0.3,0.1,
  1.5,-0.5,,,0.9

driven.toml:

  [model]
  states = ["x", "y", "v"]
  drift = ["v*cos(c)", "v*sin(c)", "-k*v + throttle + table('wind', t)"]
  noise = [["0"], ["0"], ["1"]]
  spectral_density = [[0.1]]
  parameters = { c = 0.3, k = 0.2 }
  inputs = ["throttle"]                 # or { throttle = 0.0 }, and it needs no column

  [model.tables.wind]                   # or file = "wind.csv", at = "hour", values = "speed": columns of a
  at = [0.0, 1.0, 2.0]                  # file, whose folder is that of this one
  values = [0.0, 0.3, 0.1]
  kind = "linear"                       # or "previous", held until the next

  [sensors.gps]                         # instead of [sensor]
  h = ["x", "y"]
  noise_cov = [["r", 0], [0, "r"]]      # text or numbers
  parameters = { r = 0.2 }              # and inputs = [...], [sensors.gps.tables.NAME] as of the model

  [sensors.speed]
  h = [[0.0, 0.0, 1.0]]
  noise_cov = [[0.01]]

  [start]
  mean = [0.0, 0.0, 0.0]
  cov = [[0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]]
  time = 0.0

  [data]
  # columns = { gps = ["east", "north"] }   # columns that are not called as the sensors are ...
  # inputs = { throttle = "u (V)" }         # ... or as the inputs
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
