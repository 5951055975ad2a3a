"""Steps under a time budget, as a command."""

import numpy as np

from experiments.commands import main
from experiments.realtime import Outcome


def test_a_row_for_every_budget(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")  # or the table comes in pieces
    command = ["realtime", "linear_underdamped", "--budgets", "5,20", "--runs", "1", "--out", str(tmp_path)]
    assert main(command) == 0
    cells = [line.split() for line in capsys.readouterr().out.splitlines()]
    rows = [row for row in cells if row[:1] == ["linear_underdamped"] and "ms" in row]
    assert [row[1] for row in rows] == ["5", "20"]
    assert all(row[-3:] == ["0", "of", "1"] for row in rows)
    assert any((tmp_path / "references").iterdir())


def test_an_unknown_name_and_budgets_that_are_none(tmp_path, capsys):
    assert main(["realtime", "dufing", "--out", str(tmp_path)]) == 1
    assert "did you mean 'duffing'?" in capsys.readouterr().err
    assert main(["realtime", "duffing", "--budgets", "soon", "--out", str(tmp_path)]) == 1
    assert "--budgets" in capsys.readouterr().err


def test_the_share_within():
    outcome = Outcome(np.array([0.004, 0.005, 0.006, 0.02]), np.full(4, 100), 0.01, 0, [])
    assert outcome.within(0.005) == 0.5
    assert outcome.within(1.0) == 1.0
    assert np.isnan(Outcome(np.array([]), np.array([]), np.nan, 0, ["refused"]).within(1.0))
