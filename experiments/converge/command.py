"""`python -m experiments converge NAME`: error over particles, time step and scheme, with fitted orders."""

from pathlib import Path

from experiments.arguments.converge import FILTER, counts_of, sizes_of, study_of
from experiments.scene.files import changes_of
from experiments.terminal.options import names_of
from experiments.terminal.running import new_console

from . import filters, nodes, sensors, transient


def main(args):
    """Run the command; prints to standard output."""
    console = new_console()
    study = study_of(args)
    if study == "--over step":
        transient.study_steps(args, console, *sizes_of(args))
    else:
        counts, names = counts_of(args, study), names_of(args.scenario) if args.scenario else []
        if study == "--sensors":
            nodes.study(args, console, sensors.problems(names, args.runs, args.seed), counts, "sensors")
        elif study == "--over nodes":
            folder = (args.out or Path("results/converge_nodes")) / "references"
            built = nodes.scenes(names, args.runs, args.seed, changes_of(args), folder)
            nodes.study(args, console, built, counts, "nodes")
        elif study == FILTER:
            filters.study(args, console, args.scenario or "linear_underdamped", counts)
        else:
            transient.study_schemes(args, console, counts)
