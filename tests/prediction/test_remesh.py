"""New lattices on the way of a transient solution: when they come, what they keep, what they are worth."""

from dataclasses import replace

import numpy as np
import pytest

import sphfilter as sf
from sphfilter.errors import PropagationError
from sphfilter.prediction import remesh

DUFFING = sf.SDE.from_expressions(
    ["x", "v"], ["v", "-0.4*v + x - 0.1*x**3"], noise=[[0], [1]], spectral_density=[[0.8]]
)
SPIRAL = sf.LinearSDE([[0.0, 1.0], [-1.0, -0.2]], noise=[[0.0], [0.5]])
FAST = sf.Gaussian([0.0, 10.0], 0.25 * np.eye(2))
SUMS = {"paper": sf.PaperScheme(kernel="gaussian")}


def configuration(scheme, remesh):
    return sf.SolverConfig(scheme=SUMS.get(scheme, scheme), remesh=remesh)


def carried(scheme, remesh, times, n_particles=200, model=DUFFING, start=FAST):
    config = configuration(scheme, remesh)
    return sf.propagate(sf.initialize(start, n_particles, config), model, times, config)


def same(one, two):
    return all(np.array_equal(getattr(one, name), getattr(two, name)) for name in ("x", "mass", "h"))


@pytest.mark.parametrize("scheme", ["auto", *SUMS])
def test_never_is_prediction_after_prediction_to_the_last_bit(scheme):
    config = sf.SolverConfig(scheme=SUMS.get(scheme, scheme))
    assert config.remesh == "never"
    density = sf.initialize(FAST, 200, config)
    way = sf.propagate(density, DUFFING, [0.5, 2.0], config)
    for t, end, info in zip(way.times, way.densities, way.infos, strict=True):
        density, expected = sf.predict(density, DUFFING, t=t, config=config)
        assert same(density, end) and info == expected


def test_the_configuration_of_a_filter_never_asks_for_it():
    config = sf.FilterConfig(scheme=SUMS["paper"])
    start = sf.initialize(FAST, 150, config)
    way = sf.propagate(start, DUFFING, [0.5], config)
    assert same(way.densities[0], carried("paper", "never", [0.5], 150).densities[0])


def test_log_densities_are_on_a_new_lattice_at_every_step_anyway():
    ends = [carried("auto", remesh, [1.0, 3.0]) for remesh in ("never", "health", 0.5)]
    assert all(same(ends[0].densities[-1], way.densities[-1]) for way in ends)
    assert ends[1].infos == ends[2].infos == ends[0].infos


@pytest.mark.parametrize("scheme", SUMS)
@pytest.mark.parametrize("times", [[1.6], [0.3, 0.8, 1.1, 1.6]])
def test_a_clock_strikes_the_same_however_the_way_is_cut(scheme, times):
    way = carried(scheme, 0.4, times)
    assert sum(info.n_regrids for info in way.infos) == 3  # not at the start, nor at the end
    assert "re-gridded: every 0.4 s" in way.infos[-1].status
    assert all(density.mass.sum() == pytest.approx(1.0, abs=1e-14) for density in way.densities)


@pytest.mark.parametrize("remesh", ["health", 1.5])
def test_a_solution_from_a_file_goes_on_to_the_last_bit(remesh, tmp_path):
    config = configuration("paper", remesh)
    way = carried("paper", remesh, [6.0, 9.0])
    assert sum(info.n_regrids for info in way.infos) > 0
    way.save(tmp_path / "way.npz")
    again = sf.Trajectory.load(tmp_path / "way.npz")
    assert again.infos == way.infos
    (end,) = sf.propagate(again.densities[0], DUFFING, [9.0], config).densities
    assert same(end, way.densities[1])
    assert same(carried("paper", remesh, [6.0, 9.0]).densities[1], way.densities[1])


def test_a_linear_model_stays_in_order_and_is_left_alone():
    start = sf.Gaussian([2.0, 0.0], 0.3 * np.eye(2))
    ways = [carried("paper", remesh, [4.0], 150, SPIRAL, start) for remesh in ("never", "health")]
    assert ways[1].infos[0].n_regrids == 0
    assert ways[1].densities[0].cov() == pytest.approx(ways[0].densities[0].cov(), rel=1e-3)


def test_published_scheme_needs_fewer_steps_on_health():
    ways = [carried("paper", remesh, [10.0], 200) for remesh in ("never", "health")]
    assert ways[0].infos[0].n_regrids == 0 < ways[1].infos[0].n_regrids
    assert ways[1].infos[0].n_steps < 0.5 * ways[0].infos[0].n_steps


def test_where_no_lattice_can_be_had_the_particles_go_on(monkeypatch):
    def no_lattice(*args):
        raise PropagationError("too few particles")

    monkeypatch.setattr(remesh, "regrid", no_lattice)
    way, never = (carried("paper", remesh, [1.0, 2.0]) for remesh in (1.0, "never"))
    assert "no new lattice: too few particles" in way.infos[1].status and way.infos[1].n_regrids == 0
    assert same(way.densities[1], never.densities[1])


def test_a_lattice_that_is_no_better_is_not_taken(monkeypatch):
    """Where particles are too few for the density a new lattice is as rough as the old one."""
    before = carried("paper", "never", [2.0]).densities[0]
    rough = replace(before, mass=np.random.default_rng(1).permutation(before.mass))
    rule = remesh.Remeshing("health", SUMS["paper"], 200)
    after, told, changed = rule.renewed(rough, DUFFING, 3.0)
    assert changed and sf.health(after).severity < sf.health(rough).severity
    monkeypatch.setattr(remesh, "regrid", lambda density, *_: (density, None))
    after, told, changed = rule.renewed(rough, DUFFING, 3.0)
    assert after is rough and not changed and told.endswith("of so few particles is no better")


def test_particles_on_a_circle_are_renewed_across_its_seam():
    circle = sf.Domain(("periodic", -np.pi, np.pi))
    model = sf.SDE.from_expressions(["a"], ["0.7"], [[1.0]], spectral_density=[[0.5]], domain=circle)
    config = sf.SolverConfig(scheme=sf.PaperScheme(kernel="wendland_c2"), remesh=0.5)
    start = sf.initialize(sf.Gaussian([2.5], [[0.25]]), 80, config, domain=circle)
    way = sf.propagate(start, model, [2.0], config)
    end = way.densities[0]
    assert way.infos[0].n_regrids == 3 and circle.contains(end.x).all()
    assert end.mean()[0] == pytest.approx(2.5 + 1.4 - 2 * np.pi, abs=0.01)
    assert end.cov()[0, 0] == pytest.approx(1.25, rel=0.05)


@pytest.mark.parametrize("remesh", ["helth", "often", -1.0, 0.0, None])
def test_rules_that_are_none(remesh):
    with pytest.raises(sf.ConfigError, match=r"remesh: .* is none of never, health and seconds"):
        sf.SolverConfig(remesh=remesh)


def test_one_info_of_several():
    one = sf.PredictInfo(n_steps=2, n_regrids=1, mass_error=0.1, skipped=("a", "b"), scheme="x")
    two = sf.PredictInfo(n_steps=3, skipped=("b",), scheme="y", status="late")
    both = sf.PredictInfo.joined([one, two, two])
    assert (both.n_steps, both.n_regrids, both.mass_error) == (8, 1, 0.1)
    assert (both.skipped, both.scheme, both.status) == (("a", "b"), "x, y", "late")
    assert sf.PredictInfo.joined([one]) is one
