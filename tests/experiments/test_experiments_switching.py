"""The command for targets that switch between modes."""

import pytest

from experiments.commands import main

SMALL = """
description = "small"
interval = 1.0
epochs = 3
x0 = [0.0]
P0 = [[0.1]]
begins = "rest"
rates = [[-0.2, 0.2], [0.2, -0.2]]
model = { states = ["x"], noise = [["0.2"]] }
modes = { rest = { drift = ["0"] }, moving = { drift = ["1"] } }
sensor = { h = [[1.0]], noise_cov = [[0.04]] }
"""


def rows(text):
    cells = [line.split() for line in text.splitlines()]
    return {row[0]: row[1:] for row in cells if row[:1] in (["sph"], ["imm"], ["referee"])}


@pytest.mark.parametrize(
    "referee", ["beyond = 3.0\nsize = 128\nstep = 0.0625", "n_particles = 20000"], ids=["grid", "particles"]
)
def test_filters_are_held_against_a_referee(tmp_path, capsys, referee):
    path = tmp_path / "small.toml"
    path.write_text(f"{SMALL}\n[referee]\n{referee}\n")
    assert main(["switching", str(path), "--runs", "1", "--seed", "2"]) == 0
    found = rows(capsys.readouterr().out)
    assert set(found) == {"sph", "imm", "referee"}
    assert float(found["sph"][1]) < 0.02
    assert all(row[-1] == "ms" for row in found.values())


def test_what_is_not_known_is_said(tmp_path, capsys):
    assert main(["switching", "cours"]) == 1
    assert "did you mean 'course'?" in capsys.readouterr().err
    path = tmp_path / "small.toml"
    path.write_text(f"{SMALL.replace('rest', 'sleep', 1)}\n[referee]\nn_particles = 100\n")
    assert main(["switching", str(path)]) == 1
    assert "begins must be one of the modes" in capsys.readouterr().err
