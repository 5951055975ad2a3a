"""`python -m experiments scaling`: cost of a particle and step, threads and memory, as particles grow."""

import multiprocessing
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, fields

import numpy as np

import sphfilter as sf
from sphfilter.files.write import write_csv

from .arguments.scaling import counts_of
from .benchmark.watch import resident, watch_peak
from .show.tables import print_table, table
from .terminal.running import new_console, status, tell
from .transient.problem import load_problem


@dataclass(frozen=True)
class Cell:
    """What one scheme costs on one number of particles."""

    scheme: str
    n_particles: int
    n_steps: int
    # median wall time of the prediction on one thread and on two
    seconds: float
    threaded: float
    # peak of the process, MB, and what the prediction added to it; NaN where the system does not tell
    memory: float
    own: float

    @property
    def cost(self):
        """Seconds a particle and step on one thread."""
        return self.seconds / (self.n_particles * self.n_steps)


def main(args):
    """Run the command; prints to standard output."""
    schemes, counts = args.schemes, counts_of(args)
    console, cells = new_console(), []
    with status(console) as say:
        for scheme in schemes:
            for count in counts:
                say(f"measuring {scheme} on {count} particles")
                cells.append(_alone(measured, args.scenario, scheme, count, args.interval, args.samples))
    print_table(console, _table(args, cells), keep=2)
    tell(console, _sentences(schemes, cells))
    write_csv(args.out / "scaling.csv", [f.name for f in fields(Cell)], (asdict(c).values() for c in cells))
    console.print(f"Table: {args.out}/scaling.csv", soft_wrap=True)


def _alone(function, *args):
    """Call a function in a process of its own, so that memory is not that of what ran before."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(function, *args).result()


def measured(scenario, scheme, count, interval, n_samples):
    """Measure a `Cell`; one thread and two take turns."""
    import numba  # only here: the command line does without

    problem = load_problem(scenario, {"solver.n_particles": count, "solver.config.scheme": scheme})
    start, config = problem.begin(), problem.settings.solver.config
    most = min(2, numba.config.NUMBA_NUM_THREADS)
    sf.predict(start, problem.model, 1e-3 * interval, config, n_particles=count)  # compiles
    known, before, seconds = watch_peak(), resident(), {1: [], most: []}
    for _ in range(n_samples):
        for threads in seconds:
            numba.set_num_threads(threads)
            began = time.perf_counter()
            _, info = sf.predict(start, problem.model, interval, config, n_particles=count)
            seconds[threads].append(time.perf_counter() - began)
    memory = resident(peak=True) if known else float("nan")
    one, two = (float(np.median(seconds[threads])) for threads in (1, most))
    return Cell(scheme, start.n_particles, info.n_steps, one, two, memory, memory - before)


def _table(args, cells):
    rows = []
    for c in cells:
        row = (str(c.n_particles), str(c.n_steps), f"{c.seconds:.3g}", f"{1e6 * c.cost:.3g}")
        rows.append((c.scheme, *row, f"{c.seconds / c.threaded:.2f}", f"{c.memory:.0f} ({c.own:.0f})"))
    headings = ("particles", "steps", "seconds", "µs / particle, step", "2 threads, times", "MB (own)")
    return table(f"{args.scenario}, {args.interval:g} s", ("scheme", *headings), rows)


def _sentences(schemes, cells):
    for scheme in schemes:
        own = [c for c in cells if c.scheme == scheme]
        cost, sizes = [c.cost for c in own], [c.n_particles for c in own]
        yield (
            f"{scheme}: from {min(sizes)} to {max(sizes)} particles the cost of one and a step stays within "
            f"a factor of {max(cost) / min(cost):.2f}"
        )
