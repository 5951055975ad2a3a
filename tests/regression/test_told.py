"""The default filter counts and tells on ten small scenes what it did when `told.json` was written."""

import json
import math

import pytest
import told

BEFORE = json.loads(told.FILE.read_text(encoding="utf-8"))
SAID = "not as it was; if that is meant: python tests/regression/told.py --write, and say why"


@pytest.mark.parametrize("name", told.SCENES)
def test_counts_and_errors_are_as_they_were(name):
    changed = list(told.differences(BEFORE[name], told.told(name)))
    assert not changed, f"{SAID}: {changed}"


def test_the_file_is_of_these_scenes():
    assert list(BEFORE) == list(told.SCENES)
    assert told.FILE.read_text(encoding="utf-8") == told.as_text(BEFORE)
    assert {len(column) for columns in BEFORE.values() for column in columns.values()} == {told.READINGS}


def test_scenes_are_of_all_rungs():
    carried = {rung for columns in BEFORE.values() for both in columns["rung"] for rung in both.split(", ")}
    assert carried >= {"closed form", "family", "cloud", "lattice"}


@pytest.mark.parametrize("what", ["evaluations", "points", "error"])
@pytest.mark.parametrize("factor", [0.5, 2.0, math.nan])
def test_another_sum_is_seen(what, factor):
    one = BEFORE["duffing"]
    (said,) = told.differences(one, one | {what: [factor * value for value in one[what]]})
    assert said.startswith(what)
    assert not list(told.differences(one, one | {what: [1.01 * value for value in one[what]]}))


def test_another_representation_is_seen():
    one = BEFORE["duffing"]
    for others in range(told.READINGS):
        rungs = ["pieces"] * others + one["rung"][others:]
        assert len(list(told.differences(one, one | {"rung": rungs}))) == (others > told.OTHER_RUNGS)
