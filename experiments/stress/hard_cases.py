"""The grid of hard cases: systems and levels of difficulty by family, chosen by name."""

from dataclasses import dataclass, replace
from fnmatch import fnmatch
from functools import partial
from zlib import crc32

import numpy as np

from sphfilter.errors import ConfigError, nearest

from . import hard_families as make
from .hard_systems import OSCILLATORS, START, position


def _each(family, unit, maker, systems, levels, quick):
    """Rows of a family whose maker is told which system to take, maker(system, rng, level)."""
    return [(family, name, unit, partial(maker, name), levels, quick) for name in systems]


def _linear(changes):
    return partial(make.changed(changes), "linear")


_FACTORS, _UNITS = (1e-4, 1e-2, 1.0, 1e2, 1e4), (1e-6, 1e-3, 1.0, 1e3, 1e6)
_GAPS, _INTERVALS = (1e-1, 1e-3, 1e-6, 1e-9, 1e-12), (1e-3, 1e-2, 0.1, 1.0, 10.0)
_OUTLIERS, _STATES, _NUMBERS = (0, 3, 5, 10, 20, 50), (1, 2, 3, 4, 5, 6), (20, 50, 200, 1000, 5000, 20000)
_ROUGH = "root inwards", "root outwards", "cube root", "absolute", "bang-bang"
_CORRELATED = make.changed(lambda gap: {"P0": 0.4 * np.array([[1.0, 1.0 - gap], [1.0 - gap, 1.0]])})
_INTERVAL = make.changed(lambda dt: {"interval": dt, "step": min(0.05, dt)})
#: Family, system, unit of the levels, maker, levels, and those of the reduced grid.
_GRID = [
    *_each("process noise", "×", make.noise, OSCILLATORS, _FACTORS, (1e-4, 1e4)),
    *_each("no noise", "updates", make.no_noise, ("decay", "linear", "double well", "Duffing"), (1, 6, 20),
           (6,)),
    ("noise on some rows", "integrators", "states", make.silent_rows, (0, 2, 3, 4), (0, 3)),
    ("stiff", "forced", "k", make.forced, (1e1, 1e2, 1e3, 1e4), (1e3,)),
    ("stiff", "two rates", "k", make.two_rates, (1e1, 1e2, 1e3, 1e4), (1e2,)),
    ("stiff", "relaxation oscillator", "mu", make.relaxation, (2, 10, 50), ()),
    ("stiff", "double well", "k", make.steep_well, (1e1, 1e2, 1e3), (1e1,)),
    ("stiff", "inward cube", "start std", make.strong_inwards, (1, 10, 100), (10,)),
    ("unstable", "growth", "rate", partial(make.growing, 0.5), (0.5, 1, 2, 5, 10), (1, 5)),
    ("unstable", "growth without noise", "rate", partial(make.growing, 0.0), (0.5, 1, 2, 5), (1,)),
    ("unstable", "saddle", "rate", make.saddle, (0.5, 1, 2, 5), (2,)),
    *_each("rough drift", "Q", make.rough, _ROUGH, (1e-3, 1e-1, 10.0), (0.1,)),
    *_each("blow-up", "margin", make.blow_up, ("cubic outwards", "square"), (10, 3, 1.3, 0.7), (3, 0.7)),
    *_each("noise by state", "strength", make.multiplicative, make.NOISES, (0.05, 0.2, 0.6), (0.2,)),
    ("dimension", "linear chain", "states", partial(make.dimension, True), _STATES, (1, 3, 4)),
    ("dimension", "chain of double wells", "states", partial(make.dimension, False), _STATES, (1, 2)),
    *_each("sensor noise", "R", make.changed(lambda R: {"reader": position(2, R)}), OSCILLATORS,
           (1e-6, 1e-4, 1e-2, 1.0, 1e2), (1e-6, 1e2)),
    *_each("interval", "s", _INTERVAL, ("linear",), _INTERVALS, (1e-3, 10.0)),
    *_each("interval", "s", _INTERVAL, ("Van der Pol", "Duffing"), _INTERVALS, (1.0,)),
    *_each("particles", "N", make.particles, ("linear", "Van der Pol"), _NUMBERS, (20, 50)),
    *_each("near-singular start", "1 - corr.", _CORRELATED, ("linear",), _GAPS, (1e-9,)),
    *_each("near-singular start", "1 - corr.", _CORRELATED, ("Van der Pol",), _GAPS, (1e-3,)),
    # standard deviations far apart, the sensor reading the wide state; and far from those of the readings
    ("near-singular start", "linear along axes", "cond.", _linear(lambda c: {"P0": np.diag([1.0, 1.0 / c])}),
     (1e2, 1e4, 1e8, 1e12), (1e12,)),
    ("badly scaled start", "linear", "× std", _linear(lambda size: {"P0": size**2 * START["P0"]}), _UNITS,
     (1e-6, 1e6)),
    ("units", "states", "×", make.state_units, _UNITS, (1e-6, 1e6)),
    ("units", "time linear", "s", partial(make.time_units, "linear"), _UNITS, (1e-6, 1e6)),
    ("units", "time Van der Pol", "s", partial(make.time_units, "Van der Pol"), _UNITS, (1e6,)),
    ("units", "start of the clock", "s", _linear(lambda t0: {"t0": t0}), (-1e3, 1e3, 1e6, 1e9), (1e9,)),
    ("units", "distance of the origin", "std", make.far_origin, (1e2, 1e4, 1e6, 1e9), (1e6,)),
    *_each("outlier", "σ", make.outlier, ("tanh drift", "linear", "linear chain", "Van der Pol"), _OUTLIERS,
           (3, 20, 50)),
    *_each("outlier", "σ", make.outlier, ("Duffing",), _OUTLIERS, (5,)),
    *_each("missing data", "part", make.missing, ("linear", "Duffing"), (0.0, 0.5, 0.9, 1.0), (0.5, 1.0)),
    *_each("two places", "R", make.two_places, ("double well", "tanh drift", "linear", "Duffing"),
           (1e-3, 1e-2, 0.1, 1.0), (0.1,)),
    *_each("long run", "updates", make.long, ("linear",), (100, 1000, 10000), (100,)),
    *_each("long run", "updates", make.long, ("double well",), (100, 1000, 10000), ()),
    ("repeated times", "linear", "each", make.repeated, (1, 2, 5), (5,)),
]  # fmt: skip


@dataclass(frozen=True)
class HardCase:
    """One square of the grid, and a seed of its data.

    Attributes
    ----------
    seed : int
    row : int
        Of `_GRID`.
    number : float
        The level: how hard it is.
    """

    seed: int
    row: int
    number: float
    #: So many relations the case is tried by, each of which costs a run.
    n_relations = 0

    @property
    def name(self):
        """Unique name, for the command line and for files."""
        return "/".join(list(self.place(None).values())[:3]).replace(" ", "_")

    @property
    def again(self):
        """Options of the command that run this case alone."""
        return f"--only {self.name} --seed {self.seed}"

    @property
    def key(self):
        """Whole numbers that all random about the case is drawn from."""
        return self.seed, crc32(self.name.encode())

    @property
    def patience(self):
        """Times the usual limit that a run may take."""
        return 5.0 if _GRID[self.row][0] == "long run" and self.number > 1000 else 1.0

    @property
    def quick(self):
        """Part of the reduced grid."""
        return self.number in _GRID[self.row][-1]

    def place(self, problem):
        """Family, system and level of the case, and the unit of levels."""
        family, system, unit, *_ = _GRID[self.row]
        return {"family": family, "system": system, "level": f"{self.number:g}", "unit": unit}

    @staticmethod
    def examples():
        """Cases that make a filter, or the first of them a referee, compile what it needs."""
        return chosen(0, ("dimension/*wells/[12]", "dimension/*/[1-4]", "outlier/tanh_drift/5"))

    def problem(self):
        """Make the problem; the same name and seed give the same bits."""
        _, system, _, maker, *_ = _GRID[self.row]
        return replace(maker(np.random.default_rng(self.key), self.number), kind=system)

    def __str__(self):
        return self.name


def hard_cases(seed):
    """Every case of the grid, families in order, levels rising in difficulty or size."""
    return [HardCase(seed, i, level) for i, (*_, levels, _) in enumerate(_GRID) for level in levels]


def chosen(seed, patterns=(), quick=False):
    """Cases whose name fits one of the patterns (all without a pattern), or of the reduced grid alone.

    A pattern has ``*`` and ``?`` as in file names; a family alone means all of it. Raises `ConfigError` for
    one that fits no case.
    """
    every = [case for case in hard_cases(seed) if case.quick or not quick]
    found = {} if patterns else dict.fromkeys(every)
    for pattern in patterns:
        fits = [case for case in every if fnmatch(case.name, pattern) or fnmatch(case.name, f"{pattern}/*")]
        if not fits:
            families = dict.fromkeys(case.name.partition("/")[0] for case in every)
            raise ConfigError(
                f"no cell is named {pattern!r}{nearest(pattern, families)}; "
                f"families are {', '.join(families)}"
            )
        found |= dict.fromkeys(fits)
    return list(found)
