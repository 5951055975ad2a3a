"""What `run` takes."""

from pathlib import Path

from experiments.pictures.names import chosen
from experiments.scene.files import add_change_option, changes_of
from experiments.scene.names import check_filters
from experiments.scene.reading import read_settings
from experiments.terminal.options import add_run_options

__all__ = ["EPILOG", "add_arguments", "check"]

EPILOG = """\
NAME may be the path of a scenario of your own, my.toml, in the form of those in experiments/scenarios. Model,
tables and sensors are written as in `filter --help`; a model with inputs, model.inputs = ["a"], is driven by

  [inputs]                    # each interval between measurements holds the value at its start
  a = "2*sin(t)"              # a number or a text of t and the model's parameters; or, instead, a table of t:
  # [inputs.a]
  # file = "drive.csv"        # beside this file; or at = [0.0, 1.0] and values = [3.0, 4.0]
  # values = "amp"            # a column; the times are the first one, unless another is named: at = "when"
  # kind = "previous"         # held until the next; "linear" otherwise

The truth is driven by them, and all filters are told them (benes has a model of its own, without inputs).
"""


def add_arguments(parser):
    """Add the options of `run`."""
    few = "the scenario's, 5 unless its file says otherwise"
    own = "the scenario's, mostly ekf, ukf, pf and sph; the published scheme is sph_paper"
    add_run_options(parser, few, "results/NAME", own)
    parser.add_argument("--n-particles", type=int, help="particles of the SPH filters, at most")
    parser.add_argument(
        "--pictures",
        metavar="NAMES",
        help="comma-separated pictures of the paper to draw besides the histories, or none (default: if "
        "sph_paper runs, all the scenario has, but for duffing's rejections, which run it four times)",
    )
    add_change_option(parser)


def check(args):
    """Raise what is wrong with scenario, filters or pictures."""
    read_settings(args.scenario, changes_of(args))
    check_filters(args.filters)
    chosen(Path(args.scenario).stem, args.pictures)
