"""`python -m experiments skips`: every shortcut agrees with the long way, and the tables are written."""

import csv

import numpy as np
import pytest

from experiments.__main__ import main
from experiments.skips.cases import cases
from experiments.skips.command import Measured, lattice_against_box, measured


def small(case):
    return "2000" not in case.scene


@pytest.mark.parametrize("case", [c for c in cases() if small(c)], ids=lambda c: f"{c.name}, {c.scene}")
def test_a_shortcut_agrees_with_the_long_way(case):
    """To rounding where the same sums are taken, to the scheme's own error where other steps are."""
    (mean, cov), (exact_mean, exact_cov) = case.on(), case.off()
    scale = np.sqrt(np.diag(exact_cov))
    same = 1e-3 if "rank" in case.name or case.name == "exact_linear" else 1e-5
    assert np.abs((mean - exact_mean) / scale).max() < same
    assert np.abs((cov - exact_cov) / np.outer(scale, scale)).max() < same


def test_the_difference_is_in_standard_deviations():
    class Case:
        name, scene = "none", "none"

        @staticmethod
        def on():
            return np.array([0.2, 0.0]), np.diag([4.0, 1e-4])

        @staticmethod
        def off():
            return np.array([0.0, 0.0]), np.diag([4.0, 2e-4])

    row = measured(Case, 5)
    assert row.difference == pytest.approx(0.5)
    assert row.on > 0
    assert Measured("a", "b", on=1.0, off=3.0, difference=0.0).ratio == 3.0


@pytest.mark.parametrize(("n", "N"), [(1, 100), (2, 200), (3, 400)])
def test_a_lattice_is_smaller_than_its_box(n, N):
    kept, whitened, own = lattice_against_box(n, N)
    ball = {1: 1.0, 2: np.pi / 4, 3: np.pi / 6}[n]
    assert kept / whitened == pytest.approx(ball, rel=0.15)
    assert own >= whitened


def test_command(tmp_path, capsys):
    assert main(["skips", "--samples", "5", "--only", "no measurement", "--out", str(tmp_path)]) == 0
    assert "flat likelihood" in capsys.readouterr().out
    skips, particles = ((tmp_path / f"{n}.csv").read_text().splitlines() for n in ("skips", "particles"))
    rows = list(csv.DictReader(skips))
    assert [row["shortcut"] for row in rows] == ["no measurement"]
    assert float(rows[0]["ratio"]) > 1.0
    assert len(particles) == 5
    assert (tmp_path / "skips.md").read_text(encoding="utf-8").startswith("| shortcut |")


@pytest.mark.parametrize("options", [["--samples", "1"], ["--only", "nothing of the kind"]])
def test_wrong_options_get_a_sentence(options, tmp_path, capsys):
    assert main(["skips", *options, "--out", str(tmp_path)]) == 1
    assert "error:" in capsys.readouterr().err
