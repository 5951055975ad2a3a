"""Files of the version before the rooms: how they were written, and what is to be read from them.

    python tests/cases/files_of_before.py FOLDER        # in the checkout whose files are wanted

Public names alone are used, so that the same lines write with one version and read with another.
"""

import datetime
import json
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import sphfilter as sf

PENDULUM = sf.SDE.from_expressions(
    ["a", "w"], ["w", "-sin(a)"], [["0"], ["1"]], [[0.3]], domain=[("periodic", -np.pi, np.pi), None]
)
DUFFING = sf.SDE.from_expressions(["x", "v"], ["v", "-0.4*v - x*(-1 + 0.1*x**2)"], [["0"], ["1"]], [[1.6]])
POSITION = sf.GaussianMeasurement(h=[[1.0, 0.0]], noise_cov=[[0.2]])
READINGS = (2.1, 1.2, None, -0.5)
SECONDS = 1.0
#: Filters by the name of their file: the model, what the filter is made with, and how many steps it has made
#: when it is written. A step is a prediction and an update, half a step a prediction of half the time.
FILTERS = {
    "default": (DUFFING, {"n_particles": 80}, 2.0),
    "predicted": (DUFFING, {"n_particles": 80}, 1.5),
    "paper": (DUFFING, {"n_particles": 60, "config": sf.FilterConfig.paper()}, 2.0),
    "auto": (DUFFING, {"n_particles": "auto", "dt": SECONDS}, 2.0),
    "periodic": (PENDULUM, {"n_particles": 80}, 2.0),
}
CONFIG = {"scheme": "corrected", "target_error": 0.02, "time_budget": 0.5}
CHANGES = {"times.end": 8.0, "filters.sph.n_particles": 60, "filters.sph_paper.n_particles": 60}
COMMAND = ["campaign", "duffing", "--runs", "2", "--filters", "ekf,sph,sph_paper", "--referee", "none"]
COMMAND += [f"--set={key}={value}" for key, value in CHANGES.items()]
STARTED = datetime.datetime(2026, 1, 1)


def go_on(flt, steps):
    """Predict and update by the readings of these steps; the numbers of each."""
    told = []
    for k in steps:
        flt.predict(t=SECONDS * (k + 1))
        flt.update(READINGS[k])
        told.append(numbers_of(flt))
    return told


def numbers_of(flt):
    """What a filter says, by name, as lists and numbers."""
    names = "t", "x", "P", "x_prior", "P_prior", "log_evidence", "log_likelihood"
    return {name: np.asarray(getattr(flt, name)).tolist() for name in names} | answers(flt.density)


def answers(density):
    """What a density says of itself."""
    at = density.mean() + np.array([[0.0, 0.0], [0.3, -0.4]])
    return {
        "n": len(density.x),
        "mean": density.mean().tolist(),
        "cov": density.cov().tolist(),
        "logpdf": density.logpdf(at).tolist(),
        "tail": float(density.probability(lambda X: X[:, 0] < 0.5)),
    }


@dataclass(frozen=True)
class Walk:
    """A random walk whose first coordinate is measured; no library but numpy has a hand in its numbers."""

    name: str = "walk"

    def draw(self, rng):
        """One case of two epochs."""
        truth = np.cumsum(rng.standard_normal((2, 2)), axis=0)
        z = truth[:, :1] + rng.standard_normal((2, 1))
        return sf.Case([1.0, 2.0], truth, z, np.zeros(2), np.eye(2))


@dataclass(frozen=True)
class Sph:
    """A filter of the walk."""

    n_particles: int = 50

    def __call__(self, case, rng):
        """The filter at the start of `case`."""
        still = sf.LinearSDE(np.zeros((2, 2)), noise=np.eye(2))
        return sf.SPHFilter(still, POSITION, case.x0, case.P0, n_particles=self.n_particles)


def campaign(folder, n_runs=2, **options):
    """The campaign of the walk."""
    return sf.run_campaign(Walk(), {"sph": Sph()}, n_runs, seed=4, folder=folder, **options)


def tracked(predictor, updater, state, steps):
    """Carry a Stone Soup state through predictions and updates."""
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis

    for k in steps:
        when = STARTED + datetime.timedelta(seconds=k)
        prediction = predictor.predict(state, when)
        reading = updater.predict_measurement(prediction)
        state = updater.update(SingleHypothesis(prediction, Detection([2.5 - k], timestamp=when), reading))
    return state


def _write_filters(folder, told):
    for name, (model, options, steps) in FILTERS.items():
        flt = sf.SPHFilter(model, POSITION, x0=[2.5, 0.0], P0=np.diag([0.2, 1.0]), **options)
        go_on(flt, range(int(steps)))
        if steps % 1:
            flt.predict(t=SECONDS * steps)
        flt.save(folder / f"filter_{name}.npz")
        told[name] = {"read": numbers_of(flt), "gone on": go_on(flt, range(int(steps), len(READINGS)))}


def _write_results(folder, told):
    flt = sf.SPHFilter(DUFFING, POSITION, x0=[2.5, 0.0], P0=np.diag([0.2, 1.0]), n_particles=80)
    result = flt.run(np.arange(1.0, 5.0), READINGS)
    result.save(folder / "result.npz")
    told["result"] = {"x": result.x.tolist(), "log_evidence": result.log_evidence.tolist()}
    start = sf.initialize(sf.Gaussian([2.5, 0.0], np.diag([0.2, 1.0])), n_particles=80)
    path = sf.propagate(start, DUFFING, [0.5, 1.0])
    path.save(folder / "trajectory.npz")
    told["trajectory"] = {
        "densities": [answers(density) for density in path.densities],
        "infos": [[info.scheme, info.n_steps, info.status] for info in path.infos],
        "gone on": answers(sf.propagate(path.densities[-1], DUFFING, [1.5]).densities[0]),
    }
    (folder / "config.toml").write_text(sf.FilterConfig(**CONFIG).to_toml(), encoding="utf-8")
    found = campaign(folder / "campaign")
    found.save(folder / "campaign.npz")
    told["campaign"] = {name: getattr(found.results["sph"], name).tolist() for name in ("x", "log_evidence")}


def _write_yaml(folder, told):
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.serialise import YAML
    from stonesoup.types.state import GaussianState
    from stonesoup.types.track import Track

    from sphfilter.adapters.stonesoup import SPHPredictor, SPHUpdater, extend

    sensor = LinearGaussian(ndim_state=2, mapping=[0], noise_covar=np.array([[0.2]]))
    predictor, updater = SPHPredictor(DUFFING, n_particles=80), SPHUpdater(sensor, n_particles=80)
    start = GaussianState([2.5, 0.0], np.diag([0.2, 1.0]), timestamp=STARTED)
    state = tracked(predictor, updater, start, [1, 2])
    yaml = YAML()
    extend(yaml)
    text = yaml.dumps([predictor, updater, Track([start, state])])
    (folder / "stonesoup.yaml").write_text(text, encoding="utf-8")
    on = tracked(predictor, updater, state, [3, 4])
    told["stonesoup"] = {"read": answers(state.density), "gone on": answers(on.density)}


def _write_command(folder):
    """The folder of a command's campaign, less its pictures and its page."""
    from experiments.__main__ import main

    out = folder / "command"
    main([*COMMAND, "--out", str(out)])
    for path in out.iterdir():
        if path.suffix in (".png", ".html", ".md"):
            path.unlink()
    (out / "campaign.npz").unlink()  # as campaign.npz above


def main(folder):
    """Write all files, and the numbers to be found in them."""
    folder.mkdir(parents=True, exist_ok=True)
    told = {}
    for write in (_write_filters, _write_results, _write_yaml):
        write(folder, told)
    _write_command(folder)
    lines = ",\n".join(f"{json.dumps(name)}: {json.dumps(values)}" for name, values in told.items())
    (folder / "numbers.json").write_text(f"{{{lines}}}\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
