"""Relations between answers that hold whatever the problem: the same problem, put differently."""

from dataclasses import replace
from zlib import crc32

import numpy as np


def _eight(problem, rng):
    """One prediction, or eight one after the other."""
    return replace(problem, parts=8)


def _finer(problem, rng):
    """More particles: 800 for 200 or the filter's own choice, twice as many as are more than that."""
    n = 200 if problem.n_particles == "auto" else problem.n_particles
    return replace(problem, n_particles=4 * n if n <= 200 else 2 * n)


def _order(problem, rng):
    """Two sensors that read at the same time, the other first."""
    if len(problem.readers) < 2:
        return None
    return replace(problem, readers=problem.readers[::-1], z=problem.z[::-1])


def _halves(problem, rng):
    """A reading taken as two equal ones that say half as much: R becomes 2 R, twice."""
    readers, z, constant = [], [], 0.0
    for reader, values in zip(problem.readers, problem.z, strict=True):
        half, more = reader.halved()
        readers += [half, half]
        z += [values, values]
        constant += more
    return replace(problem, readers=tuple(readers), z=tuple(z), constant=constant)


def _units(problem, rng):
    """States in other units, up to 1e12 apart, from other origins."""
    powers = rng.uniform(-6.0, 6.0, len(problem.x0)).round()
    return in_other_coordinates(problem, np.diag(10.0**powers), rng.normal(0.0, 1.0, len(powers)).round(2))


def _turned(problem, rng):
    """States turned into each other; one state is mirrored."""
    n = len(problem.x0)
    Q, R = np.linalg.qr(rng.standard_normal((n, n)))
    T = -np.eye(1) if n == 1 else Q * np.sign(np.diag(R))
    return in_other_coordinates(problem, T, np.zeros(n))


def _clock(problem, rng):
    """A clock that is some thousand seconds ahead."""
    ahead = float(np.round(rng.uniform(100.0, 3000.0)))
    n, equation = len(problem.x0), problem.equation
    if np.isfinite(equation.shortest):
        equation = equation.moved(np.eye(n), np.zeros(n), ahead)
    return replace(problem, equation=equation, t0=problem.t0 + ahead, times=problem.times + ahead)


def _pulse(problem, rng):
    """One prediction over a change with the clock, or two."""
    return replace(problem, parts=2) if np.isfinite(problem.equation.shortest) else None


#: Make the related problem, None where there is none; and the tolerance of each as a share of the limits of
#: right and wrong. Those that leave all arithmetic but rounding as it was must agree much better.
RELATIONS = {
    "eight": (_eight, 1.0),
    "finer": (_finer, 1.0),
    "order": (_order, 1.0),
    "halves": (_halves, 1.0),
    "units": (_units, 0.5),
    "turned": (_turned, 1.0),
    "clock": (_clock, 0.25),
    "pulse": (_pulse, 1.0),
}


def related(problem, name, key):
    """The problem that a relation makes of that of a case; None if it makes none."""
    rng = np.random.default_rng([*key, crc32(name.encode())])
    return RELATIONS[name][0](problem, rng)


def chosen_relations(problem, case):
    """Names of the relations that a case is tried by, drawn from those it has."""
    rng = np.random.default_rng([*case.key, crc32(b"relations")])
    some = {"order": len(problem.readers) > 1, "pulse": np.isfinite(problem.equation.shortest)}
    names = [name for name in RELATIONS if some.get(name, True)]
    # those that few problems have come first
    rare = [name for name in names if name in some]
    rest = [str(name) for name in rng.permutation([name for name in names if name not in some])]
    return sorted((rare + rest)[: case.n_relations], key=list(RELATIONS).index)


def in_other_coordinates(problem, T, c):
    """The problem of y, where x = T y + c."""
    back = np.linalg.inv(T)
    readers, z = [], []
    for reader, values in zip(problem.readers, problem.z, strict=True):
        other, lower = reader.moved(T, c)
        readers.append(other)
        z.append(values - lower)
    return replace(
        problem, equation=problem.equation.moved(T, c), readers=tuple(readers), z=tuple(z), T=T, c=c,
        x0=back @ (problem.x0 - c), P0=_symmetric(back @ problem.P0 @ back.T),
    )  # fmt: skip


def _symmetric(P):
    return 0.5 * (P + P.T)
