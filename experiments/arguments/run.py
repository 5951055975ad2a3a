"""What `run` takes."""

from pathlib import Path

from experiments.pictures.names import chosen
from experiments.terminal.options import add_run, check_run

__all__ = ["add_arguments", "check"]


def add_arguments(add):
    """Add the options of `run`."""
    own = "the scenario's, mostly ekf, ukf, pf and sph; the published scheme is sph_paper"
    add_run(add, "results/NAME", filters=own)
    add("--n-particles", "particles of the SPH filters, at most", int)
    pictures = "comma-separated pictures of the paper to draw besides the histories, or none"
    drawn = "if sph_paper runs, all the scenario has, but for duffing's rejections, which run it four times"
    add("--pictures", pictures, otherwise=drawn, metavar="NAMES")


def check(args):
    """Raise what is wrong with scenario, filters or pictures."""
    check_run(args)
    chosen(Path(args.scenario).stem, args.pictures)
