"""What `run` takes."""

from pathlib import Path

from experiments.pictures.names import chosen
from experiments.scene.files import add_change_option, changes_of
from experiments.scene.names import check_filters
from experiments.scene.reading import read_settings
from experiments.terminal.options import add_run_options

__all__ = ["add_arguments", "check"]


def add_arguments(parser):
    """Add the options of `run`."""
    few = "the scenario's, 5 unless its file says otherwise"
    own = "the scenario's, mostly ekf, ukf, pf, sph and sph_paper"
    add_run_options(parser, few, "results/NAME", own)
    parser.add_argument("--n-particles", type=int, help="particles of the SPH filters, at most")
    parser.add_argument(
        "--pictures",
        metavar="NAMES",
        help="comma-separated pictures of the paper to draw besides the histories, or none "
        "(default: all the scenario has, if sph_paper runs)",
    )
    add_change_option(parser)


def check(args):
    """Raise what is wrong with scenario, filters or pictures."""
    read_settings(args.scenario, changes_of(args))
    check_filters(args.filters)
    chosen(Path(args.scenario).stem, args.pictures)
