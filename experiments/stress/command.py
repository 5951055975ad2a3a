"""`python -m experiments stress`: hard cells, each judged ok, refused with a sentence, or wrong.

Walks a grid of small filtering problems that are made hard in one respect each, with the default and the
published SPH scheme and the particle filter, and compares every answer with a reference.
"""

from functools import partial
from itertools import pairwise

from experiments.show.tables import counted
from experiments.terminal.progress import bar, resumable
from experiments.terminal.running import new_console, status, tell

from . import plots, tables
from .grid import cells, chosen
from .pool import Lost, run_tasks
from .random import command as random
from .references import Reference, reference
from .runs import Outcome, run
from .store import load, path_of, save, sources

__all__ = ["main"]

#: Seconds a reference may take.
_REFERENCE_LIMIT = 150.0
#: Cells that make every method compile what it needs, and seconds that may take on an empty cache.
_WARM, _COMPILE_LIMIT = ("dimension/*/[1-4]", "outlier/tanh_drift/5"), 1800.0


def main(args):
    """Run the command; prints to standard output."""
    console = new_console()
    if args.random or args.random_case:
        random.main(console, args)
        return
    grid = chosen(args.only, args.quick)
    if args.list:
        for cell in grid:
            console.print(cell.name, soft_wrap=True)
        return
    methods = args.filters
    told = f"{counted(len(grid), 'cell')}, {counted(len(methods), 'filter')}, at most {args.limit:g} s a run"
    console.print(told, style="dim")
    _walk(console, grid, methods, args)
    rows = _rows(grid, methods, args)
    tables.write(args.out, rows, args.seed)
    console.print(tables.table(rows))
    tell(console, tables.sentences(rows))
    for row in rows:
        if row["verdict"] == "wrong" and row["method"] == "default":
            console.print(f"wrong: default, {row['cell']}: {row['sentence']}", style="red", soft_wrap=True)
    drawn = plots.draw(args.out / "stress.png", rows)
    console.print(
        f"\nEvery run is in {args.out}/stress.csv, the rest in stress.md. Picture: {drawn}", soft_wrap=True
    )


def _warm_up(console, methods):
    """Let every method compile, in a process of its own, so that compiling does not count as run time."""
    with status(console) as say:
        say(f"preparing {methods[0]} (the first time compiles, for minutes)")
        following = dict(pairwise(methods))

        def done(method, result):
            if method in following:
                say(f"preparing {following[method]}")

        run_tasks(_compile, methods, 1, lambda method: _COMPILE_LIMIT, done)


def _compile(method):
    for cell in chosen(_WARM):
        run(cell.problem(0), method)


def _walk(console, grid, methods, args):
    """Run what is not yet on disk."""
    tasks = [
        (cell.name, method, args.seed, str(args.out))
        for cell in grid
        for method in ("reference", *methods)
        if _stored(cell, method, args) is None
    ]
    if tasks:
        _warm_up(console, methods)
    by_name = {cell.name: cell for cell in grid}
    kept, count = f"finished runs are kept in {args.out}. The same command goes on from there.", 0
    with bar(console, "runs", len(tasks)) as move, resumable(lambda: kept):

        def done(task, result):
            nonlocal count
            count += 1
            name, method = task[:2]
            if isinstance(result, Lost):
                _save_lost(by_name[name], method, args, result)
            move(count, text=f"{name} {method}")
            if not console.is_terminal and (count % 10 == 0 or count == len(tasks)):
                console.print(f"{count} of {counted(len(tasks), 'run')} done", style="dim")

        run_tasks(_task, tasks, args.jobs, partial(_limit, args.limit), done)


def _limit(seconds, task):
    """References take what they need; long runs of ten thousand updates are allowed five times the usual."""
    return (
        _REFERENCE_LIMIT if task[1] == "reference" else seconds * (5.0 if task[0].endswith("/10000") else 1.0)
    )


def _task(task):
    """Make one result and store it (in a process of its own)."""
    name, method, seed, out = task
    cell = next(cell for cell in cells() if cell.name == name)
    problem = cell.problem(seed)
    result = reference(problem, seed) if method == "reference" else run(problem, method, seed)
    save(path_of(out, cell, seed, method), result, sources(method))


def _save_lost(cell, method, args, lost):
    if method == "reference":
        result = Reference(why=lost.sentence)
    else:
        result = Outcome("timeout" if lost.timeout else "crashed", lost.sentence)
    save(path_of(args.out, cell, args.seed, method), result, sources(method))


def _stored(cell, method, args):
    kind = Reference if method == "reference" else Outcome
    return load(path_of(args.out, cell, args.seed, method), kind, sources(method))


def _rows(grid, methods, args):
    """Judge what is on disk."""
    return [
        tables.row_of(cell, method, _stored(cell, method, args), _stored(cell, "reference", args), args.seed)
        for cell in grid
        for method in methods
    ]
