"""What `campaign` takes."""

from experiments.terminal.options import add_run, check_run

check = check_run


def add_arguments(add):
    """Add the options of `campaign`."""
    add_run(add, "results/campaign/NAME", 100, "the scenario's, and grid if it can")
    add("--referee", "the filter that is right, or none", otherwise="the scenario's exact one, else grid")
    prior = "draw truths from the filters' own prior, start.mean and start.cov: then a filter that is right "
    add("--own-prior", f"{prior}is consistent from the first measurement on", bool)
    dask = "run on the machines of a dask scheduler (extra: dask), which have sphfilter installed"
    add("--dask", dask, metavar="ADDRESS")
