"""What calls of a filter do around the compiled work, and that they do it once."""

import numpy as np
import pytest

import sphfilter as sf
from sphfilter.density.as_family import family_density, family_of
from sphfilter.density.family import gaussian_family, particles_of
from sphfilter.density.particle_density import ParticleDensity
from sphfilter.filter.by_family import _linearised, by_kalman, family_posterior
from sphfilter.filter.reading_at_prior import ReadingAtPrior
from sphfilter.model.measurements import block

MEAN, COV = np.array([1.0, -0.5]), np.array([[1.0, 0.6], [0.6, 2.0]])
START = sf.initialize(sf.Gaussian(MEAN, COV), n_particles="auto")


def test_arrays_made_for_a_density_are_taken_as_they_are():
    parts = particles_of(gaussian_family(MEAN, COV, 4))
    new, checked = ParticleDensity.of_new(**parts), ParticleDensity(**parts)
    assert new.x is parts["x"] and not new.x.flags.writeable
    for name in ("x", "mass", "h", "t", "kernel", "error", "needs"):
        np.testing.assert_array_equal(getattr(new, name), getattr(checked, name))


def test_arrays_that_are_not_sound_are_checked():
    parts = particles_of(gaussian_family(MEAN, COV, 2))
    mass = parts["mass"].copy()
    mass[3] = 0.0
    assert ParticleDensity.of_new(**parts | {"mass": mass}).n_particles == len(mass) - 1
    twice = parts | {"mass": 2.0 * parts["mass"]}
    np.testing.assert_allclose(ParticleDensity.of_new(**twice).mass.sum(), 1.0)
    with pytest.raises(sf.ModelError, match="NaN or infinity"):
        ParticleDensity.of_new(**parts | {"x": np.full_like(parts["x"], np.inf)})


@pytest.mark.parametrize("seen", [[True, True], [False, True]])
def test_a_gaussian_is_updated_in_closed_form_as_a_family_would_be(seen):
    sensor = sf.GaussianMeasurement([[1.0, 0.0], [0.3, 1.0]], [[0.1, 0.02], [0.02, 0.3]])
    asked = ReadingAtPrior.of(START, sensor, np.where(seen, [0.4, 0.9], np.nan))
    one, said = by_kalman(START, asked, 4, 0)
    found = family_posterior(family_of(START, 4)[0], asked.log_weight, _linearised(START, asked))
    np.testing.assert_allclose(said["log_evidence"], found.log_evidence, rtol=1e-12)
    other = family_density(START, found.family)
    np.testing.assert_allclose(one.mean(), other.mean(), rtol=1e-12)
    np.testing.assert_allclose(one.cov(), other.cov(), rtol=1e-12)


def test_only_a_gaussian_and_a_linear_sensor_have_a_closed_form():
    bent = sf.GaussianMeasurement(lambda x: (x[0] ** 2,), [[0.1]])
    angle = sf.GaussianMeasurement([[1.0, 0.0]], [[0.1]], angles=[0])
    for sensor in (bent, angle, sf.LikelihoodMeasurement(lambda z, X, t: -((z[0] - X[:, 0]) ** 2))):
        assert by_kalman(START, ReadingAtPrior.of(START, sensor, [0.5]), 4, 0) is None
    linear = sf.GaussianMeasurement([[1.0, 0.0]], [[0.1]])
    other = START.noted(gaussian=False)
    assert by_kalman(other, ReadingAtPrior.of(other, linear, [0.5]), 4, 0) is None


def test_a_sharp_reading_leaves_a_covariance_that_is_one():
    asked = ReadingAtPrior.of(START, sf.GaussianMeasurement([[1.0, 0.0]], [[1e-14]]), [0.3])
    new = by_kalman(START, asked, 4, 0)[0]
    np.testing.assert_allclose(new.cov(), [[1e-14, 6e-15], [6e-15, 1.64]], rtol=1e-6)


def test_a_block_is_the_matrix_itself_where_all_came():
    R = np.diag([1.0, 2.0, 3.0])
    assert block(R, np.ones(3, dtype=bool)) is R
    np.testing.assert_array_equal(block(R, np.array([True, False, True])), np.diag([1.0, 3.0]))


def test_a_model_without_jumps_has_no_breaks_and_one_flow():
    from sphfilter.prediction.family import flow_of

    model = sf.SDE.from_expressions(["x"], ["-a*x"], [["1"]], parameters={"a": 1.0})
    assert model.breaks(0.0, 1.0).size == 0
    assert flow_of(model) is flow_of(model)
    assert flow_of(model.with_parameters(a=2.0)).p[0] == 2.0
