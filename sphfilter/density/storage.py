"""Densities on disk: numpy arrays with a version, nothing that could run."""

import io
import json
import os
import pathlib
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields
from os import PathLike
from typing import Any, BinaryIO, TypeAlias

import numpy as np
from numpy.typing import NDArray

from .._types import Floats
from .._version import __version__
from ..core.cloud.blocks import blocks_of
from ..core.cloud.control import SHADOW
from ..core.cloud.inherited import Inherited
from ..core.cloud.pace import Bias
from ..core.field.fitting import build_field
from ..core.field.stencils import stencils
from ..errors import ModelError
from ..model.domain import Domain
from ..model.dynamics import Dynamics
from .as_cloud import cloud_density, cloud_of, passages_of
from .defect import Defect
from .family import Family
from .left_out import LeftOut
from .memory import Memory
from .moments import matched, moments
from .particle_density import ParticleDensity
from .passage import gone_again
from .pieces import Pieces
from .points import FRESH, NO_LINES, CloudState, Pace, Passage, Path, Points, Told
from .quasi_random import FEW_STATES, weighted_points

#: Arrays by name.
Arrays: TypeAlias = dict[str, NDArray[Any]]
FORMAT = 1
_TUPLES: dict[str, Any] = {"family": Family, "pieces": Pieces, "left_out": LeftOut}
_FIELD = "mu", "A", "node", "kept", "log_p"  # what a field is built from
#: What a density is kept in besides its particles, and the arrays that make it again.
_KEPT = {"field": _FIELD, **{name: kind._fields for name, kind in _TUPLES.items()}}
_ARRAYS = "x", "mass", "h", "log_density", "invariant"


def stored(density: ParticleDensity) -> Arrays:
    """A density as arrays by name; `density_from` makes the same density of them, to the last bit."""
    arrays = {name: getattr(density, name) for name in _ARRAYS if getattr(density, name) is not None}
    if density.moments is not None:
        arrays |= {"moments.mean": density.moments[0], "moments.cov": density.moments[1]}
    if density.defect is not None:
        arrays["defect"] = density.defect.packed
    if density.cloud is not None:
        arrays = _stored_cloud(density.cloud)
    for kept, names in _KEPT.items():
        if (own := getattr(density, kept)) is not None:
            arrays |= under(kept, {name: getattr(own, name) for name in names})
    special = {*_ARRAYS, *_KEPT, "moments", "domain", "defect", "cloud"}
    about: dict[str, Any] = {
        f.name: getattr(density, f.name) for f in fields(density) if f.init and f.name not in special
    }
    about["domain"] = None if density.domain is None else density.domain.axes
    return arrays | {"about": np.array(json.dumps(about))}


def density_from(arrays: Arrays, models: Sequence[Dynamics] = ()) -> ParticleDensity:
    """The density of arrays that `stored` made.

    Models are those of a cloud's predictions since the last reading, or one for all of them. Without any the
    points are there, and a reading weighs them, but does not lead them.
    """
    about = json.loads(str(arrays["about"]))
    about.pop("inherited", None)  # of files of before
    if about["read_out"] == "shrunk":  # particles of moment-corrected SPH, which was taken out
        own = ("t", "represented_mass", "capacity", "error", "lost")
        known = ParticleDensity(x=arrays["x"], mass=arrays["mass"], h=arrays["h"])
        return cloud_density(
            known, known.x, known.mass, **{name: about[name] for name in own if name in about}
        )
    if about.get("needs") is not None:
        about["needs"] = _needs_from(about["needs"])
    if about["domain"] is not None:
        about["domain"] = Domain(*about["domain"])
    if "field.mu" in arrays:
        n = len(arrays["field.mu"])
        arrays = {"field.kept": np.array(len(arrays["field.node"]))} | arrays  # which older files do not have
        mu, A, node, kept, log_p = (np.ascontiguousarray(arrays[f"field.{name}"]) for name in _FIELD)
        about["field"] = build_field(mu, A, node, kept.item(), log_p, stencils(n))
    for name, kind in _TUPLES.items():
        if fields_of := part(name, arrays):
            about[name] = kind(**fields_of)
    if "defect" in arrays:
        about["defect"] = Defect.of(arrays["defect"], about["family"])
    if "moments.mean" in arrays:
        about["moments"] = arrays["moments.mean"], arrays["moments.cov"]
    if "cloud.points.x" in arrays:
        return _cloud_from(part("cloud", arrays), about, models)
    if "families.mu" in arrays:
        return _points_of_families(part("families", arrays), about)
    about |= {name: arrays[name] for name in _ARRAYS if name in arrays}
    return ParticleDensity(**about)


def _needs_from(known: list[Any]) -> Memory:
    """The needs of a list; of files of before without an age; or the first five, which mean the same."""
    same = len(known) in (len(Memory._fields), Memory._fields.index("age"))
    return Memory(*(known if same else known[:5]))


def models_of(density: ParticleDensity) -> tuple[Dynamics, ...]:
    """The models of a cloud's predictions since the last reading, which `density_from` needs."""
    return tuple(passage.model for passage in passages_of(density) if passage.model is not None)


def _stored_cloud(state: CloudState) -> Arrays:
    """A cloud as arrays by name; of a path what begins it, and the spans and steps of its predictions."""
    *pace, (of_mean, of_variance) = state.pace
    arrays = {"told": np.array(state.told), "pace": np.array([*map(float, pace), of_mean])}
    numbers = {"size": state.size, "age": state.age, "of_variance": of_variance}
    arrays |= {name: np.array(value) for name, value in numbers.items()}
    arrays |= under("brought", {name: np.array(value) for name, value in state.inherited._asdict().items()})
    for name, points in (("points", state.points), ("shadow", state.shadow)):
        arrays |= under(name, {"x": points.x, "w": points.w})
        if points.lineage is not None:
            arrays[f"{name}.family"] = points.lineage
        if points.path is None:
            continue
        arrays |= under(name, {"path": points.path.x, "older": points.path.older})
        for k, passage in enumerate(points.path.passages):
            known: Arrays = {"key": np.array(passage.key)}
            if passage.model is None:
                known |= {"middle": passage.start, "lower": passage.lower}
            else:
                known |= {"span": np.array(passage.span), "steps": np.array(passage.steps)}
            arrays |= under(f"{name}.{k}", known)
    return under("cloud", arrays)


def _cloud_from(arrays: Arrays, about: dict[str, Any], models: Sequence[Dynamics]) -> ParticleDensity:
    """The cloud of arrays that `_stored_cloud` made."""
    step, *_, stiff, legs, of_mean = arrays["pace"].tolist()  # older files had one more
    pace = Pace(step, bool(stiff), int(legs), Bias(of_mean, float(arrays.get("of_variance", 0.0))))
    points, shadow = (_points_from(part(name, arrays), models) for name in ("points", "shadow"))
    size = arrays["size"].item() or len(points.w)  # older files have none where a reading began the cloud
    told, age = Told(*arrays["told"].tolist()), int(arrays.get("age", 0))  # older files have none
    inherited = _inherited_from(arrays, points)
    return _as_cloud(CloudState(points, shadow, size, told, pace, inherited, age), about)


def _as_cloud(state: CloudState, about: dict[str, Any]) -> ParticleDensity:
    """A state of points as the cloud that it is of."""
    own = {name: value for name, value in about.items() if name not in ("read_out", "kernel", "moments")}
    begun = ParticleDensity(x=state.points.x[:1], mass=np.ones(1), h=np.ones(1), **own)
    return cloud_of(begun, state, moments(*state.points[:2]), **own)


def _points_of_families(arrays: Arrays, about: dict[str, Any]) -> ParticleDensity:
    """A sum of exponential families, which was taken out, as points that stand for it."""
    families = [Family(*each) for each in zip(*(arrays[name] for name in Family._fields), strict=True)]

    def log_p(X: Floats) -> Floats:
        each = [log_w + one.log_p(X) for log_w, one in zip(arrays["log_w"], families, strict=True)]
        return np.asarray(np.logaddexp.reduce(each))

    x, w = weighted_points(log_p, about["moments"], FEW_STATES, 0)
    points = Points(matched(x, w, *about["moments"]), w)
    few = w[::SHADOW] / w[::SHADOW].sum()
    brought = FRESH._replace(error=about["error"])
    state = CloudState(points, Points(points.x[::SHADOW], few), FEW_STATES, inherited=brought)
    return _as_cloud(state._replace(age=(about["needs"] or Memory()).age), about)


def _inherited_from(arrays: Arrays, points: Points) -> Inherited:
    """What a cloud of these points has inherited; of files of before a family tells it, or nothing does."""
    if own := part("brought", arrays):
        numbers = {name: float(value) for name, value in own.items() if name != "off"}
        return FRESH._replace(**numbers, off=own["off"])
    error, missed = (float(arrays.get(name, 0.0)) for name in ("inherited", "missed"))
    old, known = part("origin", arrays), FRESH._replace(error=error, missed=missed)
    if not old:
        return known
    unsigned, log_mass = old["about"].tolist()
    if "off" in old:
        return known._replace(unsigned=unsigned, log_mass=log_mass, off=old["off"])
    family = Family(old["mu"], old["A"], old["c"])
    defect, x = Defect.of(old["defect"], family), points.x if points.path is None else points.path.x
    return Inherited(error, missed, 0.0, unsigned, *defect.missed_at(family, x, points.w))


def _points_from(arrays: Arrays, models: Sequence[Dynamics]) -> Points:
    """The points of a cloud, with their path where models are given."""
    family = arrays.get("family")  # older files have one row
    points = Points(arrays["x"], arrays["w"], lineage=None if family is None else np.atleast_2d(family))
    passages: list[Passage] = []
    while f"{len(passages)}.key" in arrays:
        known = part(str(len(passages)), arrays)
        passages.append(_passage_from(known))
    predictions = sum(p.span[1] > p.span[0] for p in passages)
    if not passages or predictions > len(models) > 1 or not (models or predictions == 0):
        return points
    begun = arrays["path"], blocks_of(len(points.w)), tuple(passages), ()
    path = Path(*begun, arrays.get("older", NO_LINES))
    own = tuple(models) if len(models) > 1 else tuple(models) * predictions
    return points._replace(path=gone_again(path, own))


def _passage_from(arrays: Arrays) -> Passage:
    """Facts of a passage: the noise that begins a path, or span and steps of a prediction."""
    key, none = arrays["key"].item(), np.empty((1, 0, 0))
    if "span" in arrays:
        number, stiff = arrays["steps"].tolist()
        at = np.empty((0, 0))
        span = (float(arrays["span"][0]), float(arrays["span"][1]))
        return Passage(None, key, at, at, none, none, none, None, span, (int(number), bool(stiff)))
    middle, lower = arrays["middle"], arrays["lower"]
    flow = np.tile(np.eye(middle.shape[1]), (len(middle), 1, 1))
    return Passage(None, key, middle, middle, flow, lower, none)


def under(name: str | int, arrays: Arrays) -> Arrays:
    """Arrays with the name of what they are part of."""
    return {f"{name}.{key}": value for key, value in arrays.items()}


def part(name: str, arrays: Arrays) -> Arrays:
    """The arrays that `under` put below a name."""
    return {key[len(name) + 1 :]: value for key, value in arrays.items() if key.startswith(f"{name}.")}


@contextmanager
def whole(path: pathlib.Path) -> Iterator[BinaryIO]:
    """Open a binary file to write to, which appears at `path` when all is written, or not at all."""
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        with open(part, "wb") as file:
            yield file
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def write_arrays(path: str | PathLike[str], arrays: Arrays) -> None:
    """Write arrays by name to a compressed npz file, with the version of the format.

    What was there before stays until all is written. Raises `ModelError` where there is no such folder.
    """
    own = pathlib.Path(path)
    if not own.parent.is_dir():
        raise ModelError(f"{own} cannot be written: there is no folder {own.parent}; make it first.")
    with whole(own) as file:  # an open file, or numpy would add a suffix
        _write(file, arrays)


def _write(file: BinaryIO, arrays: Arrays) -> None:
    version: dict[str, Any] = {"format": np.array(FORMAT), "sphfilter": np.array(__version__)}
    np.savez_compressed(file, **version | arrays)


def to_bytes(density: ParticleDensity) -> bytes:
    """A density as the bytes of such a file."""
    file = io.BytesIO()
    _write(file, stored(density))
    return file.getvalue()


def from_bytes(content: bytes) -> ParticleDensity:
    """The density of bytes that `to_bytes` made; raises `ModelError` for others."""
    return density_from(load_arrays(io.BytesIO(content)))


def load_arrays(path: str | PathLike[str] | BinaryIO) -> Arrays:
    """Read a file of `write_arrays`; raises `ModelError` if it cannot be read, or is of another format."""
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = dict(file)
    except OSError as problem:
        raise ModelError(f"cannot read {path}: {problem}") from None
    except (ValueError, EOFError, zipfile.BadZipFile):
        raise ModelError(f"cannot read {path}: it is no npz file, or not a whole one") from None
    if int(arrays.get("format", -1)) != FORMAT:
        found = arrays.get("format", "none")
        raise ModelError(f"{path} has format {found}, this version reads {FORMAT}; write it again")
    return arrays
