"""Finished runs on disk, one file each, so that a stopped campaign goes on where it was."""

import hashlib
import json
from dataclasses import fields
from functools import cache
from pathlib import Path

import numpy as np

import reference_filters
import sphfilter
from experiments.show.files import whole

__all__ = ["digest_of", "load", "path_of", "save", "sources"]


@cache  # what was loaded is what counts, though files may change while a campaign runs
def sources(method):
    """Return a digest of the code a result depends on: results of other code are not taken for this one's.

    Only the SPH filters depend on all of the library, so that a change of a scheme leaves references valid.
    """
    here, references = Path(__file__).parent, Path(reference_filters.__file__).parent
    library = Path(sphfilter.__file__).parent
    files = [here / name for name in ("cell.py", "systems.py", "model_families.py", "data_families.py")]
    if method in ("default", "paper"):
        files += [here / "runs.py", *sorted(library.rglob("*.py"))]
    else:
        files += [here / "references.py", here / "exact.py", *sorted(references.glob("*.py"))]
        files += [library / "model" / "simulate.py", library / "core" / "sde_steps.py"]
    return digest_of(files)


def digest_of(files):
    """Return a digest of what is in files."""
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]


def path_of(out, cell, seed, method):
    """Return the file of one result; `method` may be "reference"."""
    name = "".join(c if c.isalnum() or c in "._-" else "+" for c in cell.name.replace("/", "__"))
    unique = hashlib.sha256(cell.name.encode()).hexdigest()[:6]
    return Path(out) / "runs" / f"seed{seed}" / f"{name}-{unique}" / f"{method}.npz"


def save(path, result, digest):
    """Write a dataclass of arrays, numbers, texts and None."""
    values = {f.name: getattr(result, f.name) for f in fields(result)}
    arrays = {name: v for name, v in values.items() if isinstance(v, np.ndarray)}
    rest = {name: v for name, v in values.items() if name not in arrays}
    with whole(path) as file:
        np.savez_compressed(file, **arrays, _rest=json.dumps(rest), _digest=digest)


def load(path, kind, digest):
    """Return the dataclass `kind` that was saved; None if there is none, or one of other code."""
    if not path.exists():
        return None
    with np.load(path) as data:
        if str(data["_digest"]) != digest:
            return None
        arrays = {name: data[name] for name in data.files if not name.startswith("_")}
        return kind(**arrays, **json.loads(str(data["_rest"])))
