"""Solving a transient problem step by step, every density kept on disk until all are there."""

import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

import sphfilter as sf
from experiments.show.files import unfinished
from sphfilter.density.storage import load_arrays, write_arrays


@dataclass(frozen=True)
class Solution:
    """A solved problem."""

    start: object  # ParticleDensity
    trajectory: object  # Trajectory
    values: np.ndarray  # shape (T, S): the problem's quantities at its times
    seconds: np.ndarray  # shape (T,): wall time of each interval


def warm_up(problem):
    """Compile, or load, what a solution needs, before a clock runs; returns the start."""
    start = problem.begin()
    sf.predict(start, problem.model, 1e-6 * (problem.times[-1] - start.t), problem.settings.solver.config)
    return start


def solve(problem, folder, progress=None, watch=None):
    """Carry a problem's start through its times, from where a stopped run left it in `folder`.

    The folder is that of this problem with these settings only, see `folder_of`. `progress(n_done, n_times)`
    is told of every time; `watch(number, density)` of 0 and the start, and of every density that is kept with
    its number; also of those of a stopped run.
    """
    start, config = problem.begin(), problem.settings.solver.config
    n_particles = problem.n_particles
    done, times = _finished(folder), problem.times
    density = done[-1][0].densities[0] if done else start
    folder.mkdir(parents=True, exist_ok=True)
    show = _only({0, *(problem.kept + 1)}, watch)
    for k, known in enumerate([start, *(way.densities[0] for way, _ in done)]):
        show(k, known)
    began = time.perf_counter()

    def keep(density, info):
        nonlocal began
        k, seconds = len(done), time.perf_counter() - began
        way = sf.Trajectory(times[k : k + 1], (density,), (info,))
        done.append((way, seconds))
        _keep(folder, k, way, seconds)
        show(k + 1, density)
        if progress is not None:
            progress(k + 1, len(times))
        began = time.perf_counter()

    if len(done) < len(times):
        left = times[len(done) :]
        sf.propagate(density, problem.model, left, config, n_particles=n_particles, callback=keep)
    densities, infos = (sum((getattr(way, part) for way, _ in done), ()) for part in ("densities", "infos"))
    values = np.array([[q.of(density) for q in problem.quantities] for density in densities])
    trajectory = sf.Trajectory(times, densities, infos)
    return Solution(start, trajectory, values, np.array([seconds for _, seconds in done]))


def _only(numbers, watch):
    """`watch`, if there is one, for some of the numbers."""
    return lambda number, density: watch(number, density) if watch and number in numbers else None


def folder_of(out, problem):
    """Where densities wait until all are there: another folder for other settings."""
    return unfinished(Path(out), repr(sorted(asdict(problem.settings).items())))


def _file(folder, k):
    return folder / f"density_{k:04d}.npz"


def _keep(folder, k, way, seconds):
    """Write one interval; the file has its name when it is complete."""
    part = folder / "writing.npz"
    way.save(part)
    part.replace(_file(folder, k))
    write_arrays(folder / f"seconds_{k:04d}.npz", {"seconds": np.array(seconds)})


def _finished(folder):
    """Intervals that an earlier run left."""
    done = []
    while _file(folder, len(done)).exists() and (folder / f"seconds_{len(done):04d}.npz").exists():
        k = len(done)
        seconds = float(load_arrays(folder / f"seconds_{k:04d}.npz")["seconds"])
        done.append((sf.Trajectory.load(_file(folder, k)), seconds))
    return done
