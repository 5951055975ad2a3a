"""A numpy callable that takes most of the time of a prediction is named, once, with what would help."""

import logging

import numpy as np
import pytest

import sphfilter as sf
from sphfilter.model import asking


def pendulum(X, t):
    return np.stack([X[:, 1], -np.sin(X[:, 0]) - 0.3 * X[:, 1]], axis=1)


@pytest.fixture
def said(caplog, monkeypatch):
    """What is said of predictions of any length, told of functions that take any part of them."""
    monkeypatch.setattr(asking, "PATIENCE", 0.0)
    monkeypatch.setattr(asking, "_MUCH", 0.0)
    caplog.set_level(logging.WARNING, logger="sphfilter")
    return lambda: [r.getMessage() for r in caplog.records if "vectorized" in r.getMessage()]


def predicted(model):
    return sf.predict(sf.initialize(sf.Gaussian([0.0, 0.0], np.eye(2)), "auto"), model, 0.2)


def test_it_is_said_once_a_function(said):
    model = sf.SDE(pendulum, dim=2, noise=[[0.0], [1.0]], vectorized=True)
    for again in (model, model, model.with_parameters()):
        predicted(again)
    (text,) = said()
    assert "calls of the vectorized function pendulum" in text and "from_expressions" in text


def test_compiled_models_are_not_named(said):
    predicted(sf.SDE.from_expressions(["x", "v"], ["v", "-sin(x) - 0.3*v"], [["0"], ["1"]]))
    assert not said()


def test_short_predictions_are_not(caplog, monkeypatch):
    monkeypatch.setattr(asking, "PATIENCE", np.inf)
    with caplog.at_level(logging.WARNING, logger="sphfilter"):
        predicted(sf.SDE(pendulum, dim=2, noise=[[0.0], [1.0]], vectorized=True))
    assert not [r for r in caplog.records if "vectorized" in r.getMessage()]
