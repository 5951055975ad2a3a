"""`python -m experiments skips`: what each shortcut saves, and that results agree.

Every shortcut is run with and without on a scene that can use it. Times are processor time of one thread.
"""

import time
from dataclasses import dataclass

import numpy as np

from experiments.show.tables import markdown, print_table, table
from experiments.terminal.running import new_console, status
from sphfilter import Gaussian, initialize
from sphfilter.errors import ConfigError
from sphfilter.files.write import write_csv

from .cases import cases

_HEADS = ("shortcut", "scene", "with (ms)", "without (ms)", "ratio", "difference (std)")
_TITLES = {
    "skips": "processor time with each shortcut and without, and how far the results differ",
    "particles": "nodes of the lattice of a Gaussian, its states correlated by one half",
}
_LATTICES = ((1, 100), (2, 200), (3, 400), (4, 800))
_LATTICE_HEADS = ("states", "level set", "box, whitened", "box of the states")
_SAMPLE = 0.005  # seconds one sample takes at least


def main(args):
    """Run the command; prints to standard output."""
    chosen = [case for case in cases() if args.only.lower() in f"{case.name} {case.scene}".lower()]
    if not chosen:
        raise ConfigError(f"no shortcut has {args.only!r} in its name: {', '.join(c.name for c in cases())}")
    console = new_console()
    with status(console) as say:
        rows = []
        for case in chosen:
            say(f"measuring {case.name}, {case.scene}")
            rows.append(_cells(measured(case, args.samples)))
        lattices = [tuple(map(str, (n, *lattice_against_box(n, N)))) for n, N in _LATTICES]
    text = []
    for name, heads, body, left in (("skips", _HEADS, rows, 2), ("particles", _LATTICE_HEADS, lattices, 0)):
        print_table(console, table(_TITLES[name], heads, body, left), keep=2)
        write_csv(args.out / f"{name}.csv", heads, body)
        text += [*markdown(heads, body, left), ""]
    (args.out / "skips.md").write_text("\n".join(text), encoding="utf-8")
    console.print(f"Tables: {args.out}/skips.md, skips.csv, particles.csv", soft_wrap=True)


def _cells(row):
    times = (f"{1e3 * row.on:.3g}", f"{1e3 * row.off:.3g}", f"{row.ratio:.2f}")
    return (row.name, row.scene, *times, f"{row.difference:.1e}")


@dataclass(frozen=True)
class Measured:
    """One row of the table."""

    name: str
    scene: str
    # median seconds of processor time a call
    on: float
    off: float
    # largest difference of mean and covariance, in standard deviations of the result without the shortcut
    difference: float

    @property
    def ratio(self):
        """Time without over time with the shortcut."""
        return self.off / self.on


def measured(case, n_samples):
    """Measure a `Case`; the medians of `n_samples` samples each."""
    difference = _difference(case.on(), case.off())  # compiles too
    timed = [(run, _calls(run)) for run in (case.on, case.off)]
    seconds = [[_seconds(run, n) for run, n in timed] for _ in range(n_samples)]
    on, off = np.median(seconds, axis=0)
    return Measured(case.name, case.scene, float(on), float(off), difference)


def _calls(run):
    """Calls that fill a sample."""
    return max(1, int(np.ceil(_SAMPLE / max(_seconds(run, 1), 1e-7))))


def _seconds(run, n_calls):
    """Processor time of a call: other programs on the machine do not count."""
    begin = time.process_time()
    for _ in range(n_calls):
        run()
    return (time.process_time() - begin) / n_calls


def _difference(on, off):
    whiten = np.linalg.inv(np.linalg.cholesky(off[1]))
    mean = whiten @ (on[0] - off[0])
    cov = whiten @ (on[1] - off[1]) @ whiten.T
    return float(max(np.abs(mean).max(), np.abs(cov).max()))


def lattice_against_box(n, n_particles):
    """Particles of a Gaussian's level-set lattice, and nodes of boxes around it: whitened, along its axes.

    Its n states are correlated by one half.
    """
    cov = 0.5 * np.eye(n) + 0.5
    p = initialize(Gaussian(np.zeros(n), cov), n_particles)
    cells = np.ptp(p.field.node[: p.field.kept], axis=0) + 1
    extent = np.ptp(p.x, axis=0)
    own = np.prod(extent / np.abs(np.linalg.det(p.field.A)) ** (1.0 / n) + 1)
    return p.n_particles, int(np.prod(cells)), int(own)
