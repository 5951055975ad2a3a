"""What `sweep` takes."""

from experiments.scene.files import add_change_option, changes_of
from experiments.scene.names import check_filters
from experiments.scene.reading import read_settings
from experiments.terminal.options import add_run_options, positive

__all__ = ["add_arguments", "check"]


def add_arguments(parser):
    """Add the options of `sweep`."""
    filters = ["ekf", "ukf", "pf", "sph"]
    more = " at each combination"
    add_run_options(
        parser,
        "the scenario's, 5 unless its file says otherwise",
        "results/sweep_NAME",
        ",".join(filters),
        more,
    )
    parser.set_defaults(filters=filters)
    for key, what, default in (
        ("interval", "seconds between measurements", "0.5, 1, 1.5 and 2 times the scenario's"),
        ("q", "factors on the scenario's process noise Q", "0.5,1,2"),
        ("r", "factors on the scenario's measurement noise R", "1"),
    ):
        text = f"{what}, comma-separated (default: {default})"
        parser.add_argument(f"--{key}", type=positive, metavar="NUMBERS", help=text)
    add_change_option(parser, "change a key of the scenario or of the SPH filter; may be repeated")


def check(args):
    """Raise what is wrong with scenario or filters."""
    read_settings(args.scenario, changes_of(args))
    check_filters(args.filters)
