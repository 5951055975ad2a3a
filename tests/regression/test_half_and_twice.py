"""What is told of a number hangs on it, and is told of no other."""

import half_and_twice
import pytest


@pytest.mark.slow
def test_steps_of_simulated_paths_change_their_moments_by_chance():
    only, where = "simulate: noise 0.7", "model.paths._COURANT_ADDITIVE"
    before, same, longer = (
        half_and_twice.asked(only, *setting)[only] for setting in ((), (where, "0.05"), (where, "0.2"))
    )
    assert half_and_twice.off(same, before) == 0.0
    assert 0.0 < half_and_twice.off(longer, before) < 5.0
