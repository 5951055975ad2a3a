"""Campaigns that are interrupted from the keyboard while workers run: they end, and keep what is finished."""

import os
import random
import signal
import subprocess
import sys
import time
from functools import partial

import numpy as np
import pytest

import sphfilter as sf

#: How a call begins, that a script in the background would have ignore interrupts, as it does itself.
APART = {"start_new_session": True, "preexec_fn": partial(signal.signal, signal.SIGINT, signal.SIG_DFL)}
SCRIPT = """
import sys, time
import numpy as np
import sphfilter as sf

class Still:
    name = "still"
    def draw(self, rng):
        return sf.Case([1.0], [[rng.normal()]], [[0.3]], np.zeros(1), np.eye(1))

class Filter:
    def run(self, times, z):
        time.sleep(0.02)
        nothing = {"x_prior": np.zeros((1, 1)), "P_prior": np.ones((1, 1, 1)), "x": np.zeros((1, 1))}
        known = {"P": np.ones((1, 1, 1)), "log_evidence": np.zeros(1), "accepted": np.ones(1, bool)}
        return sf.FilterResult(t=np.asarray(times), **nothing, **known)

def still(case, rng):
    return Filter()

if __name__ == "__main__":
    told = lambda done, of: print(done, flush=True)
    folder, n_runs = sys.argv[1], int(sys.argv[2])
    sf.run_campaign(Still(), {"still": still}, n_runs, seed=1, n_jobs=2, folder=folder, progress=told)
"""


@pytest.mark.skipif(os.name != "posix", reason="process groups are of POSIX")
@pytest.mark.parametrize("times", [1, pytest.param(20, marks=pytest.mark.slow)])
def test_an_interrupt_ends_all_and_keeps_what_is_finished(times, tmp_path):
    script, folder, chance, kept = tmp_path / "still.py", tmp_path / "folder", random.Random(times), 0
    script.write_text(SCRIPT, encoding="utf-8")
    call = [sys.executable, str(script), str(folder)]
    for _ in range(times):
        running = subprocess.Popen(
            [*call, "5000"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, **APART
        )
        assert running.stdout.readline()  # it has begun
        time.sleep(chance.uniform(0.0, 3.0))
        os.killpg(running.pid, signal.SIGINT)
        running.communicate(timeout=60)  # else it hangs
        assert running.returncode != 0
        before, kept = kept, len(list(folder.glob("run_*.npz")))
        assert kept >= before and not list(folder.glob("*.part"))
    subprocess.run([*call, str(kept + 2)], check=True, stdout=subprocess.DEVNULL)
    done = sf.CampaignResult.open(folder)
    assert done.scenario == "still" and len(done.truth) == kept + 2 and not np.isnan(done.truth).any()


def test_an_interrupt_that_python_drops_ends_a_campaign_all_the_same(tmp_path):
    """Python drops what is raised while an object is deleted; the next result then ends the campaign."""
    lost = SCRIPT.replace(
        "told = lambda done, of: print(done, flush=True)",
        """class Dropped:
        def __del__(self):
            os.kill(os.getpid(), signal.SIGINT)
    told = lambda done, of: done == 3 and Dropped()""",
    ).replace("import sys, time", "import os, signal, sys, time")
    (tmp_path / "lost.py").write_text(lost, encoding="utf-8")
    call = [sys.executable, str(tmp_path / "lost.py"), str(tmp_path / "folder"), "200"]
    done = subprocess.run(call, stderr=subprocess.PIPE, text=True, timeout=60, **APART)
    assert done.returncode != 0 and "Exception ignored" in done.stderr
    assert 3 <= len(list((tmp_path / "folder").glob("run_*.npz"))) < 10


def test_what_is_no_folder_of_a_campaign_is_said(tmp_path):
    with pytest.raises(sf.ConfigError, match="no folder of a campaign"):
        sf.CampaignResult.open(tmp_path)
