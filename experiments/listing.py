"""`python -m experiments list`: the scenarios, one line each."""

from rich.console import Console
from rich.table import Table

from .scene.scenario import read_settings, scenario_names
from .transient.settings import problem_names, read_problem


def main(args):
    """Print name and description of every scenario."""
    scenarios = [(name, read_settings(name).description) for name in scenario_names()]
    problems = [(name, read_problem(name)[1].description) for name in problem_names()]
    console = Console(highlight=False)
    console.print(_listed(scenarios))
    console.print("\nRun one with: python -m experiments run NAME\n", style="dim")
    console.print(_listed(problems))
    console.print("\nSolve one without measurements with: python -m experiments transient NAME", style="dim")


def _listed(rows):
    made = Table(box=None, show_header=False, pad_edge=False)
    made.add_column(style="bold", no_wrap=True)
    made.add_column()
    for row in rows:
        made.add_row(*row)
    return made
