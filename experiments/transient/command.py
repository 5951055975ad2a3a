"""`python -m experiments transient NAME`: a density without measurements, beside exact values or paths."""

import shutil
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

import numpy as np
from rich.markup import escape

import sphfilter as sf
from experiments.scene.files import changes_of
from experiments.show.files import write_toml
from experiments.show.tables import print_table
from experiments.terminal.progress import bar, resumable
from experiments.terminal.running import new_console, tell
from sphfilter.campaign.store import versions
from sphfilter.errors import SphfilterError
from sphfilter.files.write import write_json

from . import plots, remeshing
from .film import Window, animate
from .probe import Probing, write_particles
from .problem import load_problem
from .references import reference_of
from .rivals import rivals_of
from .solution import folder_of, solve, warm_up
from .tables import sentences, steady_table, table, write_csv
from .views import probe_picture


def main(args):
    """Run the command; prints to standard output."""
    console = new_console()
    film = Path(args.animate) if args.animate else None
    changes = changes_of(args)
    if args.n_particles is not None:
        changes["solver.n_particles"] = args.n_particles
    if args.no_reference:
        changes["reference.kind"] = "none"
    if args.remesh is None:
        _solve(console, args, changes, film)
    else:
        _compare_remeshing(console, args, changes)


def _solve(console, args, changes, film):
    """Solve, compare with the reference, print, write and draw."""
    problem = load_problem(args.config or args.name, changes)
    window = Window(problem) if args.live else None
    out = _begin(console, args, problem)
    folder = folder_of(out, problem)
    watches = [*_writers(problem, out), *([window] if window else [])]
    solution = _followed(console, problem, folder, watches)
    reference = _reference(console, problem)
    rivals = rivals_of(problem)
    print_table(console, table(problem, solution, reference, args.columns == "all"), keep=2)
    if problem.settings.steady:
        print_table(console, steady_table(problem, solution, rivals))
    for rival in rivals:
        console.print(f"• {rival.name}: {rival.seconds:.2g} s{'; ' * bool(rival.diverged)}{rival.diverged}")
    tell(console, sentences(problem, solution, reference))
    _write(out, problem, solution, reference)
    shutil.rmtree(folder)
    drawn = plots.draw(out, problem, solution, reference, rivals) + _probed(out, problem, solution)
    if film:
        densities = solution.trajectory.densities
        drawn.append(animate(film, problem, [solution.start, *(densities[k] for k in problem.kept)]))
    console.print(
        f"\nNumbers are in {out}/trajectory.npz, statistics.csv and run.json, the file in transient.toml.",
        soft_wrap=True,
    )
    console.print(f"Pictures: {', '.join(str(path) for path in drawn)}", soft_wrap=True)
    if window and window.open:
        console.print("Close the window to end.")
        window.wait()


def _begin(console, args, problem):
    """Say what is solved, and compile; returns the folder for results."""
    console.print(escape(problem.title), style="bold")
    console.print(f"{escape(problem.settings.source)}\n", style="dim")
    console.print("preparing (the first time compiles, for a minute)", style="dim")
    with suppress(SphfilterError):  # the solution will say so
        warm_up(problem)
    return args.out or Path("results") / "transient" / problem.name


def _compare_remeshing(console, args, changes):
    """Solve with each rule of --remesh, print a row and draw a curve of each."""
    asked = remeshing.rules_of(args.remesh)
    problems = {name: load_problem(args.config or args.name, changes | own) for name, own in asked.items()}
    first = next(iter(problems.values()))
    out = _begin(console, args, first)
    folders = {name: folder_of(out, problem) for name, problem in problems.items()}
    rules = [
        remeshing.Rule(name, problem, _followed(console, problem, folders[name]))
        for name, problem in problems.items()
    ]
    reference = _reference(console, first)
    print_table(console, remeshing.table(rules, reference))
    for rule in rules:
        told = sentences(rule.problem, rule.solution, reference)
        tell(console, (f"{rule.name}: {sentence}" for sentence in told))
    drawn = remeshing.draw(out, rules, reference)
    for folder in folders.values():
        shutil.rmtree(folder)
    console.print(f"\nPictures: {', '.join(str(path) for path in drawn)}", soft_wrap=True)


def _writers(problem, out):
    """What is to see every density that is kept, and write a file of it."""
    if problem.settings.probe is not None:
        yield Probing(problem, out / "probe")
    if problem.settings.output.csv:
        folder = out / "particles"
        yield lambda number, density: write_particles(folder / f"{number:04d}.csv", problem, density)


def _probed(out, problem, solution):
    """Paths of the picture of what the probe sees, if there is one that can be drawn."""
    probe = problem.settings.probe
    if probe is None or len(probe.long) > 2:
        return []
    every = [*solution.trajectory.densities, solution.start]  # -1 is the start
    return [probe_picture(out / "probe.png", problem, [every[k] for k in plots.drawn_of(problem, solution)])]


def _followed(console, problem, folder, watches=()):
    def watch(number, density):
        for each in watches:
            each(number, density)

    def kept():
        done = len(list(folder.glob("density_*.npz")))
        return f"{done} of {len(problem.times)} times are in {folder}. The same command goes on."

    with bar(console, "times", len(problem.times)) as move, resumable(kept):
        return solve(problem, folder, move, watch)


def _reference(console, problem):
    if problem.settings.reference.kind == "none":
        return None
    with bar(console, "reference") as move:
        return reference_of(problem, move)


def _write(out, problem, solution, reference):
    """Write densities, numbers, settings and versions."""
    out.mkdir(parents=True, exist_ok=True)
    way, kept = solution.trajectory, problem.kept
    chosen = [tuple(part[k] for k in kept) for part in (way.densities, way.infos)]
    sf.Trajectory(way.times[kept], *chosen).save(out / "trajectory.npz")
    write_csv(out / "statistics.csv", problem, solution, reference)
    settings = asdict(problem.settings)
    write_toml(out / "transient.toml", settings)
    record = {
        "problem": problem.name,
        "versions": versions(),
        "seconds": float(np.sum(solution.seconds)),
        "reference": None if reference is None else reference.name,
        "settings": settings,
    }
    write_json(out / "run.json", record)
