"""Tests have the marks of their folders."""

from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]


@pytest.fixture
def conftest(request):
    return request.config.pluginmanager.get_plugin(str(TESTS / "conftest.py"))


def test_every_folder_has_its_marks_and_what_is_quick_is_there(conftest):
    folders = {path.parent.relative_to(TESTS).parts[0] for path in TESTS.rglob("test_*.py")}
    assert conftest.MARKS.keys() == folders
    assert all((TESTS / name).is_file() for name in conftest.QUICK)
    assert not any("compiles" in conftest.MARKS[Path(name).parts[0]] for name in conftest.QUICK)


def test_what_is_long_is_there(conftest):
    for name in conftest.LONG:
        place, _, test = name.partition("::")
        assert f"def {test.partition('[')[0]}(" in (TESTS / place).read_text(encoding="utf-8"), name


def test_this_one_is_quick(request):
    assert request.node.get_closest_marker("quick") and not request.node.get_closest_marker("slow")


@pytest.mark.slow
def test_what_is_slow_is_not_quick(request):
    assert not request.node.get_closest_marker("quick")


@pytest.mark.parametrize(
    "place, marks",
    [
        ("tests/adapters/test_stonesoup_filter.py", ["compiles", "stonesoup"]),
        ("tests/core/test_field.py", ["quick"]),
        ("tests/package/test_markers.py", ["quick"]),
        ("tests/package/test_recipes.py", []),
        ("notebooks/lorenz.ipynb", ["compiles"]),
    ],
)
@pytest.mark.parametrize("slow", [False, True])
def test_marks_follow_from_the_place(conftest, place, marks, slow):
    item = SimpleItem(TESTS.parent / place, slow)
    assert conftest.marks_of(item) == [mark for mark in marks if not (slow and mark == "quick")]


class SimpleItem:
    """What a test tells of itself."""

    def __init__(self, path, slow):
        self.path, self.slow = path, slow

    def get_closest_marker(self, name):
        return self.slow and name == "slow"
