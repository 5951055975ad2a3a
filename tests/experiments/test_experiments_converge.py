"""The command that shows the order of convergence against an exact filter."""

import numpy as np
import pytest
from csv_rows import csv_rows

from experiments.__main__ import main
from experiments.converge.filters import orders
from experiments.show.comparison import Distance


def test_orders_are_slopes_in_the_spacing():
    rows = [(N, Distance(mean=N**-1.0, cov=N**-0.5, evidence=3.0), 0.1, 0) for N in (100, 200, 400)]
    found = orders(rows, dim=2)
    assert [found[m] for m in ("mean", "cov", "evidence")] == pytest.approx([2.0, 1.0, 0.0], abs=1e-9)


@pytest.mark.parametrize("which", ["sph", "sph_paper"])
def test_command_writes_table_and_picture(which, tmp_path, capsys):
    arguments = ["linear_underdamped", "--counts", "100,200", "--runs", "1", "--set", "times.end=2"]
    assert main(["converge", *arguments, "--filter", which, "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "order in dx" in said
    assert "100 particles: run 1 of 1 done" in said and "200 particles: run 1 of 1 done" in said
    rows = csv_rows(tmp_path / "convergence.csv")
    assert [row["particles"] for row in rows] == ["100", "200"]
    assert all(0 < float(row["cov"]) < 1 and np.isfinite(float(row["evidence"])) for row in rows)
    assert (tmp_path / "convergence.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["duffing"], "no exact filter"),
        (["--counts", "100"], "two different counts"),
        (["--counts", "a,b"], "takes numbers"),
        (["--counts", "2,4"], "too small"),
        (["linear_underdumped"], "linear_underdamped"),
        (["cubik", "--sensors"], "did you mean 'cubic'"),
        (["lorenz", "--over", "nodes"], "one or two states"),
    ],
)
def test_errors_are_sentences(arguments, message, tmp_path, capsys):
    assert main(["converge", *arguments, "--runs", "1", "--out", str(tmp_path)]) == 1
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "stem", "floor"),
    [
        (["angle", "--sensors"], "sensors", 1e-5),
        (["duffing", "--over", "nodes", "--set", "times.end=4"], "nodes", 1e-4),
    ],
)
def test_more_nodes_are_no_worse(arguments, stem, floor, tmp_path, capsys):
    assert main(["converge", *arguments, "--counts", "50,200", "--runs", "1", "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "above the floor: none" in said and max(map(len, said.splitlines())) <= 100
    rows = csv_rows(tmp_path / f"{stem}.csv")
    assert [row["particles"] for row in rows] == ["50", "200"] * (len(rows) // 2)
    assert all(row["refused"] == "0" and float(row["floor"]) == floor for row in rows)
    assert all(0 < float(row["mean"]) < 10.0 * float(row["told"]) + floor for row in rows)
    assert (tmp_path / f"{stem}.md").read_text(encoding="utf-8").startswith("|  | 50 | 200 | worst |")
