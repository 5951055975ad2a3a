"""Files that keep finished parts of long runs, named by what was computed."""

from hashlib import sha256

import numpy as np

from sphfilter.density.storage import whole


def digest(parts):
    """Name of a problem, from bytes and arrays of numbers."""
    found = sha256()
    for part in parts:
        found.update(part if isinstance(part, bytes) else np.asarray(part, dtype=float).tobytes())
    return found.hexdigest()[:20]


def save(path, **arrays):
    """Write arrays to one npz file, which appears when it is complete; None writes nothing."""
    if path is None:
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole(path) as file:
        np.savez(file, **arrays)
