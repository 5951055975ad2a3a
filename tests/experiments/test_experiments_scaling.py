"""`scaling`: what it measures, and what it says to bad options."""

import numpy as np
import pytest

from experiments.commands import main
from experiments.scaling import measured


def test_table_and_file(tmp_path, capsys):
    counts = ["--counts", "100,200", "--samples", "1", "--interval", "0.05"]
    assert main(["scaling", "--schemes", "log_density", *counts, "--out", str(tmp_path)]) == 0
    rows = np.genfromtxt(tmp_path / "scaling.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    assert rows["scheme"].tolist() == ["log_density"] * 2
    assert np.all(rows["n_particles"] <= [100, 200])
    assert np.all(rows["n_particles"] > [50, 100])
    for column in ("n_steps", "seconds", "threaded", "memory"):
        assert np.all(rows[column] > 0)
    assert "the cost of one and a step stays within a factor of" in " ".join(capsys.readouterr().out.split())


def test_time_grows_with_the_interval():
    short, long = (measured("van_der_pol", "paper", 100, interval, 1) for interval in (0.02, 0.4))
    assert long.n_steps > 4 * short.n_steps
    assert long.n_particles == short.n_particles


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--schemes", "log_density,papr"], "no scheme 'papr'; there are log_density, paper"),
        (["--counts", "many"], "--counts takes numbers such as 500,1000"),
        (["--interval", "0"], "--interval above 0"),
        (["epidemic"], "epidemic does not start from a Gaussian"),
        (["van_der_pole"], "did you mean 'van_der_pol'"),
    ],
)
def test_bad_options(options, sentence, capsys):
    assert main(["scaling", *options]) == 1
    assert sentence in capsys.readouterr().err
