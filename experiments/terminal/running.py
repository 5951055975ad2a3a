"""What commands of many runs share: a console, compiling ahead, progress with the time left, stopping."""

import os
from contextlib import contextmanager
from time import perf_counter

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from sphfilter.campaign.campaign import run_campaign

from ..scene.filters import name_of
from .beside import compiled_beside, take_one
from .progress import Interrupted, bar

_LAID = 2  # states of models whose densities come to lie on lattices as a rule


def new_console(width=132):
    """A console of the terminal's width, or of COLUMNS; a table's where the output goes to a file."""
    console = Console(highlight=False)
    if console.is_terminal or "COLUMNS" in os.environ:
        return console
    return Console(highlight=False, width=width)


def tell(console, sentences):
    """Print sentences, each behind a dot."""
    for sentence in sentences:
        console.print(f"• {escape(sentence)}")


def duration(seconds):
    """Seconds in words that are short."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def warm_up(console, scenario, filters):
    """Let every filter take one measurement, so that compiling neither surprises nor counts as run time.

    Where that has to be compiled, a second process takes about half of it.
    """
    here, beside = _halves(scenario, filters)
    rest = [(name, make) for name, make in filters.items() if here.get(name) is not make]
    with status(console) as say, compiled_beside(scenario, beside) as wait:
        case = scenario.draw(np.random.default_rng(0))
        for i, (name, make) in enumerate([*here.items(), *rest]):
            say(f"preparing {name_of(name)}" + " (the first time compiles, for a minute)" * (i == 0))
            if i == len(here):
                wait()
            problem = take_one(make, case)
            if problem is not None and make is filters[name]:  # the campaign records it, run by run
                say(f"{name_of(name)}: {problem}")


def _halves(scenario, filters):
    """Filters that compile in this process, and in a second one: about as much each.

    The lattices of the SPH filter compile for as long as its families and the filters of others together.
    Where it comes to no lattices, it is as much as the others.
    """
    slow = {name: make for name, make in filters.items() if name == "sph_paper"}
    others = {name: make for name, make in filters.items() if name not in ("sph", "sph_paper")}
    make = filters.get("sph")
    if make is None:
        return others, slow
    if scenario.model.linear or scenario.model.dim > _LAID or make.settings.config.scheme != "auto":
        return {"sph": make}, slow | others
    return {"sph": make.of_scheme("family"), **others}, {"sph": make.of_scheme("log_density"), **slow}


@contextmanager
def status(console):
    """Yield a function that shows what goes on, in a line with its time, or in lines where no terminal is."""
    if not console.is_terminal:
        yield lambda text: console.print(text, style="dim")
        return
    columns = SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn()
    with Progress(*columns, console=console, transient=True) as shown:
        task = shown.add_task("", total=None)
        yield lambda text: shown.update(task, description=text)


def run_shown(console, scenario, filters, n_runs, seed, n_jobs, folder):
    """Run a campaign with a progress bar; stopped, it raises `Interrupted`, which says how to go on."""
    if any(folder.glob("run_*.npz")):
        console.print(f"going on from the runs that are in {folder}", soft_wrap=True)
    with bar(console, "runs", left=True) as move:
        try:
            return run_campaign(scenario, filters, n_runs, seed, n_jobs, folder, _told(console, move))
        except KeyboardInterrupt:
            done = len(list(folder.glob("run_*.npz")))
            if not done:
                _clear(folder)
                raise
            raise Interrupted(
                f"Stopped; {min(done, n_runs)} of {n_runs} runs are kept in {folder}. "
                "The same command goes on from there."
            ) from None


def _clear(folder):
    """Take away what a campaign without a finished run left, and nothing of anybody else's."""
    for path in (*folder.glob("manifest.json"), *folder.glob("*.part")):
        path.unlink()
    if folder.exists() and not any(folder.iterdir()):
        folder.rmdir()


def _told(console, move):
    """What moves a bar, or prints lines where there is no terminal; runs that were found took no time.

    The first run made compiles what nobody needed before: the time left is that of the later ones.
    """
    seen = []

    def progress(done, total):
        move(done, total, found=not seen)
        seen.append((done, perf_counter()))
        if console.is_terminal or not done:
            return
        left = ""
        if len(seen) > 2 and done < total:
            (first, start), (last, now) = seen[1], seen[-1]
            left = f", about {duration((now - start) / (last - first) * (total - done))} left"
        console.print(f"run {done} of {total} done{left}", style="dim")

    return progress
