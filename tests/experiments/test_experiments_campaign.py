"""The command `campaign`: a page that stands alone, runs that are kept, and what is said of bad input."""

import json
import re
from types import SimpleNamespace

import numpy as np
import pytest

from experiments.commands import main
from experiments.scene.scenario import load_scenario
from experiments.show.plots import consistency_figure
from sphfilter.campaign.campaign import CampaignResult

SMALL = ["--set", "times.end=6", "--set", "filters.pf.n_particles=200", "--set", "filters.grid.size=48"]


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    folder = tmp_path_factory.mktemp("campaign")
    words = ["--filters", "ekf,pf,grid", "--runs", "12", "--own-prior", "--out", str(folder), *SMALL]
    assert main(["campaign", "duffing", *words]) == 0
    return folder


def test_page_stands_alone_and_markdown_shows_its_pictures(out):
    page, text = (out / "report.html").read_text(), (out / "report.md").read_text()
    pictures = re.findall(r"!\[[^]]+\]\(([^)]+)\)", text)
    assert pictures == ["consistency.png", "truth.png", "measurements.png"]
    assert all((out / name).stat().st_size > 10_000 for name in pictures)
    assert page.count('src="data:image/png;base64,') == 3 and 'src="consistency' not in page
    assert page.count("<table>") == 3 and "</html>" in page
    for words in (
        "- **EKF**: ",
        "GRID is the referee",
        "NIS per degree of freedom",
        "RMS error, velocity (m/s)",
    ):
        assert words in text
    assert "Versions: sphfilter" in text and "seed 1" in text


def test_numbers_can_be_read_again(out):
    record = json.loads((out / "report.json").read_text())
    campaign = CampaignResult.load(out / "campaign.npz")
    assert record["runs"] == 12 and record["referee"] == "grid" and campaign.truth.shape == (12, 3, 2)
    assert set(record["report"]["filters"]) == {"ekf", "pf", "grid"}
    assert record["report"]["filters"]["pf"]["ranks"]["hpd_p"] is None  # samples have no density
    assert record["settings"]["start"]["kind"] == "gaussian"
    assert len(list((out / "runs").glob("run_*.npz"))) == 12


def test_the_same_command_reads_and_more_runs_are_added(out, capsys):
    words = ["--filters", "ekf,pf,grid", "--own-prior", "--out", str(out), *SMALL]
    before = {path: path.stat().st_mtime_ns for path in (out / "runs").glob("run_*.npz")}
    capsys.readouterr()
    assert main(["campaign", "duffing", "--runs", "13", *words]) == 0
    said = capsys.readouterr().out
    assert "run 12 of 13 done" in said and "run 13 of 13 done" in said and "run 11 " not in said
    assert all(path.stat().st_mtime_ns == time for path, time in before.items())


def test_bad_input_is_answered_in_a_sentence(out, tmp_path, capsys):
    elsewhere = ["--out", str(tmp_path)]
    for words, sentence in (
        (["--referee", "kf", *elsewhere], "--referee kf is none of the filters of this campaign: ekf, pf"),
        (["--filters", "efk", *elsewhere], "no filter 'efk' (did you mean 'ekf'?)"),
        (["--seed", "9", "--out", str(out), *SMALL], "holds another campaign: its seed is 1, now it is 9"),
    ):
        assert main(["campaign", "duffing", "--filters", "ekf,pf", "--runs", "2", *words]) == 1
        assert sentence in capsys.readouterr().err


def test_the_referee_is_dashed_above_those_it_judges():
    truth, P = np.zeros((3, 4, 2)), np.tile(np.eye(2), (3, 4, 1, 1))
    result = SimpleNamespace(x=truth + 0.5, P=P)
    campaign = SimpleNamespace(truth=truth, times=np.arange(4.0), results={"grid": result, "sph": result})
    ax = consistency_figure(load_scenario("duffing"), campaign).axes[-1]
    grid, sph = (next(line for line in ax.lines if line.get_label() == name) for name in ("GRID", "SPH"))
    assert grid.get_linestyle() == "--" and sph.get_linestyle() == "-"
    assert grid.get_zorder() > sph.get_zorder()
