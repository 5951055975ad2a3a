"""Sweeps: cells, rows, table, sentences, pictures, and the command on a small scene."""

import argparse
from dataclasses import replace

import numpy as np
import pytest
from csv_rows import csv_rows

from experiments.arguments.sweep import add_arguments
from experiments.scene.scenario import load_scenario, read_settings
from experiments.sweep import command as sweep
from experiments.sweep import plots, tables
from experiments.terminal.options import adder
from sphfilter.campaign.report import FilterReport, Report
from sphfilter.errors import ConfigError


def arguments(*words):
    parser = argparse.ArgumentParser()
    add_arguments(adder(parser))
    return parser.parse_args(words)


def filter_report(rms, n_diverged=0, n_failed=0):
    rms, nan = np.array(rms), np.nan
    unknown = {"innovations": None, "ranks": None, "nmee": rms, "nmee_p": rms}
    unknown |= {"nees_above": nan, "nees_below": nan, "exits": 0}
    return FilterReport(n_runs=10, n_failed=n_failed, max_peak_error=rms, mean_peak_error=rms, rms_error=rms,
                        rms_error_std=rms, run_time=1.0, nees=2.0, nees_inside=0.9, nees_inside_one_sided=0.9,
                        nmee_inside=rms, n_rejected=0, n_diverged=n_diverged, log_evidence=nan,
                        log_evidence_std=nan, **unknown)  # fmt: skip


def rows(with_pf=True):
    """An EKF that loses the runs of the longer interval."""
    made = []
    for interval in (1.0, 2.0):
        hard = interval == 2.0
        filters = {"ekf": filter_report([0.8, 2.0], 3, 1) if hard else filter_report([0.2, 0.5])}
        filters["sph"] = filter_report([0.2, 0.5], n_diverged=int(hard))
        if with_pf:
            filters["pf"] = filter_report([0.2, 0.5])
        numbers = Report(scenario="s", dim=2, n_runs=10, n_epochs=5, filters=filters)
        made += tables.rows_of(sweep.Cell(interval, 0.5, 1.0), numbers)
    return made


def test_a_cell_scales_the_noises_and_replaces_the_interval():
    settings = read_settings("cart")
    cell = sweep.Cell(1.25, 0.5, 3.0)
    changed = load_scenario("cart", **cell.changes(settings)).settings
    Q, R = np.array(settings.model.spectral_density), np.array(settings.sensor.noise_cov)
    np.testing.assert_allclose(changed.model.spectral_density, 0.5 * Q)
    np.testing.assert_allclose(changed.sensor.noise_cov, 3.0 * R)
    assert changed.times == replace(settings.times, interval=1.25)
    assert cell.name != replace(cell, q=0.5 + 1e-12).name


def test_rows():
    ekf, sph, pf = rows()[3:]
    assert (ekf["interval"], ekf["q"], ekf["filter"]) == (2.0, 0.5, "ekf")
    assert (ekf["diverged"], ekf["failed"]) == (3, 1)
    assert ekf["lost"] == 0.4 and sph["lost"] == 0.1
    assert ekf["rms_ratio"] == pytest.approx(4.0) and pf["rms_ratio"] == 1.0 and ekf["rms_2"] == 2.0
    assert np.isnan(rows(with_pf=False)[0]["rms_ratio"])


def test_sentences_name_the_places_and_what_the_others_do_there():
    said = tables.sentences(rows())
    assert "99.99 % point" in said[0]
    assert (
        said[2] == "The EKF loses 10% of the runs or more at 1 of 2 combinations: 2 s, Q × 0.5, R × 1 (40%)."
    )
    assert said[3] == "There the SPH loses 10%, and the EKF's RMS error is 4.0 times its own."
    assert said[4] == "There the PF loses 0%, and the EKF's RMS error is 4.0 times its own."
    assert tables.sentences(rows(with_pf=False))[3] == "There the SPH loses 10%."
    assert "keeps track" in tables.sentences(rows()[:3])[-1]


def test_files_say_the_same_as_the_rows(tmp_path):
    tables.write(tmp_path, rows(), "scene")
    back = csv_rows(tmp_path / "sweep.csv")
    assert [float(row["rms_ratio"]) for row in back] == [row["rms_ratio"] for row in rows()]
    lines = (tmp_path / "sweep.md").read_text().splitlines()
    assert lines[5] == "| 2 | 0.5 | 1 | 4 of 10 | 4.00 | 1 of 10 | 1.00 | 0 of 10 | 1.00 |"
    assert len({line.count("|") for line in lines[2:6]}) == 1
    tables.write(tmp_path, rows(with_pf=False), "scene")
    assert "| 2 | 0.5 | 1 | 4 of 10 | 1 of 10 |" in (tmp_path / "sweep.md").read_text()


def test_pictures(tmp_path):
    three_axes = [row | {"q": q, "r": r} for row in rows() for q in (0.5, 1.0) for r in (1.0, 4.0)]
    lost_everywhere = [row | {"rms_ratio": np.nan} if row["filter"] == "ekf" else row for row in rows()]
    for case in (rows(), three_axes, lost_everywhere):
        drawn = plots.draw(tmp_path, case, "scene")
        assert all(path.stat().st_size > 5000 for path in drawn)
        assert [path.name for path in drawn] == ["lost.png", "rms_ratio.png"][
            : 1 if case is lost_everywhere else 2
        ]
        for path in drawn:
            path.unlink()


@pytest.mark.parametrize("text", ["1,0", "-1", "a", "", "inf"])
def test_lists_of_numbers_are_checked(text, capsys):
    with pytest.raises(SystemExit):
        arguments("duffing", f"--interval={text}")
    assert "is not a list of positive numbers" in capsys.readouterr().err


def test_unknown_names_are_refused(tmp_path):
    with pytest.raises(ConfigError, match="did you mean 'duffing'"):
        sweep.main(arguments("dufing", "--out", str(tmp_path)))
    with pytest.raises(ConfigError, match="did you mean 'ekf'"):
        sweep.main(arguments("duffing", "--filters", "ekff", "--out", str(tmp_path)))


def test_the_command(tmp_path, capsys):
    words = ["linear_underdamped", "--interval", "1,2", "--q", "1", "--filters", "kf,ekf", "--runs", "2"]
    words += ["--set", "times.end=4"]
    sweep.main(arguments(*words, "--out", str(tmp_path)))
    said = capsys.readouterr().out
    assert "0 of 2" in said and "The EKF keeps track" in said
    assert sorted(path.name for path in tmp_path.iterdir()) == ["lost.png", "runs", "sweep.csv", "sweep.md"]
    first = (tmp_path / "sweep.csv").read_text()
    times = {path: path.stat().st_mtime_ns for path in tmp_path.glob("runs/*/run_*.npz")}
    assert len(times) == 4
    # again, with one interval more: what is done is read, and says the same
    words[2] = "1,2,4"
    sweep.main(arguments(*words, "--out", str(tmp_path)))
    assert (
        times.items() <= {path: path.stat().st_mtime_ns for path in tmp_path.glob("runs/*/run_*.npz")}.items()
    )
    assert (tmp_path / "sweep.csv").read_text().startswith(first)
