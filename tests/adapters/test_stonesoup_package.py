"""The adapter as a package: optional, and documented by an example that runs."""

import doctest
import subprocess
import sys

import pytest

pytest.importorskip("stonesoup")


@pytest.mark.parametrize(
    "code",
    [
        "import sys, sphfilter; assert not any(m.split('.')[0] == 'stonesoup' for m in sys.modules)",
        "import sys; sys.modules['stonesoup'] = None\n"
        "try: import sphfilter.adapters.stonesoup\n"
        "except ImportError as error: assert 'sphfilter[stonesoup]' in str(error)\n"
        "else: raise AssertionError",
    ],
)
def test_stone_soup_is_optional(code):
    assert subprocess.run([sys.executable, "-c", code], timeout=60).returncode == 0


def test_the_page_for_users_is_right():
    import sphfilter.adapters.stonesoup as page

    assert doctest.testmod(page) == doctest.TestResults(failed=0, attempted=27)
