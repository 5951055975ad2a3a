"""Posteriors too coarse for the prediction that follows; ``n_particles="auto"`` where more do not help."""

from types import SimpleNamespace

import pytest

import sphfilter as sf
from experiments.scene.scenario import load_scenario
from sphfilter import consistency
from sphfilter.campaign.campaign import draw_case
from sphfilter.errors import PropagationError, UnresolvedError
from sphfilter.filter import sph_filter
from sphfilter.info import PredictInfo
from sphfilter.prediction.again import carried_to_target

SQUARE = load_scenario("duffing_square")
CASE = draw_case(SQUARE, 1, 1)


def filtered(n_particles, count):
    """A filter of the oscillator seen through its square, after some updates."""
    flt = sf.SPHFilter(
        SQUARE.model, SQUARE.measurement, CASE.x0, CASE.P0, t0=CASE.t0, n_particles=n_particles
    )
    flt.run(CASE.times[:count], CASE.z[:count])
    return flt


def refused(monkeypatch, coarse):
    """Refuse to predict a density; returns how many particles those that are predicted have, as they come."""
    predict, sizes = sf.predict, []

    def picky(density, *args, **options):
        sizes.append(density.n_particles)
        if density is coarse:
            raise UnresolvedError("too coarse")
        return predict(density, *args, **options)

    monkeypatch.setattr(sph_filter, "predict", picky)
    return sizes


def test_the_update_before_is_repeated_on_more_particles(monkeypatch):
    coarse, fine, t = filtered(100, 3), filtered(800, 3), CASE.times[3]
    refused(monkeypatch, coarse.density)
    info = coarse.predict(t=t)
    fine.predict(t=t)
    assert info.status.startswith("the update before repeated on")
    assert consistency.distance(coarse.x, fine.x, fine.P) < 0.1


def test_the_prediction_before_is_repeated_on_more_particles(monkeypatch):
    """A chain of forecasts: the second prediction finds what the first left too coarse."""
    model = sf.SDE.from_expressions(["x"], ["x - x**3"], noise=[[1.0]], spectral_density=[[0.5]])
    flt = sf.SPHFilter(model, None, [0.1], [[0.2]], n_particles=50)
    flt.predict(0.5)
    sizes = refused(monkeypatch, flt.density)
    info = flt.predict(0.5)
    assert info.status == "the prediction before repeated on 3 times the particles"
    assert sizes[0] <= 50 < sizes[1] <= 150 and flt.t == 1.0


def test_a_density_that_comes_from_no_update_is_refused_and_left_alone(monkeypatch):
    flt = filtered(100, 0)
    before = flt.density

    def refuse(*args, **options):
        raise UnresolvedError("too coarse")

    monkeypatch.setattr(sph_filter, "predict", refuse)
    with pytest.raises(UnresolvedError, match="too coarse"):
        flt.predict(1.0)
    assert flt.density is before


class Predictions:
    """Stands for predictions: each call loses what a list says, or fails where it says None."""

    def __init__(self, *lost):
        self.lost, self.sizes = list(lost), []

    def __call__(self, n_particles):
        lost = self.lost[len(self.sizes)]
        self.sizes.append(n_particles)
        if lost is None:
            raise PropagationError("no")
        moved = SimpleNamespace(number=len(self.sizes), form=SimpleNamespace(cell=1.0))
        return moved, PredictInfo(scheme="log_density", mass_error=lost, error=4.0 * lost)


@pytest.mark.parametrize(
    ("lost", "called", "kept"),
    [
        ((1e-4,), 1, 1),  # good enough
        ((0.01, 0.0097), 2, 1),  # more particles did not help: the first answer stands
        ((0.01, None), 2, 1),  # nor where they fail
        ((0.01, 0.004, 0.001), 3, 3),
    ],
)
def test_auto_stops_where_more_particles_do_not_help(lost, called, kept):
    predictions = Predictions(*lost)
    density = SimpleNamespace(dim=2, error=0.0)
    moved, info, bound = carried_to_target(density, predictions, 0.01, 200)
    assert len(predictions.sizes) == called
    assert predictions.sizes == sorted(set(predictions.sizes))
    assert (moved.number, info.mass_error) == (kept, lost[kept - 1])
    assert bound <= predictions.sizes[kept - 1]


def test_auto_refuses_what_the_first_prediction_refuses():
    with pytest.raises(PropagationError):
        carried_to_target(SimpleNamespace(dim=2, error=0.0), Predictions(None), 0.01, 200)
