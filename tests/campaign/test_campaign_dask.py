"""A campaign on a real dask cluster of this machine: the same numbers as without."""

import joblib
import numpy as np
import pytest

from experiments.commands import main
from experiments.scene.filters import factories
from experiments.scene.scenario import load_scenario
from sphfilter.campaign.campaign import run_campaign
from sphfilter.filter.results import FilterResult

distributed = pytest.importorskip("distributed", reason="the extra dask is not installed")


@pytest.fixture(scope="module")
def cluster():
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
    ) as made:
        yield made


def test_dask_gives_the_same_bits_and_keeps_runs(cluster, tmp_path):
    scenario = load_scenario("linear_underdamped", **{"times.end": 6.0})
    filters = factories(["kf", "pf"], scenario)
    alone = run_campaign(scenario, filters, 5, seed=2)
    with distributed.Client(cluster), joblib.parallel_config(backend="dask"):
        spread = run_campaign(scenario, filters, 5, seed=2, n_jobs=None, folder=tmp_path)
    assert len(list(tmp_path.glob("run_*.npz"))) == 5
    for name in filters:
        for key in vars(alone.results[name]):
            np.testing.assert_array_equal(
                getattr(spread.results[name], key), getattr(alone.results[name], key)
            )
    assert isinstance(spread.results["kf"], FilterResult) and spread.failures == []


@pytest.mark.slow
def test_command_with_a_scheduler_and_with_none(cluster, tmp_path, capsys):
    words = ["campaign", "linear_underdamped", "--runs", "3", "--filters", "kf", "--set", "times.end=6"]
    assert main([*words, "--out", str(tmp_path / "a"), "--dask", cluster.scheduler_address]) == 0
    assert (tmp_path / "a" / "report.html").exists() and "KF" in capsys.readouterr().out
    assert main([*words, "--out", str(tmp_path / "b"), "--dask", "tcp://127.0.0.1:9"]) == 1
    assert "no dask scheduler answers at tcp://127.0.0.1:9" in capsys.readouterr().err
