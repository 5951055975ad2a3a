"""Files that were written before the library had rooms are read, and what is in them goes on as it did.

Numbers that a file holds come back to the last bit, those that are computed from it to rounding; other
machines round otherwise, and filters that go on for some steps are compared with more room: with as much as
both may be wrong where lattices of level sets carry or update them, whose steps and nodes are others since.
"""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from files_of_before import (
    CHANGES,
    COMMAND,
    CONFIG,
    DUFFING,
    FILTERS,
    POSITION,
    READINGS,
    answers,
    campaign,
    go_on,
    numbers_of,
    tracked,
)

import sphfilter as sf
from experiments.commands import main
from experiments.scene.scenario import read_settings
from sphfilter.campaign import store
from sphfilter.density.family import Family, gaussian_family
from sphfilter.density.memory import Memory
from sphfilter.density.moments import moments_of_sum
from sphfilter.density.storage import density_from, stored

FOLDER = Path(__file__).parents[1] / "data" / "before_the_rooms"
MODES = FOLDER.with_name("before_one_shell")
TOLD = json.loads((FOLDER / "numbers.json").read_text(encoding="utf-8"))
ON_LATTICES = 0.06  # by so much filters of 80 particles are wrong, those of today and of then
IN_THE_FILE = "t", "x_prior", "P_prior", "log_evidence", "log_likelihood", "n"


def same(found, told, rtol=1e-12):
    """Compare numbers by name, of which those that a file holds have to be the same bits."""
    assert found.keys() == told.keys()
    for name in told if rtol != ON_LATTICES else told.keys() - {"n"}:
        exact = rtol == 1e-12 and name in IN_THE_FILE
        room = {"rtol": 0.0} if exact else {"rtol": rtol, "atol": rtol}
        np.testing.assert_allclose(found[name], told[name], **room, err_msg=name)


def holds(new, old):
    """Does an npz file hold all that an older one does? What sums to one is made to when it is read."""
    with np.load(old) as before, np.load(new) as now:
        for name in sorted(set(before.files) - {"sphfilter"}):
            if name.endswith("about"):
                about, today = (json.loads(str(file[name])) for file in (before, now))
                if about.get("needs") is not None:  # older ones have no age
                    today["needs"] = today["needs"][: len(about["needs"])]
                assert about == {key: today[key] for key in about}
            elif name == "config":
                assert sf.FilterConfig.from_toml(str(now[name])) == sf.FilterConfig.from_toml(
                    str(before[name])
                )
            elif name.endswith(("mass", "log_w")):
                np.testing.assert_allclose(now[name], before[name], rtol=1e-15, err_msg=name)
            else:
                np.testing.assert_array_equal(now[name], before[name], err_msg=name)


@pytest.mark.parametrize("name", FILTERS)
def test_a_filter(tmp_path, name):
    path, (model, options, steps) = FOLDER / f"filter_{name}.npz", FILTERS[name]
    flt = sf.SPHFilter.load(path, model, POSITION)
    assert flt.config == options.get("config", sf.FilterConfig())
    same(numbers_of(flt), TOLD[name]["read"])
    flt.save(tmp_path / "again.npz")
    holds(tmp_path / "again.npz", path)
    room = 1e-9 if name == "paper" else ON_LATTICES
    for found, told in zip(go_on(flt, range(int(steps), len(READINGS))), TOLD[name]["gone on"], strict=True):
        same(found, told, room)


def test_a_filter_whose_scheme_was_taken_out(caplog):
    """Moment-corrected SPH: its particles are points of a cloud, and the default goes on."""
    told = TOLD["corrected"]["read"]
    flt = sf.SPHFilter.load(FOLDER / "filter_corrected.npz", DUFFING, POSITION)
    assert flt.config.scheme == "auto" and "'corrected'" in caplog.text and '"auto"' in caplog.text
    np.testing.assert_allclose(flt.density.mean(), told["mean"], atol=1e-12)
    np.testing.assert_allclose(flt.log_evidence, told["log_evidence"])
    for found, fine in zip(go_on(flt, [2, 3]), TOLD["auto"]["gone on"], strict=True):
        np.testing.assert_allclose(found["x"], fine["x"], atol=ON_LATTICES)


def test_a_filter_of_modes(tmp_path):
    """Written before both filters had one way to do so: it may have to repeat the prediction before it."""
    path = MODES / "modes.npz"
    drifts = {"rest": 0.0, "moving": 1.0}
    modes = {name: sf.LinearSDE([[0.0]], [v], noise=[[0.2]], B=[[1.0]]) for name, v in drifts.items()}
    model = sf.JumpMarkovModel(modes, [[-0.1, 0.1], [0.2, -0.2]])
    flt = sf.JumpMarkovFilter.load(path, model, sf.GaussianMeasurement([[1.0]], [[0.04]]))
    assert flt.config == sf.FilterConfig(target_error=0.02)
    flt.save(tmp_path / "again.npz")
    holds(tmp_path / "again.npz", path)
    said = []
    for told in json.loads((MODES / "numbers.json").read_text(encoding="utf-8")):
        exact = {name: told.pop(name) for name in ("inputs", "n_particles", "dt", "t")}
        assert exact == {name: getattr(flt, name) for name in exact}
        # what was in the file is there; what comes of it, with other times of jumps, is as good as was asked
        within = {"rtol": 0.02, "atol": 0.02} if said else {"rtol": 1e-9}
        for name, numbers in told.items():
            np.testing.assert_allclose(getattr(flt, name), numbers, **within, err_msg=name)
        said.append(flt.update(3.0))
        flt.predict()
    assert sf.Code.REPEATED in said[0].code


def test_a_trajectory():
    path, told = sf.Trajectory.load(FOLDER / "trajectory.npz"), TOLD["trajectory"]
    for density, numbers in zip(path.densities, told["densities"], strict=True):
        same(answers(density), numbers)
    assert [[info.scheme, info.n_steps, info.status] for info in path.infos] == told["infos"]
    on = sf.propagate(path.densities[-1], DUFFING, [1.5])
    same(answers(on.densities[0]), told["gone on"], ON_LATTICES)


def test_a_result_and_a_campaign_in_one_file():
    result = sf.FilterResult.load(FOLDER / "result.npz")
    walk = sf.CampaignResult.load(FOLDER / "campaign.npz").results["sph"]
    for found, told in ((result, TOLD["result"]), (walk, TOLD["campaign"])):
        np.testing.assert_array_equal(found.x, told["x"])
        np.testing.assert_array_equal(found.log_evidence, told["log_evidence"])


def test_settings():
    text = (FOLDER / "config.toml").read_text(encoding="utf-8")
    assert sf.FilterConfig.from_toml(text) == sf.FilterConfig(**CONFIG | {"scheme": "auto"})
    before, now = read_settings(FOLDER / "command" / "scenario.toml"), read_settings("duffing", CHANGES)
    assert before.filters.default == (*now.filters.default, "sph_paper")  # which runs by default no longer
    assert replace(before, filters=replace(before.filters, default=now.filters.default)) == now


def test_stone_soup():
    pytest.importorskip("stonesoup")
    from stonesoup.serialise import YAML

    from sphfilter.adapters.stonesoup import extend

    yaml = YAML()
    extend(yaml)
    predictor, updater, track = yaml.load((FOLDER / "stonesoup.yaml").read_text(encoding="utf-8"))
    same(answers(track.state.density), TOLD["stonesoup"]["read"])
    on = tracked(predictor, updater, track.state, [3, 4])
    same(answers(on.density), TOLD["stonesoup"]["gone on"], ON_LATTICES)


def within(old, new):
    """Does a tree of settings hold all that an older one does? It has some more by now."""
    if isinstance(old, dict):
        return all(key in new and within(value, new[key]) for key, value in old.items())
    return old == new


def copied(name, tmp_path, **entries):
    """A copy of a campaign's folder with versions of today, or other entries of its manifest."""
    folder = shutil.copytree(FOLDER / name, tmp_path / name)
    (path,) = folder.rglob("manifest.json")
    manifest = json.loads(path.read_text(encoding="utf-8")) | {"versions": store.versions()} | entries
    path.write_text(json.dumps(manifest), encoding="utf-8")
    return folder


def test_a_campaign_goes_on_from_its_folder(tmp_path):
    seen = []
    found = campaign(copied("campaign", tmp_path), 3, progress=lambda *counts: seen.append(counts))
    assert seen == [(2, 3), (3, 3)] and not found.failures
    np.testing.assert_array_equal(found.results["sph"].x[:2], TOLD["campaign"]["x"])


def test_a_campaign_goes_on_where_filterpy_is_no_more_or_not_yet(tmp_path):
    """It came with the library before; campaigns of other filters do not ask for it."""
    versions = store.versions() | {"filterpy": "1.4.5"}
    without = {name: version for name, version in versions.items() if name != "filterpy"}
    wanted = json.loads((FOLDER / "campaign" / "manifest.json").read_text(encoding="utf-8"))
    for k, (was, now) in enumerate([(versions, without), (without, versions)]):
        store.claim(copied("campaign", tmp_path / str(k), versions=was), wanted | {"versions": now})
    other = wanted | {"versions": versions | {"numpy": "0.1"}}
    with pytest.raises(sf.ConfigError, match=r"versions is .*, now it is .*numpy 0\.1"):
        store.claim(copied("campaign", tmp_path / "other", versions=without), other)


def test_a_command_goes_on_from_its_folder(tmp_path, monkeypatch):
    """The digest of run 0 is not asked for: compiled code draws it, whose last bits are the machine's."""
    first = json.loads((FOLDER / "command" / "runs" / "manifest.json").read_text())["digest of run 0"]
    monkeypatch.setattr(store, "case_digest", lambda case: first)
    out = copied("command", tmp_path)
    written = {path: path.read_bytes() for path in (out / "runs").glob("run_*.npz")}
    assert len(written) == 2 and main([*COMMAND, "--out", str(out)]) == 0
    assert {path: path.read_bytes() for path in (out / "runs").glob("run_*.npz")} == written
    said, told = (json.loads((folder / "report.json").read_text()) for folder in (out, FOLDER / "command"))
    told["settings"]["filters"]["default"].remove("sph_paper")  # which runs by default no longer
    assert within(told["settings"], said["settings"])
    for name, numbers in told["report"]["filters"].items():
        judged = said["report"]["filters"][name]
        for key in ("rms_error", "max_peak_error", "nees", "log_evidence", "run_time"):
            np.testing.assert_allclose(judged[key], numbers[key], rtol=1e-9)


def test_a_sum_of_families_goes_on_as_points():
    """Such a density was taken out: points have its mean, covariance and shape, and the error told of it."""
    w, mu, cov = np.array([0.8, 0.2]), np.array([[0.0, 0.0, 0.5], [2.0, -1.0, 0.5]]), np.diag([0.5, 0.4, 0.3])
    families = [gaussian_family(middle, cov, 5) for middle in mu]
    mean, whole = moments_of_sum(w, mu, np.array([cov, cov]))
    arrays = stored(replace(sf.initialize(sf.Gaussian(mean, whole), "auto"), error=0.04))
    about = json.loads(str(arrays["about"])) | {"read_out": "pieces", "gaussian": False}
    arrays = {name: arrays[name] for name in ("x", "mass", "h", "moments.mean", "moments.cov")}
    arrays |= {"about": np.array(json.dumps(about)), "families.log_w": np.log(w)}
    arrays |= {
        f"families.{name}": np.array([getattr(one, name) for one in families]) for name in Family._fields
    }
    density = density_from(arrays)
    assert density.read_out == "cloud" and density.needs == Memory(*about["needs"])
    np.testing.assert_allclose(density.mean(), mean, atol=1e-12)
    np.testing.assert_allclose(density.cov(), whole, atol=1e-12)
    skewed = w @ ((mu - mean)[:, 0] ** 3 + 3.0 * (mu - mean)[:, 0] * cov[0, 0])
    assert density.moment([3, 0, 0], central=True) == pytest.approx(skewed, abs=0.02)
    model = sf.SDE.from_expressions(["x", "y", "a"], ["cos(a)", "sin(a)", "0"], [["0.3"], ["0.3"], ["0.3"]])
    moved, info = sf.predict(density, model, 0.5, n_particles="auto")
    assert moved.t == 0.5 and info.rung == "cloud" and 0.04 < info.error < 0.06
    assert density_from(stored(moved), (model,)).read_out == "cloud"


def test_a_defect_of_fewer_polynomials():
    model = sf.SDE.from_expressions(["x", "v"], ["v", "-x - 0.3*x**3"], [["0"], ["1"]])
    flt = sf.SPHFilter(model, None, [0.3, 0.0], np.eye(2))
    flt.predict(0.2)
    arrays, defect = stored(flt.density), flt.density.defect
    arrays["defect"] = np.delete(arrays["defect"], range(21, 28))  # those of degree six
    old = density_from(arrays).defect
    np.testing.assert_array_equal(old.e, np.append(defect.e[:21], np.zeros(7)))
    np.testing.assert_array_equal(old.packed[28:], defect.packed[28:])


def test_needs_of_seven_numbers():
    density = sf.initialize(sf.Gaussian(np.zeros(2), np.eye(2)), 80)
    arrays = stored(replace(density, needs=Memory(4, 1, 2, 90, 1024, 3, 5, True)))
    about = json.loads(str(arrays["about"]))
    assert density_from(arrays).needs == Memory(*about["needs"])
    about["needs"] = [4, 1, 2, 90, 1024, None, 0.25]  # clouds kept whether noise parts copies
    arrays["about"] = np.array(json.dumps(about))
    needs = density_from(arrays).needs
    assert needs == Memory(4, 1, 2, 90, 1024)
    assert needs.told(1e-3, 1e-2, 1024, 1).calm == 1


def test_a_cloud_that_a_reading_began_without_a_size():
    sensor = sf.GaussianMeasurement.from_expressions(["x"], ["abs(x)"], [[0.01]])
    model = sf.SDE.from_expressions(["x"], ["-x**3"], [["0.5"]])
    config = sf.FilterConfig(scheme=sf.CloudScheme(n_points=256))
    flt = sf.SPHFilter(model, sensor, [0.3], [[1.0]], config=config)
    flt.update([0.8])
    arrays = stored(flt.density)
    arrays["cloud.size"] = np.array(0)
    old = density_from(arrays, (model,))
    moved, info = sf.predict(old, model, 0.5, sf.SolverConfig(scheme="cloud"))
    assert old.cloud.size == old.n_particles
    assert moved.t == 0.5 and 0.0 < info.error < 0.5
