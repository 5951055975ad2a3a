"""What a number of the library is good for: runs with half and with twice of it, beside those with itself.

    python tests/regression/half_and_twice.py lattice.posterior._ENOUGH   # of a module of sphfilter
    python tests/regression/half_and_twice.py lattice.peaks._ON_LINES 512 --only lattice  # with other values

Per run, over what there is with the number as it is: evaluations of the drift (runs of a fit's filter) and
processor time; how far means moved, in standard deviations (estimates, in standard errors); and how far they
are from those of the same filter with a quarter of the error. A number that compiled code reads is compiled
anew for each value, which takes minutes.
"""

import argparse
import importlib
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
FINER = 4.0  # times smaller is the error of what a mean is held against
SCENES = "double_well", "van_der_pol", "duffing", "pendulum", "predator_prey", "vehicle", "tracking", "lorenz"
LATTICES = ("double_well", "van_der_pol", "duffing")
READINGS = 8
RINGS = ["sqrt(x**2 + y**2)", "sqrt((x - 1)**2 + y**2)"]
RANGES = [(1.0, np.nan), (1.1, 0.6), (np.nan, 0.7), (1.2, 0.5)]
#: What is read, its noise, and the readings.
SHARP = {
    "rings of .1": (RINGS, 0.1, RANGES),
    "rings of .01": (RINGS, 0.01, RANGES),
    "peaks of sin 4 x + y²": (["sin(4*x) + y**2"], 0.05, [(0.5,), (0.6,)]),
    "peaks of x y": (["x*y"], 0.02, [(0.5,), (0.4,)]),
}


def filtered(name, finer=1.0, **shape):
    """Evaluations of the default filter on a scene, or of another shape; means and standard deviations."""
    import sphfilter as sf
    from experiments.scene.scenario import load_scenario

    scenario = load_scenario(name)
    case = scenario.draw(np.random.default_rng(1))
    shape = shape or {"config": sf.FilterConfig(target_error=0.01 / finer)}
    flt = sf.SPHFilter(scenario.model, scenario.measurement, case.x0, case.P0, t0=case.t0, **shape)
    return told_of(flt, zip(case.times[:READINGS], case.z[:READINGS], strict=True))


def fitted(n_particles):
    """Runs of the filter that a fit takes; the estimate, and its standard errors."""
    import sphfilter as sf

    model = sf.SDE.from_expressions(
        states=["x", "v"], drift=["v", "-k*x - c*v - g*x**3"], noise=[[0.0], ["s"]],
        parameters={"k": -1.0, "c": 0.4, "g": 1.0, "s": 0.6},
    )  # fmt: skip
    sensor, times = sf.GaussianMeasurement([[1.0, 0.0]], [[0.04]]), 0.5 * np.arange(1, 13)
    _, z = sf.simulate(model, sensor, [1.0, 0.0], np.append(0.0, times), rng=3)
    flt = sf.SPHFilter(model, sensor, [1.0, 0.0], np.diag([0.2, 0.2]), n_particles=n_particles)
    fit = sf.fit_parameters(flt, times, z[1:], {"g": 0.6, "s": 0.9}, bounds={"s": (1e-3, None)})
    return fit.n_evaluations, [list(fit.estimate.values())], [list(fit.standard_error.values())]


def sharp(read, noise, readings, n_particles):
    """As `filtered`, of a plane on lattices, by readings z = read(x, y) that leave thin ones or pieces."""
    import sphfilter as sf

    model = sf.SDE.from_expressions(["x", "y"], ["-0.2*x", "-0.1*y"], [["0.5", "0"], ["0", "0.5"]])
    sensor = sf.GaussianMeasurement.from_expressions(["x", "y"], read, noise**2 * np.eye(len(read)))
    flt = sf.SPHFilter(model, sensor, [0.8, 0.3], 0.5 * np.eye(2), n_particles=n_particles)
    return told_of(flt, [(0.2 * (t + 1), z) for t, z in enumerate(readings)])


def told_of(flt, readings):
    """Evaluations of a filter that takes readings (time, numbers); means and standard deviations."""
    count, means, stds = 0, [], []
    for t, z in readings:
        count += flt.predict(t=t).n_evaluations
        flt.update(z)
        means.append(flt.x.tolist())
        stds.append(np.sqrt(np.diag(flt.P)).tolist())
    return count, means, stds


def bananas(finer=1.0):
    """As `filtered`, of a place and a velocity by range and angle: Gaussians that are split and merged."""
    import sphfilter as sf

    states, drift, noise = ["x", "u", "y", "v"], ["u", "0", "v", "0"], np.zeros((4, 2))
    noise[1, 0] = noise[3, 1] = 0.2
    model = sf.SDE.from_expressions(states, drift, [[str(w) for w in row] for row in noise])
    read, R = ["sqrt(x**2 + y**2)", "atan2(y, x)"], np.diag([0.01, 0.04])
    sensor = sf.GaussianMeasurement.from_expressions(states, read, R, angles=[1])
    config = sf.FilterConfig(target_error=0.025 / finer, density_error=0.025 / finer)
    flt = sf.SPHFilter(model, sensor, [10, 0, 5, 0.5], np.diag([4, 0.25, 4, 0.25]), config=config)
    readings = [(1.0, [11.0, 0.5]), (2.0, [11.2, 0.45]), (3.0, [11.6, 0.6]), (4.0, [11.5, 0.55])]
    return told_of(flt, readings)


def switched(drifts, readings, finer=1.0):
    """As `filtered`, of a state with two modes that it jumps between."""
    import sphfilter as sf

    modes = {f"of {f}": sf.SDE.from_expressions(["x"], [f], [["0.5"]]) for f in drifts}
    model = sf.JumpMarkovModel(modes, [[-0.5, 0.5], [0.8, -0.8]])
    config = sf.FilterConfig(target_error=0.01 / finer)
    flt = sf.JumpMarkovFilter(model, sf.GaussianMeasurement([[1.0]], [[0.04]]), [0.0], [[0.1]], config=config)
    return told_of(flt, [(0.5 * (k + 1), [z]) for k, z in enumerate(readings)])


def simulated(noise, finer=1.0):
    """No count; mean, second and fourth moment of simulated ends in two wells, and their standard errors."""
    import sphfilter as sf

    model, count = sf.SDE.from_expressions(["x"], ["x - x**3"], [[noise]], [[1.0]]), 50_000
    step = None if finer == 1.0 else 0.01 / finer
    x, _ = sf.simulate(model, None, [0.3], [0.0, 1.0], rng=1, n_paths=count, max_step=step)
    powers = x[:, -1] ** np.array([1, 2, 4])
    return 0, [powers.mean(axis=0).tolist()], [(powers.std(axis=0) / np.sqrt(count)).tolist()]


def runs():
    """Names of the runs, and what makes them."""
    yield from ((f"default: {name}", lambda finer=1.0, name=name: filtered(name, finer)) for name in SCENES)
    for name in LATTICES:
        yield f"lattice: {name}", lambda finer=1.0, name=name: filtered(name, n_particles=int(400 * finer))
    for name, given in SHARP.items():
        yield f"lattice: {name}", lambda finer=1.0, given=given: sharp(*given, int(600 * finer))
    yield "pieces: bananas", bananas
    for drifts in (("0", "1"), ("x - x**3", "-2*x")):
        given = drifts, (0.1, 0.6, 1.4, 1.1, -0.2, 0.1)
        yield f"jumps: drift {' or '.join(drifts)}", lambda finer=1.0, given=given: switched(*given, finer)
    for noise in ("0.7", "0.5*sqrt(1 + x**2)"):
        yield f"simulate: noise {noise}", lambda finer=1.0, noise=noise: simulated(noise, finer)
    yield "fit on lattices", lambda finer=1.0: fitted(300)
    yield "fit on particles or families", lambda finer=1.0: fitted("auto")


def module_of(where):
    """The module of `module.NAME`."""
    return importlib.import_module(f"sphfilter.{where.rpartition('.')[0]}")


def measured(only, setting):
    """Counts, means, deviations and seconds of all runs whose names hold a text, and of their finer twins."""
    if setting:
        where, value = setting
        module, name = module_of(where), where.rpartition(".")[2]
        known = getattr(module, name)
        others = [m for key, m in sys.modules.items() if key.startswith("sphfilter") and name[0] != "_"]
        for one in [module, *(m for m in others if getattr(m, name, None) == known)]:
            setattr(one, name, type(known)(value))
    found = {}
    for name, run in runs():
        if only in name:
            fine = () if setting else run(FINER)
            run()
            began = time.process_time()
            found[name] = (*run(), time.process_time() - began, fine)
    return found


def asked(only, *setting):
    """What `measured` returns, from a process of its own; with compiled code of its own for the core."""
    folder = Path(tempfile.gettempdir()) / f"half_and_twice_{'_'.join(setting)}"
    own = {"NUMBA_CACHE_DIR": str(folder)} if setting and hasattr(module_of(setting[0]), "jit") else {}
    call = [sys.executable, __file__, "--one", *setting, "--only", only]
    said = subprocess.run(call, env=os.environ | own, capture_output=True, text=True, check=True)
    return json.loads(said.stdout.splitlines()[-1])


def off(one, other):
    """Root mean square distance of means, in the standard deviations of the second."""
    return float(np.sqrt(np.nanmean(((np.array(one[1]) - other[1]) / np.array(other[2])) ** 2)))


def main():
    """Run and tell."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("number", nargs="*", help="module.NAME, and values")
    parser.add_argument("--only", default="", help="runs whose names hold this text")
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    sys.path.insert(0, str(HERE.parents[1]))
    if given.one:
        setting = (given.number[0], float(given.number[1])) if given.number else None
        print(json.dumps(measured(given.only, setting)))
        return
    where, *values = given.number
    known = getattr(module_of(where), where.rpartition(".")[2])
    before = asked(given.only)
    for value in values or (0.5 * known, 2.0 * known):
        print(f"{where} = {value} for {known}")
        for run, now in asked(given.only, where, str(value)).items():
            count, *_, seconds, fine = was = before[run]
            told = f"{now[0] / max(count, 1):5.2f} evaluations {now[3] / seconds:5.2f} time"
            error = "" if "fit" in run else f"  error {off(was, fine):.3g} -> {off(now, fine):.3g}"
            print(f"  {run:<30} {told}  moved {off(now, was):.2g}{error}", flush=True)


if __name__ == "__main__":
    main()
