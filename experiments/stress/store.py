"""Results on disk, one file each, so that a stopped command goes on where it was."""

import json
from dataclasses import fields
from functools import cache
from pathlib import Path

import numpy as np

import reference_filters
import sphfilter
from experiments.show.files import digest, whole
from sphfilter.campaign.identity import digest_of_files

from .records import Record
from .referees import Referee

#: The part of a case that no filter on trial has a hand in.
REFERENCE = "reference"
_PROBLEMS = ("problem", "equations", "sensors", "records", "hard_systems", "hard_families", "hard_cases",
             "random_models", "random_sensors", "random_cases")  # fmt: skip


def save(out, case, part, result):
    """Write a dataclass of arrays, numbers and texts: a part of a case, of the run in the folder `out`."""
    values = {f.name: getattr(result, f.name) for f in fields(result)}
    arrays = {name: v for name, v in values.items() if isinstance(v, np.ndarray)}
    rest = {name: v for name, v in values.items() if name not in arrays}
    with whole(_path_of(out, case, part)) as file:
        np.savez_compressed(file, **arrays, _rest=json.dumps(rest), _digest=_sources(part))


def load(out, case, part):
    """Return what was saved; None if there is nothing, or the result of other code."""
    path = _path_of(out, case, part)
    if not path.exists():
        return None
    with np.load(path) as data:
        if str(data["_digest"]) != _sources(part):
            return None
        arrays = {name: data[name] for name in data.files if not name.startswith("_")}
        return (Referee if part == REFERENCE else Record)(**arrays, **json.loads(str(data["_rest"])))


def _path_of(out, case, part):
    name = "".join(c if c.isalnum() or c in "._-" else "+" for c in case.name.replace("/", "__"))
    unique = digest(case.name)[:6]
    return Path(out) / "runs" / f"seed{case.seed}" / f"{name}-{unique}" / f"{part}.npz"


@cache  # what was loaded is what counts, though files may change while a command runs
def _sources(part):
    """Digest of the code that a result depends on; references do not depend on all of the library."""
    here, library = Path(__file__).parent, Path(sphfilter.__file__).parent
    files = [here / f"{name}.py" for name in _PROBLEMS]
    files += [library / "model" / "simulate.py", library / "core" / "sde_steps.py"]
    if part == REFERENCE:
        files += [here / "referees.py", *sorted(Path(reference_filters.__file__).parent.glob("*.py"))]
    else:
        files += [here / "relations.py", *sorted(library.rglob("*.py"))]
    return digest_of_files(files)
