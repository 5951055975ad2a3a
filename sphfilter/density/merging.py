"""Gaussian pieces taken together where one Gaussian says what two do."""

import numpy as np

from ..core.merging import merge
from .pieces import NEAR, Pieces, nodes

#: Part of the change of log p by mergers, that is an error of the mean. Measured: with half and twice errors
#: are .9 to 1.1 times as large.
OF_CHANGE = 0.2


def merged(pieces: Pieces, most: float, reach: float = 1.0) -> tuple[Pieces, float]:
    """Merge pairs of pieces, the most alike first, until log p would change by more than `most`.

    With a `reach` that is asked so many times as far out. Returns the pieces, and the change of log p,
    averaged over the mass.
    """
    xi, u = nodes(pieces.mean.shape[1])
    *parts, debt = merge(*map(np.ascontiguousarray, pieces), most, NEAR, np.array(reach * xi.T, order="C"), u)
    found = Pieces(*parts)
    return found.normalised(), float(found.w @ debt)
