"""The evidence of linear sensors on Gaussian densities does not hang on how coarse the lattice is."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

import sphfilter as sf


@pytest.mark.parametrize(("n", "count"), [(2, 60), (4, 200)])
def test_the_closed_form(n, count):
    cov = np.eye(n) + 0.3 * np.ones((n, n))
    start = sf.initialize(sf.Gaussian(np.zeros(n), cov), count)
    _, info = sf.update(start, sf.GaussianMeasurement(np.eye(2, n), 0.1 * np.eye(2)), [0.4, -1.2])
    S = start.cov()[:2, :2] + 0.1 * np.eye(2)
    assert info.log_evidence == pytest.approx(multivariate_normal.logpdf([0.4, -1.2], cov=S), abs=1e-10)
    exact = multivariate_normal.logpdf([0.4, -1.2], cov=cov[:2, :2] + 0.1 * np.eye(2))
    assert abs(info.log_evidence - exact) < 5.0 * info.evidence_error + 1e-3


def test_a_pdf_that_the_lattice_drops_a_piece_of_says_so():
    """A hundredth of the probability, nine standard deviations away and a third as wide as the rest."""

    def pdf(X):
        return 0.99 * norm2(X, 0.0, 1.0) + 0.01 * norm2(X, 9.0, 0.3)

    def norm2(X, at, std):
        return multivariate_normal.pdf(X, [at, 0.0], std**2 * np.eye(2))

    box = [[-6.0, 13.0], [-6.0, 6.0]]
    coarse, fine = (sf.initialize(pdf, count, box=box) for count in (100, 1500))
    off = abs(coarse.mean()[0] - 0.09) / np.sqrt(fine.cov()[0, 0])
    assert off < 3.0 * coarse.error and fine.error < 1e-3 < coarse.error
