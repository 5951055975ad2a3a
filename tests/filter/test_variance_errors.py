"""Errors of variances that filters tell, against a grid's variances."""

from dataclasses import replace

import numpy as np
import pytest

import sphfilter as sf
from experiments.scene.scenario import load_scenario
from experiments.stress.random_cases import RandomCase
from experiments.stress.records import default_filter
from reference_filters.grid import GridFilter
from sphfilter.campaign.campaign import draw_case


@pytest.mark.parametrize("scene", ["duffing", "fitzhugh_nagumo"])
def test_variances_are_off_by_as_much_as_is_told(scene):
    scenario, config = load_scenario(scene), sf.FilterConfig(target_error=0.03)
    about = scenario.model, scenario.measurement
    ratios = []
    for number in range(3):
        case = draw_case(scenario, 1, number)
        flt = sf.SPHFilter(*about, case.x0, case.P0, t0=case.t0, config=config)
        grid = GridFilter(*about, case.x0, case.P0, t0=case.t0, size=96)
        for t, z in zip(case.times[:8], case.z[:8], strict=True):
            for each in (flt, grid):
                each.predict(t=t)
            info = flt.update(z)
            grid.update(z)
            made = np.abs(np.diag(flt.P) / np.diag(grid.P) - 1.0).max()
            ratios.append(info.variance_error / made)
    assert 0.5 < np.median(ratios) < 2.5
    assert np.mean(np.array(ratios) < 1.0 / 3.0) < 0.15


def test_a_variance_of_which_nothing_more_is_known_is_off_by_a_root_of_two_times_the_mean():
    start = sf.initialize(sf.Gaussian([0.0], [[1.0]]), n_particles="auto").noted(error=0.01)
    model, sensor = sf.LinearSDE([[-1.0]], noise=[[1.0]]), sf.GaussianMeasurement([[1.0]], [[0.5]])
    prior, predicted = sf.predict(start, model, 0.5)
    _, updated = sf.update(prior, sensor, [0.3])
    for info in (predicted, updated):
        assert 0.0 < info.error <= 0.01
        assert info.variance_error == pytest.approx(np.sqrt(2.0) * info.error)


def test_a_variance_that_heavy_tails_carry_is_right_or_flagged():
    """Few lineages carry the second reading's: four clouds of 250,000 particles say .0604 ± 3 %."""
    problem = replace(RandomCase(80513, 49).problem(), n_particles="auto")
    flt, flagged, before = default_filter(problem), False, problem.t0
    for k, t in enumerate(problem.times[:2]):
        for part in np.linspace(before, t, 9)[1:]:
            flt.predict(t=part)
        infos = [flt.update(z[k], sensor) for z, sensor in zip(problem.z, problem.sensors, strict=True)]
        flagged, before = flagged or any(info.flagged for info in infos), t
    assert flagged or flt.P[3, 3] == pytest.approx(0.0604, rel=0.2)
