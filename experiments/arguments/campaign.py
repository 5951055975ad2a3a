"""What `campaign` takes."""

from experiments.scene.files import add_change_option, changes_of
from experiments.scene.names import check_filters
from experiments.scene.reading import read_settings
from experiments.terminal.options import add_run_options

__all__ = ["EPILOG", "add_arguments", "check"]

EPILOG = """\
Runs have seeds of their own: the figures are the same for any number of processes, and run 7 is the same run
however many there are. Every filter sees the same measurements. Each finished run is kept in OUT/runs;
stopped (Ctrl-C, or worse), the same command goes on, and with a larger --runs it adds to what is there.
"""
_RUNS = 100


def add_arguments(parser):
    """Add the options of `campaign`."""
    own = "the scenario's, and grid if it can"
    add_run_options(parser, str(_RUNS), "results/campaign/NAME", own)
    parser.set_defaults(runs=_RUNS)
    parser.add_argument(
        "--referee", help="the filter that is right, or none (default: the scenario's exact one, else grid)"
    )
    parser.add_argument(
        "--own-prior",
        action="store_true",
        help="draw truths from the filters' own prior, start.mean and start.cov: then a filter that is right "
        "is consistent from the first measurement on",
    )
    parser.add_argument(
        "--dask",
        metavar="ADDRESS",
        help="run on the machines of a dask scheduler (extra: dask), which have sphfilter installed",
    )
    add_change_option(parser)


def check(args):
    """Raise what is wrong with scenario or filters."""
    read_settings(args.scenario, changes_of(args))
    check_filters(args.filters)
