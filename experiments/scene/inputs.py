"""Inputs of a scenario's model: numbers, texts and tables of t, held between measurements."""

import numpy as np

from sphfilter.errors import ModelError
from sphfilter.model.symbolic import Vocabulary, symbolic_rows


def sampled(model, inputs, begins):
    """What the model's m inputs are over T intervals that begin at some seconds (T,), shape (T, m).

    Inputs are numbers, texts of t and parameters, or tables; those that are not here are what the model says.
    None if there are none. Raises `ExpressionError` or `ModelError`.
    """
    if not inputs:
        return None
    own = {**model.inputs, **inputs}
    columns = [_values(model, f"inputs.{name}", own[name], begins) for name in model.inputs]
    return np.column_stack(columns)


def _values(model, key, given, begins):
    if callable(given):
        return given(begins)
    if not isinstance(given, str):
        return np.full(len(begins), given)
    names = Vocabulary([*model.parameters]).with_states(model.states)
    fill = symbolic_rows(model.states, (given,), (key,), names)
    states = names.used.intersection(model.states)
    if states:
        raise ModelError(
            f"{key} {given!r} names {min(states)!r}: an input is a function of t, not of the states"
        )
    p, found = np.array([*model.parameters.values()], dtype=float), np.empty((len(begins), 1))
    for t, row in zip(begins, found[:, None], strict=True):
        fill(np.zeros((1, model.dim)), float(t), p, row)
    if not np.isfinite(found).all():
        at = begins[~np.isfinite(found[:, 0])][0]
        raise ModelError(f"{key} {given!r} is not finite at t = {at:g}")
    return found[:, 0]
