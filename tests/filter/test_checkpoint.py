"""A filter written to a file and read again goes on to the same bits."""

import numpy as np
import pytest

import sphfilter as sf

DUFFING = sf.SDE.from_expressions(["x", "v"], ["v", "-0.4*v - x*(-1 + 0.1*x**2)"], [["0"], ["1"]], [[1.6]])
POSITION = sf.GaussianMeasurement(h=[[1.0, 0.0]], noise_cov=[[0.2]])
TIMES = np.arange(2.0, 17.0, 2.0)
_, Z = sf.simulate(DUFFING, POSITION, x0=[3.0, 0.0], times=np.append(0.0, TIMES), rng=1)
KEPT = "x", "P", "x_prior", "P_prior", "x_post", "P_post", "z", "y", "S"
KEPT += "log_likelihood", "log_evidence", "t"


def made(**options):
    return sf.SPHFilter(DUFFING, POSITION, x0=[3.0, 0.0], P0=np.diag([0.2, 1.0]), **options)


def go_on(flt, steps):
    """Predictions and updates with every kind of measurement; returns what was said."""
    told = []
    for k in steps:
        told.append(flt.predict(t=TIMES[k]))
        told.append(flt.update(None if k == 2 else Z[k + 1]))
    return told


@pytest.mark.parametrize(
    "options",
    [
        {"n_particles": 150},
        {"n_particles": "auto", "dt": 2.0},
        {"n_particles": 150, "config": sf.FilterConfig.paper()},
    ],
)
@pytest.mark.parametrize("predicted", [False, True])
def test_the_same_bits(tmp_path, options, predicted):
    flt = made(**options)
    go_on(flt, range(3))
    if predicted:
        flt.predict(t=TIMES[3] - 0.5)
    flt.save(tmp_path / "filter.npz")
    again = sf.SPHFilter.load(tmp_path / "filter.npz", DUFFING, POSITION)
    for name in KEPT:
        np.testing.assert_array_equal(getattr(again, name), getattr(flt, name), err_msg=name)
    assert (again.n_particles, again.dt, again.config) == (flt.n_particles, flt.dt, flt.config)
    told, retold = go_on(flt, range(3, 6)), go_on(again, range(3, 6))
    assert [repr(info) for info in told] == [repr(info) for info in retold]
    assert np.array_equal(flt.density.x, again.density.x)
    assert np.array_equal(flt.density.mass, again.density.mass)
    assert flt.log_evidence == again.log_evidence


def test_what_was_before_can_be_repeated(tmp_path):
    """A far reading makes `update` repeat the prediction, which the file has to know."""
    flt = made(n_particles=100)
    flt.predict(t=2.0)
    flt.save(tmp_path / "filter.npz")
    again = sf.SPHFilter.load(tmp_path / "filter.npz", DUFFING, POSITION)
    far = flt.x[0] + 5.0 * flt.P[0, 0] ** 0.5
    told, retold = flt.update(far), again.update(far)
    assert told.status != "ok"
    assert repr(told) == repr(retold)
    assert np.array_equal(flt.density.x, again.density.x)


def test_a_new_filter(tmp_path):
    flt = made()
    flt.save(tmp_path / "filter.npz")
    again = sf.SPHFilter.load(tmp_path / "filter.npz", DUFFING, POSITION)
    assert np.isnan(again.z).all() and np.isnan(again.S).all() and again.log_evidence == 0.0
    assert np.array_equal(again.P, flt.P)


def test_files_that_hold_no_filter(tmp_path):
    path = tmp_path / "trajectory.npz"
    sf.propagate(made().density, DUFFING, [0.1]).save(path)
    with pytest.raises(sf.ModelError, match="holds no filter"):
        sf.SPHFilter.load(path, DUFFING, POSITION)
    (tmp_path / "text.npz").write_text("no arrays")
    with pytest.raises(sf.ModelError, match="cannot read"):
        sf.SPHFilter.load(tmp_path / "text.npz", DUFFING, POSITION)
    made().save(path)
    with pytest.raises(sf.ModelError, match="states x, v; that given has x0, x1, x2"):
        sf.SPHFilter.load(path, sf.LinearSDE(A=-np.eye(3), noise=np.eye(3)), None)
    both = sf.GaussianMeasurement(np.eye(2), np.eye(2))
    with pytest.raises(sf.ModelError, match="has 1 components; that given has 2"):
        sf.SPHFilter.load(path, DUFFING, both)


def test_what_was_saved_stays_where_the_next_is_not_written_to_its_end(tmp_path, monkeypatch):
    path, flt = tmp_path / "filter.npz", made()
    flt.save(path)
    before = path.read_bytes()

    def full(file, **arrays):
        file.write(b"half of it")
        raise OSError("no space left on device")

    monkeypatch.setattr(np, "savez_compressed", full)
    with pytest.raises(OSError, match="no space left"):
        flt.save(path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_a_filter_is_read_without_its_sensor_and_by_subclasses_without_dt(tmp_path):
    class Plain(sf.SPHFilter):
        def __init__(self, model, measurement, *, density, n_particles, config):
            super().__init__(model, measurement, density=density, n_particles=n_particles, config=config)

    model = sf.SDE.from_expressions(["x"], ["x - x**3"], [["1"]], [[0.5]])
    sensor = sf.GaussianMeasurement([[1.0]], [[0.1]])
    flt = sf.SPHFilter(model, sensor, [0.0], [[0.5]], n_particles=60, dt=0.5)
    flt.predict()
    flt.update(0.3)
    flt.save(tmp_path / "filter.npz")
    again = Plain.load(tmp_path / "filter.npz", model, None)
    assert (again.dt, again.z) == (0.5, flt.z)
    flt.predict(), again.predict()
    flt.update(-0.2), again.update(-0.2, sensor)
    assert np.array_equal(flt.x, again.x)
