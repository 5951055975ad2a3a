"""What `run` takes."""

from experiments.terminal.options import add_run, check_run

check = check_run


def add_arguments(add):
    """Add the options of `run`."""
    own = "the scenario's, mostly ekf, ukf, pf and sph; the published scheme is sph_paper"
    add_run(add, "results/NAME", filters=own)
    add("--n-particles", "particles of the SPH filters, at most", int)
