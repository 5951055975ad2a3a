"""Campaigns on disk: a manifest, one file a finished run, and the whole result in one file.

A file appears under its name only when it is complete, so an interruption leaves finished runs and nothing
half-written.
"""

import hashlib
import json
import platform
import re
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import fields, is_dataclass
from importlib.metadata import PackageNotFoundError, version
from os import PathLike
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from .._version import __version__
from ..density.storage import whole
from ..errors import CampaignError, ConfigError
from . import one_run
from .identity import code_digest, text_of

_MANIFEST = "manifest.json"
_BY_DEFAULT = re.compile(r"\bdefault=\('[^)]*\), ")


def manifest(scenario: Any, filters: Mapping[str, Any], seed: int, first_case: str) -> dict[str, Any]:
    """Describe a campaign, so that its runs are never mixed with those of another.

    A scenario and a factory are known by their text (``repr``), or by their code and the values of all that
    it refers to. `first_case` is the digest of run 0, which tells scenarios apart whose text does not.
    """
    return {
        "seed": seed,
        "scenario": {"name": scenario.name, "text": text_of(scenario)},
        "filters": {name: text_of(make) for name, make in filters.items()},
        "versions": versions(),
        "digest of run 0": first_case,
    }


def versions() -> dict[str, str]:
    """Versions of what results come from, by name; what is not installed is left out."""
    found = {"sphfilter": f"{__version__} ({code_digest()})", "python": platform.python_version()}
    for name in ("numpy", "numba", "scipy", "filterpy"):
        with suppress(PackageNotFoundError):
            found[name] = version(name)
    return found


def case_digest(case: Any) -> str:
    """Return a digest of all numbers of a case."""
    digest = hashlib.sha256()
    for array in one_run.arrays_of(case).values():
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:16]


def claim(folder: str | PathLike[str], wanted: dict[str, Any]) -> None:
    """Write the manifest into a new folder, or make sure that the one that is there is the same."""
    path = Path(folder) / _MANIFEST
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        with _whole(path) as file:
            file.write(json.dumps(wanted, indent=1).encode())
        return
    found = _read(path)
    for key, value in wanted.items():
        sides = _sides(key, found.get(key), value)
        if sides[0] == sides[1]:
            continue
        names = [list(side) if isinstance(side, dict) else None for side in sides]
        if names[0] != names[1]:
            was, now = (", ".join(side or ["none"]) for side in names)
            difference = f"{key} are {was}, now they are {now}"
        else:
            was, now = _difference(*(_leaves(side) for side in sides))
            difference = f"{key} is {was}, now it is {now}"
        raise ConfigError(
            f"{folder} holds another campaign: its {difference}. Give another folder, or delete this one."
        )


def _read(path: Path) -> dict[str, Any]:
    try:
        return dict(json.loads(path.read_text()))
    except ValueError:
        raise ConfigError(f"{path} cannot be read. Give another folder, or delete it.") from None


def opened(folder: str | PathLike[str]) -> tuple[dict[str, Any], list[Path]]:
    """The manifest of a folder, and the files of its finished runs, in the order of the runs."""
    path = Path(folder) / _MANIFEST
    if not path.exists():
        raise ConfigError(f"{folder} is no folder of a campaign: it has no {_MANIFEST}")
    paths = [run for run in sorted(path.parent.glob("run_*.npz")) if _readable(run)]
    if not paths:
        raise CampaignError(f"no run of the campaign in {folder} is finished")
    return _read(path), paths


def _sides(key: str, was: Any, now: Any) -> tuple[Any, Any]:
    """Settings of a folder and those that are wanted, as far as they are compared.

    A package that was not there, or is no more, had or has no part in the filters: their texts are the same.
    Which filters a scenario runs by default is no part of it: the manifest names those that were run.
    """
    if key == "versions" and isinstance(was, dict):
        both = [name for name in now if name in was]
        return {name: was[name] for name in both}, {name: now[name] for name in both}
    if key in ("scenario", "filters") and isinstance(was, dict):
        was, now = ({name: _BY_DEFAULT.sub("", text) for name, text in side.items()} for side in (was, now))
    return was, now


def _leaves(value: object) -> str:
    return ", ".join(f"{k} {v}" for k, v in value.items()) if isinstance(value, dict) else str(value)


def _difference(*texts: str, width: int = 80) -> list[str]:
    """Return two texts, cut to the neighbourhood of their first difference."""
    first = next((i for i, pair in enumerate(zip(*texts, strict=False)) if len(set(pair)) > 1), 0)
    start = max(0, first - width // 2)
    return [
        ("..." if start else "") + text[start : start + width] + ("..." if len(text) > start + width else "")
        for text in texts
    ]


def _path(folder: str | PathLike[str], r: int) -> Path:
    return Path(folder) / f"run_{r:05d}.npz"


def finished(folder: str | PathLike[str], n_runs: int) -> dict[int, Path]:
    """Return the files of the runs below `n_runs` that are done, by run."""
    return {r: _path(folder, r) for r in range(n_runs) if _readable(_path(folder, r))}


def _readable(path: Path) -> bool:
    """Whether a run's file can be read: one that a full disk or a power cut spoilt is made again."""
    return path.exists() and zipfile.is_zipfile(path)


def write_run(folder: str | PathLike[str], r: int, record: dict[str, Any]) -> Path:
    """Write one run: nested dictionaries of arrays, and its failures. Returns the file."""
    path = _path(folder, r)
    _save(path, record, plain=("failures",))
    return path


def save_result(result: Any, path: str | PathLike[str]) -> None:
    """Write a CampaignResult to one ``.npz`` file."""
    _save(Path(path), _tree(result), plain=("scenario", "seed", "t0", "failures"))


def _tree(value: Any) -> Any:
    if is_dataclass(value):
        found = {f.name: getattr(value, f.name) for f in fields(value)}
        return {name: _tree(part) for name, part in found.items() if part is not None}
    return {k: _tree(v) for k, v in value.items()} if isinstance(value, dict) else value


def _save(path: Path, values: dict[str, Any], plain: Sequence[str]) -> None:
    """Write nested dictionaries of arrays; their shape and the `plain` values go in as JSON text."""
    arrays: list[Any] = []

    def number(node: Any) -> Any:
        if isinstance(node, dict):
            return {key: number(child) for key, child in node.items()}
        arrays.append(np.asarray(node))
        return len(arrays) - 1

    tree = number({key: value for key, value in values.items() if key not in plain})
    index = json.dumps({"tree": tree, "plain": {key: values[key] for key in plain}})
    named: dict[str, Any] = {f"a{i}": a for i, a in enumerate(arrays)}
    with _whole(path) as file:
        np.savez_compressed(file, index=index, **named)


def load(path: str | PathLike[str]) -> dict[str, Any]:
    """Read what `write_run` or `save_result` wrote; filter results and failures as dictionaries and lists."""
    with np.load(path) as data:
        index = json.loads(str(data["index"]))

        def value(node: Any) -> Any:
            return {k: value(v) for k, v in node.items()} if isinstance(node, dict) else data[f"a{node}"]

        return value(index["tree"]) | index["plain"]


@contextmanager
def _whole(path: Path) -> Iterator[BinaryIO]:
    """Open a file as `whole` does; raises `CampaignError`."""
    try:
        with whole(path) as file:
            yield file
    except OSError as problem:
        raise CampaignError(
            f"{path} could not be written ({problem}); what was finished before is kept"
        ) from problem
