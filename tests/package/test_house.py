"""The house stays within its bounds, and the count sees what breaks them."""

import house
import pytest

SMALL = {
    "sphfilter/__init__.py": '"""A library."""\n',
    "sphfilter/room/__init__.py": "",
    "sphfilter/room/low.py": '''"""Numbers.

Of which two have reasons.
"""
import math

_BARE = 0.3  # of a standard deviation
_MEASURED = 0.5  # measured on six scenes
#: Root of the variance, sqrt(1/3).
_ROOT, _TWICE = 0.577, 1.155
_TURN = 2.0 * math.pi
_NAMES = "a", "b"
_SIZES = {1: 2**3, 2: -1.5}
''',
    "sphfilter/room/middle.py": "from . import high\n\n\ndef middle(density):\n    return high\n",
    "sphfilter/room/high.py": '''from .low import _TURN
from sphfilter.room.middle import middle


class Shell:
    def take(self, a, b, c, d, e, f, g, /, h, *i, j=1, **k):
        """Nothing."""
        # nor this

        return a


def ask(density, info):
    kept = density.field
    if density.field is None and density.field.size:
        return density.cloud()
    while (
        kept
        and info.scheme == "cloud"
    ):
        kept = None
    return [one for one in density if not one.family], density.cloud if density.pieces else None
''',
    "sphfilter/top.py": "import sphfilter.room.high\n\n\ndef long():\n" + "    print()\n" * 41,
    "tests/test_it.py": "# a test\n\nassert True\n",
}


@pytest.fixture
def small(tmp_path):
    for name, text in SMALL.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return tmp_path


@pytest.mark.slow  # CI runs the command itself
def test_the_house_is_within_its_bounds(capsys):
    passed = house.main(["--limit"])
    told = capsys.readouterr().out
    assert passed == 0, told
    lines = told.splitlines()
    assert max(map(len, lines)) < 80
    assert all(any(line.startswith(name) for line in lines) for name in house.BOUNDS)


def test_counts_of_a_small_house(small):
    rows = {row.name: row for row in house.count(small)}
    found = {name: row.count for name, row in rows.items()}
    assert found["lines of tests"] == 3 and found["lines of experiments"] == 0
    assert found["functions of the library"] == 4
    assert rows["  longer than 40 lines"].places == ["sphfilter/top.py:4 long: 41 lines"]
    assert rows["  with more than 8 arguments"].places == ["sphfilter/room/high.py:6 take: 11"]
    assert found["module-level numbers"] == 6
    bare = ["sphfilter/room/low.py:7 _BARE", "sphfilter/room/low.py:13 _SIZES"]
    assert rows["  without derivation or measurement"].places == bare
    lines = [
        int(place.split(":")[1].split()[0]) for place in rows["places that ask which representation"].places
    ]
    assert lines == [15, 19, 22]
    assert rows["  files with such places"].places == ["sphfilter/room/high.py: 3"]
    assert rows["  modules in circles"].places == ["sphfilter.room.high", "sphfilter.room.middle"]
    assert rows["  of the highest room"].places == ["room: 2"]
    assert found["floors of imports"] == 3


@pytest.mark.parametrize("name", house.BOUNDS)
def test_any_bound_can_be_passed(small, name, capsys):
    count = next(row.count for row in house.count(small) if row.name == name)
    assert house.main(["--limit"], small, {name: count}) == 0
    assert house.main(["--limit"], small, {name: count - 1}) == 1
    assert house.main([], small, {name: count - 1}) == 0
    assert f"{name.strip()}: {count:,}, and {count - 1:,} are allowed" in capsys.readouterr().out


def test_places_are_listed(small, capsys):
    house.main(["--where", "arguments"], small)
    assert "sphfilter/room/high.py:6 take: 11" in capsys.readouterr().out
