"""Filters are compiled ahead, about half of them in a second process where it pays."""

import pytest

from experiments.scene.filters import factories
from experiments.scene.scenario import load_scenario
from experiments.terminal import running


def halves(name, wanted, **changes):
    scenario = load_scenario(name, **changes)
    here, beside = running._halves(scenario, factories(wanted, scenario))
    schemes = [half["sph"].settings.config.scheme for half in (here, beside) if "sph" in half]
    return set(here), set(beside), [getattr(scheme, "name", scheme) for scheme in schemes]


@pytest.mark.parametrize(
    ("name", "wanted", "here", "beside", "schemes"),
    [
        ("duffing", "ekf,pf,sph", {"ekf", "pf", "sph"}, {"sph"}, ["family", "log_density"]),
        ("duffing", "sph,sph_paper", {"sph"}, {"sph", "sph_paper"}, ["family", "log_density"]),
        ("linear_critical", "kf,sph", {"sph"}, {"kf"}, ["auto"]),
        ("coordinated_turn", "ekf,sph", {"sph"}, {"ekf"}, ["auto"]),
        ("duffing", "ekf,sph_paper", {"ekf"}, {"sph_paper"}, []),
    ],
)
def test_lattices_are_compiled_beside_where_they_are_come_to(name, wanted, here, beside, schemes):
    assert halves(name, wanted.split(",")) == (here, beside, schemes)


def test_a_scheme_that_was_asked_for_is_compiled_as_it_is():
    changes = {"filters.sph.config.scheme": "log_density"}
    assert halves("duffing", ["ekf", "sph"], **changes) == ({"sph"}, {"ekf"}, ["log_density"])


def test_every_filter_takes_a_measurement_and_what_it_raises_is_said(capsys, monkeypatch):
    taken = []
    monkeypatch.setattr(running, "take_one", lambda make, case: taken.append(make) or _problem(make))
    scenario = load_scenario("duffing")
    filters = factories(["ekf", "sph"], scenario)
    running.warm_up(running.new_console(), scenario, filters)
    assert taken[-1] is filters["sph"]
    assert [make for make in taken if make.name == "ekf"] == [filters["ekf"]]
    assert len(taken) == 3
    assert capsys.readouterr().out.count("no luck") == 1


def _problem(make):
    return ValueError("no luck") if make.name == "ekf" else None
