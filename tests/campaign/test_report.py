"""The report's numbers, worked out by hand and by repetition."""

import json
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

import sphfilter.consistency as consistency
from sphfilter.campaign.campaign import CampaignResult, Failure
from sphfilter.campaign.report import report
from sphfilter.campaign.verdict import unseen
from sphfilter.consistency import nees_bounds
from sphfilter.errors import ModelError
from sphfilter.filter.results import FilterResult


def histories(error, variance=1.0):
    """A filter whose mean errs by `error` (R, T, n) about a truth of ones."""
    error = np.asarray(error, dtype=float)
    x = 1.0 + error
    P = np.broadcast_to(variance * np.eye(x.shape[2]), (*x.shape, x.shape[2])).copy()
    T = x.shape[1]
    return FilterResult(t=np.arange(T), x_prior=x, P_prior=P, x=x, P=P, log_evidence=-np.ones(x.shape[:2]),
                        accepted=np.ones(x.shape[:2], dtype=bool))  # fmt: skip


def campaign(**results):
    first = next(iter(results.values()))
    R, T, n = first.x.shape
    run_time = {name: np.arange(1.0, R + 1) for name in results}
    return CampaignResult(scenario="scene", seed=0, times=first.t, truth=np.ones((R, T, n)), t0=0.0,
                          z=np.zeros((R, T, 1)), x0=np.zeros((R, n)), P0=np.zeros((R, n, n)),
                          results=results, run_time=run_time, failures=[])  # fmt: skip


def test_errors_by_hand():
    error = [[[1.0, 0.0], [-3.0, 0.5]], [[2.0, 0.0], [0.0, -0.1]]]
    f = report(campaign(a=histories(error))).filters["a"]
    np.testing.assert_allclose(f.max_peak_error, [3.0, 0.5])
    np.testing.assert_allclose(f.mean_peak_error, [2.5, 0.3])
    np.testing.assert_allclose(f.rms_error, [np.sqrt(14 / 4), np.sqrt(0.26 / 4)])
    # mean squares of the runs are 5 and 2: 3.5 ± 1.5, through the root
    assert f.rms_error_std[0] == pytest.approx(1.5 / (2 * np.sqrt(3.5)))
    assert f.run_time == 1.5 and f.log_evidence == -2.0 and f.log_evidence_std == 0.0
    assert f.nees == pytest.approx((1.0 + 9.25 + 4.0 + 0.01) / 4)
    # averages of two runs: 2.5 and 4.63 in [.242, 5.57] and [0, 4.74]; state 1: 1.5 and -1.5, beyond 1.386
    assert (f.nees_inside, f.nees_inside_one_sided) == (1.0, 1.0)
    np.testing.assert_array_equal(f.nmee_inside, [0.0, 1.0])
    assert (f.n_runs, f.n_failed, f.n_rejected, f.n_diverged) == (2, 0, 0, 0)


def test_standard_error_of_rms_is_the_spread_between_campaigns():
    rng = np.random.default_rng(4)
    errors = np.cumsum(rng.standard_normal((300, 25, 10, 1)), axis=2)  # correlated within a run
    reports = [report(campaign(a=histories(e))).filters["a"] for e in errors]
    spread = np.std([r.rms_error[0] for r in reports], ddof=1)
    assert np.mean([r.rms_error_std[0] for r in reports]) == pytest.approx(spread, rel=0.15)


def test_a_consistent_filter_is_reported_as_such_and_a_wrong_one_is_not():
    rng = np.random.default_rng(4)
    noise = rng.standard_normal((25, 400, 2))
    biased = noise + np.array([0.0, 1.5])
    drifted = noise.copy()
    drifted[3, 100:105] += 4.0
    r = report(campaign(good=histories(noise), small=histories(noise, 0.25), biased=histories(biased),
                        drifted=histories(drifted)))  # fmt: skip
    good, small, off, drift = (r.filters[name] for name in ("good", "small", "biased", "drifted"))
    for inside in (good.nees_inside, good.nees_inside_one_sided, *good.nmee_inside):
        assert inside == pytest.approx(0.95, abs=0.04)
    assert good.nees == pytest.approx(2.0, abs=0.1) and small.nees == pytest.approx(4 * good.nees)
    assert small.nees_inside == small.nees_inside_one_sided == 0.0
    assert off.nmee_inside[0] == good.nmee_inside[0] and off.nmee_inside[1] == 0.0
    # the windows of 25 × 396 epochs, at 1e-4 each: about one false alarm
    assert drift.n_diverged == good.n_diverged + 1 and good.n_diverged <= 3


def test_failed_runs_count_as_failed_and_nowhere_else():
    rng = np.random.default_rng(1)
    good = histories(rng.standard_normal((4, 6, 2)))
    good.accepted[2, 3:5] = False
    kept = [0, 2]
    some = replace(good, x=good.x.copy(), P=good.P.copy(), accepted=good.accepted.copy())
    some.x[1], some.P[3, 5], some.accepted[1], some.log_evidence[1] = np.nan, np.nan, False, np.nan
    whole = campaign(some=some)
    whole.failures.append(Failure(1, "some", "ModelError: nothing"))
    only = CampaignResult(**{**vars(whole), "truth": whole.truth[kept], "results": {
        "some": FilterResult(t=good.t, **{k: getattr(good, k)[kept] for k in vars(good) if k != "t"})},
        "run_time": {"some": whole.run_time["some"][kept]}})  # fmt: skip
    got, expected = report(whole).as_dict()["filters"]["some"], report(only).as_dict()["filters"]["some"]
    assert (got.pop("n_runs"), expected.pop("n_runs")) == (4, 2)
    assert (got.pop("n_failed"), expected.pop("n_failed")) == (2, 0)
    assert got["n_rejected"] == 2
    assert got.pop("verdict") == "failed in 2 of 4 runs" and "failed" not in expected.pop("verdict")
    assert json.dumps(got) == json.dumps(expected)  # as text, where NaN is NaN


def test_all_runs_failed_and_one_run_alone():
    lost = report(campaign(lost=histories(np.full((3, 5, 2), np.nan)))).filters["lost"]
    assert lost.n_failed == 3 and lost.n_diverged == lost.n_rejected == 0
    assert np.isnan([lost.nees, lost.nees_inside, lost.run_time, lost.log_evidence, *lost.rms_error,
                     *lost.max_peak_error, *lost.nmee_inside]).all()  # fmt: skip
    one = report(campaign(one=histories(np.ones((1, 5, 2))))).filters["one"]
    assert np.isnan(one.rms_error_std).all() and np.isnan(one.log_evidence_std)
    np.testing.assert_array_equal(one.rms_error, 1.0)


def test_a_result_with_its_truth():
    stacked = histories(np.random.default_rng(0).standard_normal((3, 8, 2)))
    whole = report(stacked, np.ones((3, 8, 2)))
    assert (whole.n_runs, whole.n_epochs, whole.dim) == (3, 8, 2)
    np.testing.assert_array_equal(
        whole.filters["filter"].rms_error, report(campaign(a=stacked)).filters["a"].rms_error
    )
    single = FilterResult(stacked.t, *(getattr(stacked, k)[1] for k in list(vars(stacked))[1:]))
    f = report(single, truth=np.ones((8, 2))).filters["filter"]
    np.testing.assert_allclose(f.max_peak_error, np.abs(stacked.x[1] - 1.0).max(axis=0))
    nees = consistency.nees(np.ones((8, 2)), single.x, single.P)
    assert f.n_runs == 1 and f.nees == pytest.approx(nees.mean()) and np.isnan(f.run_time)
    assert "Max peak error (state 2)" in str(report(single, np.ones((8, 2))))


def test_truth_is_needed_once():
    a = histories(np.ones((1, 5, 2)))
    with pytest.raises(ModelError, match="needs truth="):
        report(a)
    with pytest.raises(ModelError, match=r"truth has shape \(5, 2\), but the means have \(1, 5, 2\)"):
        report(a, np.ones((5, 2)))
    with pytest.raises(ModelError, match="carries its truth"):
        report(campaign(a=a), truth=np.ones((1, 5, 2)))


def test_rows_text_and_json():
    r = report(campaign(ekf=histories(np.full((2, 5, 2), 0.25)), sph=histories(np.full((2, 5, 2), 0.5))))
    rows = dict(r.rows())
    assert rows["RMS error (state 2)"] == {"ekf": 0.25, "sph": 0.5}
    assert rows["Runs failed"] == {"ekf": 0, "sph": 0}
    text = str(r).splitlines()
    assert text[0] == "scene: 2 runs of 5 updates" and text[1].split() == ["ekf", "sph"]
    assert any(line.split() == ["RMS", "error", "(state", "1)", "0.25", "0.5"] for line in text)
    again = json.loads(json.dumps(r.as_dict()))
    assert again["filters"]["sph"]["rms_error"] == [0.5, 0.5] and again["dim"] == 2


def test_pages_of_other_programs_hold_table_and_verdicts():
    r = report(campaign(ekf=histories(np.full((2, 5, 2), 0.25)), a_b=histories(np.full((2, 5, 2), 0.5))))
    page, paper, web = r.to_markdown(), r.to_latex(), r.to_html()
    assert page.startswith("## scene: 2 runs of 5 updates\n\n|  | ekf | a_b |\n| --- | ---: | ---: |\n")
    assert "| RMS error (state 1) | 0.25 | 0.5 |" in page and f"- ekf: {r.filters['ekf'].verdict}" in page
    assert paper.startswith("\\begin{tabular}{lrr}\n\\toprule\n & ekf & a\\_b \\\\\n\\midrule\n")
    assert "RMS error (state 1) & 0.25 & 0.5 \\\\" in paper and paper.endswith("\\end{tabular}")
    ElementTree.fromstring(f"<body>{web}</body>")
    assert "<td>RMS error (state 1)</td><td>0.25</td><td>0.5</td>" in web
    for text in (str(r), page, paper, web):
        assert "nan" not in text.lower()
    assert "referee" not in str(r)  # of which no filter knows a number


@pytest.mark.parametrize(("n_runs", "dim"), [(12, 2), (200, 3)])
def test_what_so_many_runs_may_have_missed_is_said_beside_verdicts(n_runs, dim):
    said = unseen(n_runs, dim)
    _, high = nees_bounds(dim, n_runs)
    rng = np.random.default_rng(1)
    missed = rng.chisquare(n_runs * dim, 4000) * (high / dim) / n_runs < high
    assert f"factor of {high / dim:.2g}" in said and 0.3 < missed.mean() < 0.7
    assert f"bias of {2.0 / np.sqrt(n_runs):.2g}" in said
