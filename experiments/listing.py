"""`python -m experiments list`: the scenarios, one line each."""

from rich.console import Console
from rich.table import Table

from .scene.scenario import read_settings, scenario_names
from .sunspots import command as sunspots
from .transient.problem import load_problem, problem_names

__all__ = ["add_arguments", "main"]


def add_arguments(parser):
    """Add no options."""


def main(args):
    """Print name and description of every scenario."""
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column()
    for name in scenario_names():
        table.add_row(name, read_settings(name).description)
    table.add_row("sunspots", sunspots.SUMMARY)
    console = Console(highlight=False)
    console.print(table)
    console.print("\nRun one with: python -m experiments run NAME\n", style="dim")
    console.print(_transients())
    console.print("\nSolve one without measurements with: python -m experiments transient NAME", style="dim")


def _transients():
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column()
    for name in problem_names():
        table.add_row(name, load_problem(name).settings.description)
    return table
