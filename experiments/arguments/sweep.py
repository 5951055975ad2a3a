"""What `sweep` takes."""

from experiments.terminal.options import add_run, check_run, positive

check = check_run


def add_arguments(add):
    """Add the options of `sweep`."""
    add_run(add, "results/sweep_NAME", filters=["ekf", "ukf", "pf", "sph"], counted_at=" at each combination")
    for key, what, default in (
        ("interval", "seconds between measurements", "0.5, 1, 1.5 and 2 times the scenario's"),
        ("q", "factors on the scenario's process noise Q", "0.5,1,2"),
        ("r", "factors on the scenario's measurement noise R", "1"),
    ):
        add(f"--{key}", f"{what}, comma-separated", positive, None, default, metavar="NUMBERS")
