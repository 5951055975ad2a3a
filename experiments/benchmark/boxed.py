"""The grid filter whose box is chosen by hand: a rival with hindsight, for one and two states."""

from dataclasses import dataclass

import numpy as np

from experiments.scene.scenario import Scenario
from reference_filters.boxed_grid import BoxedGridFilter, box_of_case
from sphfilter.campaign.store import case_digest
from sphfilter.settings import Count, Positive, settings

#: Boxes by case, made once: they are set-up, which does not count.
_BOXES = {}


@settings
class Boxed:
    """Boxed grid filter: nodes an axis, and longest time step in seconds."""

    size: Count
    step: Positive


@dataclass(frozen=True)
class BoxedFactory:
    """Make the filter for a case, in the box of that case."""

    scenario: Scenario
    settings: Boxed

    def __call__(self, case, rng):
        """Return the filter at the start of `case`."""
        model, measurement = self.scenario.model, self.scenario.measurement
        key = case_digest(case)
        if key not in _BOXES:
            _BOXES[key] = box_of_case(model, measurement, case)
        shape = {"box": _BOXES[key], "size": self.settings.size, "step": self.settings.step}
        return BoxedGridFilter(model, measurement, case.x0, case.P0, case.t0, **shape)


def fits(scenario):
    """Whether the boxed grid filter takes the scenario."""
    model = scenario.model
    if model.dim > 2 or not (model.autonomous and model.constant_diffusion):
        return False
    D = model.diffusion(np.zeros((1, model.dim)), 0.0)[0]
    return scenario.settings.start.kind != "benes" and np.array_equal(D, np.diag(np.diag(D)))
