"""Campaigns: same numbers whatever the order, the company, the workers and the interruptions."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from sphfilter.campaign.campaign import CampaignResult, Case, Failure, run_campaign
from sphfilter.campaign.report import report
from sphfilter.errors import CampaignError, ConfigError, ModelError, PropagationError
from sphfilter.filter.results import FilterResult

TIMES = np.arange(1.0, 6.0)


@dataclass(frozen=True)
class Walk:
    """A random walk in two dimensions, of which the first is measured."""

    name: str = "walk"
    step: float = 1.0

    def draw(self, rng):
        truth = np.cumsum(self.step * rng.standard_normal((len(TIMES), 2)), axis=0)
        z = truth[:, :1] + rng.standard_normal((len(TIMES), 1))
        return Case(TIMES, truth, z, x0=np.zeros(2), P0=np.eye(2), t0=0.0)


@dataclass(frozen=True)
class Echo:
    """A filter that says what it measured plus noise of its own, and spoils its input."""

    gain: float = 1.0

    def __call__(self, case, rng):
        return _Echo(self.gain, case, rng)


class _Echo:
    def __init__(self, gain, case, rng):
        self.gain, self.case, self.rng = gain, case, rng

    def run(self, times, z):
        x = self.gain * np.repeat(z, 2, axis=1) + self.rng.standard_normal((len(z), 2))
        P = np.repeat(np.eye(2)[None], len(z), axis=0)
        z[:] = 0.0
        self.case.truth[:] = 0.0
        return FilterResult(t=times, x_prior=x, P_prior=P, x=x, P=P, log_evidence=-x[:, 0],
                            accepted=x[:, 1] > 0)  # fmt: skip


@dataclass(frozen=True)
class Fragile:
    """A filter that fails in the runs whose first measurement is positive."""

    def __call__(self, case, rng):
        if case.z[0, 0] > 0:
            raise PropagationError("too positive")
        return _Echo(1.0, case, rng)


class Interrupted:
    """A scenario that is stopped by the user at its n-th case (run 0 is drawn once more for the manifest)."""

    name = "walk"

    def __init__(self, n):
        self.n, self.drawn = n, 0

    def __repr__(self):
        return repr(Walk())

    def draw(self, rng):
        self.drawn += 1
        if self.drawn > self.n:
            raise KeyboardInterrupt
        return Walk().draw(rng)


def same(a, b, filters=("echo",)):
    for key in ("times", "truth", "z", "x0", "P0"):
        np.testing.assert_array_equal(getattr(a, key), getattr(b, key))
    for name in filters:
        for key in ("t", "x_prior", "P_prior", "x", "P", "log_evidence", "accepted"):
            np.testing.assert_array_equal(getattr(a.results[name], key), getattr(b.results[name], key))


def test_shapes_and_shared_measurements():
    c = run_campaign(Walk(), {"echo": Echo(), "double": Echo(2.0)}, 4, seed=3)
    assert c.truth.shape == (4, 5, 2) and c.z.shape == (4, 5, 1) and c.P0.shape == (4, 2, 2) and c.t0 == 0.0
    assert c.results["echo"].P.shape == (4, 5, 2, 2) and c.results["echo"].t.shape == (5,)
    assert c.results["echo"].accepted.dtype == bool and c.run_time["double"].shape == (4,)
    assert c.failures == [] and np.all(c.run_time["echo"] >= 0)
    # runs differ, and so do the filters' own draws, though both saw the same z
    assert len(np.unique(c.z[:, 0, 0])) == 4 and np.all(c.z != 0)
    own = c.results["echo"].x[..., 0] - c.z[..., 0], c.results["double"].x[..., 0] - 2 * c.z[..., 0]
    assert np.abs(np.concatenate(own)).max() < 6 and not np.any(np.isclose(*own))


def test_numbers_do_not_depend_on_company_order_or_number_of_runs():
    alone = run_campaign(Walk(), {"echo": Echo()}, 3, seed=3)
    same(alone, run_campaign(Walk(), {"a": Echo(5.0), "echo": Echo(), "z": Fragile()}, 3, seed=3))
    more = run_campaign(Walk(), {"echo": Echo()}, 5, seed=3)
    np.testing.assert_array_equal(more.results["echo"].x[:3], alone.results["echo"].x)
    other = run_campaign(Walk(), {"echo": Echo()}, 3, seed=4)
    assert not np.any(other.truth == alone.truth)


def test_numbers_do_not_depend_on_workers():
    filters = {"echo": Echo(), "fragile": Fragile()}
    one, two = (run_campaign(Walk(), filters, 6, seed=3, n_jobs=n) for n in (1, 2))
    same(one, two, filters)
    assert one.failures == two.failures


def test_failures_are_recorded_and_the_campaign_goes_on():
    c = run_campaign(Walk(), {"fragile": Fragile(), "echo": Echo()}, 8, seed=1)
    failed = c.z[:, 0, 0] > 0
    assert 0 < failed.sum() < 8
    message = "PropagationError: too positive"
    assert c.failures == [Failure(r, "fragile", message) for r in np.flatnonzero(failed)]
    result = c.results["fragile"]
    np.testing.assert_array_equal(np.isnan(result.x).all(axis=(1, 2)), failed)
    assert not result.accepted[failed].any() and np.isnan(result.log_evidence[failed]).all()
    np.testing.assert_array_equal(np.isnan(c.run_time["fragile"]), failed)
    assert np.isfinite(result.x[~failed]).all() and np.isfinite(c.results["echo"].x).all()


def test_a_result_of_wrong_shape_is_a_failure():
    class Short(_Echo):
        def run(self, times, z):
            return super().run(times[:-1], z[:-1])

    c = run_campaign(Walk(), {"short": lambda case, rng: Short(1.0, case, rng)}, 2, seed=0)
    assert len(c.failures) == 2
    assert c.failures[0].message == "ModelError: the filter's result has x_prior of shape (4, 2), not (5, 2)"


def test_interrupted_campaign_resumes(tmp_path):
    whole = run_campaign(Walk(), {"echo": Echo()}, 5, seed=3)
    with pytest.raises(KeyboardInterrupt):
        run_campaign(Interrupted(1 + 3), {"echo": Echo()}, 5, seed=3, folder=tmp_path / "c")
    assert len(list((tmp_path / "c").glob("run_*.npz"))) == 3
    rest = Interrupted(1 + 2)  # enough for the two runs that are missing, and no more
    seen, folder = [], tmp_path / "c"
    resumed = run_campaign(rest, {"echo": Echo()}, 5, 3, folder=folder, progress=lambda *a: seen.append(a))
    assert seen == [(3, 5), (4, 5), (5, 5)]
    same(resumed, whole)
    same(run_campaign(Interrupted(1), {"echo": Echo()}, 5, 3, folder=tmp_path / "c"), whole)


def test_more_runs_continue_a_folder_and_keep_failures(tmp_path):
    filters = {"fragile": Fragile()}
    few = run_campaign(Walk(), filters, 3, seed=3, folder=tmp_path)
    many = run_campaign(Walk(), filters, 6, seed=3, folder=tmp_path)
    fresh = run_campaign(Walk(), filters, 6, seed=3)
    assert few.failures and many.failures == fresh.failures
    same(many, fresh, filters)


class Renamed(Walk):
    """Differs from Walk in what it draws, not in its text."""

    def __repr__(self):
        return repr(Walk())


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"scenario": Walk(step=2.0)}, "scenario is .*step=1.0.*now it is .*step=2.0"),
        ({"scenario": Renamed(step=2.0)}, "digest of run 0 is "),
        ({"seed": 4}, "seed is 3, now it is 4"),
        ({"filters": {"echo": Echo(2.0)}}, r"filters is .*gain=1.0.*now it is .*gain=2.0"),
        ({"filters": {"echo": Echo(), "b": Echo()}}, "filters are echo, now they are echo, b"),
        (
            {"scenario": Walk("walk" * 99), "filters": {"echo": Echo()}},
            "scenario is .{4,70}, now it is .{4,70}",
        ),
    ],
)
def test_another_campaign_in_the_folder_is_refused(tmp_path, changes, words):
    given = {"scenario": Walk(), "filters": {"echo": Echo()}, "n_runs": 2, "seed": 3, "folder": tmp_path}
    run_campaign(**given)
    with pytest.raises(ConfigError, match=f"holds another campaign: its {words}"):
        run_campaign(**given | changes)


def test_save_and_load(tmp_path):
    c = run_campaign(Walk(), {"echo": Echo(), "a/b c": Fragile()}, 4, seed=2**100)
    c.save(tmp_path / "c.npz")
    back = CampaignResult.load(tmp_path / "c.npz")
    same(back, c, ("echo", "a/b c"))
    assert (back.scenario, back.seed, back.t0, back.failures) == (c.scenario, 2**100, c.t0, c.failures)
    assert list(back.results) == ["echo", "a/b c"]
    np.testing.assert_array_equal(back.run_time["a/b c"], c.run_time["a/b c"])


def test_cases_must_fit():
    case = Walk().draw(np.random.default_rng(0))
    with pytest.raises(ModelError, match="got 5 times, 5 truths and 4 measurements"):
        replace(case, z=case.z[:-1])
    with pytest.raises(ModelError, match=r"x0 of length 3 needs truth \(T, 3\) and P0 \(3, 3\)"):
        replace(case, x0=np.zeros(3))

    class Wandering(Walk):
        def draw(self, rng):
            return replace(super().draw(rng), times=TIMES + rng.random())

    with pytest.raises(ModelError, match="cases of scenario 'walk' differ in times"):
        run_campaign(Wandering(), {"echo": Echo()}, 2, seed=0)


def test_bad_arguments():
    with pytest.raises(ModelError, match="at least one filter"):
        run_campaign(Walk(), {}, 2, seed=0)
    with pytest.raises(ModelError, match="seed must be an integer of zero or more"):
        run_campaign(Walk(), {"echo": Echo()}, 2, seed=1.5)
    with pytest.raises(ModelError, match="n_runs"):
        run_campaign(Walk(), {"echo": Echo()}, 0, seed=0)


def test_spoilt_files_are_made_again_and_a_spoilt_manifest_is_named(tmp_path):
    whole = run_campaign(Walk(), {"echo": Echo()}, 4, seed=3, folder=tmp_path)
    (tmp_path / "run_00001.npz").write_bytes(b"")
    (tmp_path / "run_00002.npz").write_bytes((tmp_path / "run_00002.npz").read_bytes()[:200])
    same(run_campaign(Walk(), {"echo": Echo()}, 4, seed=3, folder=tmp_path), whole)
    (tmp_path / "manifest.json").write_text("")
    with pytest.raises(ConfigError, match=r"manifest.json cannot be read"):
        run_campaign(Walk(), {"echo": Echo()}, 4, seed=3, folder=tmp_path)


def test_functions_are_known_by_their_code_and_what_they_close_over(tmp_path):
    def scaled(gain):
        return lambda case, rng: _Echo(gain, case, rng)

    run_campaign(Walk(), {"f": scaled(1.0)}, 2, seed=3, folder=tmp_path)
    run_campaign(Walk(), {"f": scaled(1.0)}, 3, seed=3, folder=tmp_path)
    for other in (scaled(2.0), lambda case, rng: _Echo(1.0, case, np.random.default_rng(0))):
        with pytest.raises(ConfigError, match="holds another campaign"):
            run_campaign(Walk(), {"f": other}, 3, seed=3, folder=tmp_path)


def test_a_truth_that_blows_up_costs_its_run_alone(tmp_path):
    class Explosive(Walk):
        def draw(self, rng):
            case = super().draw(rng)
            if case.truth[-1, 0] > 0:
                raise ValueError("a path ran away")
            return case

    calm = run_campaign(Walk(), {"echo": Echo()}, 6, seed=3)
    lost = calm.truth[:, -1, 0] > 0
    assert 0 < lost.sum() < 6
    found = run_campaign(Explosive(), {"echo": Echo()}, 6, seed=3, folder=tmp_path)
    np.testing.assert_array_equal(np.isnan(found.truth).all(axis=(1, 2)), lost)
    np.testing.assert_array_equal(found.results["echo"].x[~lost], calm.results["echo"].x[~lost])
    message = "ValueError: a path ran away"
    assert found.failures == [Failure(r, "simulation", message) for r in np.flatnonzero(lost)]


def test_a_full_disk_is_a_sentence_and_leaves_no_part(tmp_path, monkeypatch):
    def full(*arguments, **arrays):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", full)
    with pytest.raises(CampaignError, match=r"run_00000.npz could not be written .*No space left"):
        run_campaign(Walk(), {"echo": Echo()}, 2, seed=3, folder=tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["manifest.json"]


def test_filters_of_ones_own_may_tell_less_and_in_lists():
    class Plain:
        spread = 2.0  # their own affair

        def __init__(self, case, rng):
            self.x, self.P = np.zeros((5, 2)), np.repeat(np.eye(2)[None], 5, axis=0)

        def run(self, times, z):
            return FilterResult(t=times, x_prior=self.x.tolist(), P_prior=self.P, x=self.x, P=self.P,
                                log_evidence=[0] * 5, accepted=[1, 0, 1, 1, 1])  # fmt: skip

    class Listed(Walk):
        def draw(self, rng):
            case = super().draw(rng)
            return Case(
                case.times.tolist(), case.truth.tolist(), case.z.tolist(), [0.0, 0.0], np.eye(2).tolist()
            )

    whole = run_campaign(Listed(), {"plain": Plain}, 12, seed=3)
    f = report(whole).filters["plain"]
    assert whole.failures == [] and np.isfinite(whole.results["plain"].hpd_rank).all()
    assert f.innovations.n_measurements == 60 and f.innovations.acceptance == 0.8
