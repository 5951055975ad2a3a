"""Settings: frozen, keyword-only dataclasses that check their values and name the nearest valid key."""

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, TypeVar, dataclass_transform, get_args, get_origin

from pydantic import ConfigDict, Field, ValidationError
from pydantic.dataclasses import dataclass as checked_dataclass

from .errors import ConfigError, nearest

Positive = Annotated[float, Field(gt=0)]
Count = Annotated[int, Field(ge=1)]
_UNKNOWN = ("unexpected_keyword_argument", "extra_forbidden")
_TYPES = ("float", "int", "str", "constrained-int", "constrained-float")

Made = TypeVar("Made")


@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(Field,))
def settings(cls: type[Made]) -> type[Made]:
    """Make `cls` a frozen, keyword-only dataclass whose errors are a `ConfigError` in one sentence."""
    strict = ConfigDict(extra="forbid", allow_inf_nan=False, strict=False)
    checked: Any = checked_dataclass(frozen=True, kw_only=True, config=strict)(cls)
    plain_init = checked.__init__

    def __init__(self: Any, *places: Any, **values: Any) -> None:
        if places:
            first = next(field.name for field in fields(checked) if field.name != "name")
            raise TypeError(f"{cls.__name__} takes its settings by name, such as {cls.__name__}({first}=...)")
        try:
            plain_init(self, **values)
        except ValidationError as problem:
            raise ConfigError(_sentence(checked, problem, checked.__name__)) from None

    __init__.__wrapped__ = plain_init  # type: ignore[attr-defined]
    checked.__init__ = __init__
    return checked


def read_toml(path: str | PathLike[str]) -> dict[str, Any]:
    """Read the tree of a TOML file; raises `ConfigError`."""
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as problem:
        raise ConfigError(f"cannot read {path}: {problem.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as problem:
        raise ConfigError(f"{path} is not valid TOML: {problem}") from None


def from_table(cls: type[Made], table: Mapping[str, Any], source: str | PathLike[str] = "") -> Made:
    """Make settings, of a class that `settings` made, from a table read from a file or a command line.

    The errors, `ConfigError`, start with `source`, such as the file's name, and name keys as the table does.
    """
    made = object.__new__(cls)
    try:
        cls.__init__.__wrapped__(made, **table)  # type: ignore[attr-defined]
    except ValidationError as problem:
        told = _sentence(cls, problem)
        raise ConfigError(f"{source}: {told}" if source else told) from None
    return made


def _sentence(cls: type, problem: ValidationError, name: str = "") -> str:
    return "; ".join(dict.fromkeys(_explain(cls, error, name) for error in problem.errors()))


def _explain(cls: type, error: Any, name: str) -> str:
    *above, last = error["loc"] or ("",)
    path = [str(part) for part in above if not _is_type(part)]
    path += [str(last)] if error["type"] in _UNKNOWN or (last != "" and not _is_type(last)) else []
    where = ".".join([name, *path] if name else path) or "the table"
    if error["type"] in _UNKNOWN:
        allowed = [f.name for f in fields(_settings_at(cls, path[:-1]))]
        return f"unknown key {where}{nearest(path[-1], allowed)}; valid keys are {', '.join(allowed)}"
    if error["type"] in ("missing", "missing_argument", "missing_keyword_only_argument"):
        return f"{where} is missing"
    if error["type"] == "value_error":
        told = str(error["ctx"]["error"])
        return f"{where}: {told}" if name or path else told
    said = error["msg"].replace("a valid tuple", "a list")
    return f"{where} = {error.get('input')!r} is not valid: {said[0].lower()}{said[1:]}"


def _is_type(part: object) -> bool:
    """Pydantic's name of one of the types that a value may have, between the keys of an error."""
    return isinstance(part, str) and ("[" in part or part in _TYPES)


def _settings_at(cls: Any, path: Iterable[str]) -> Any:
    """Follow the keys of an error down to the settings class they belong to."""
    for part in path:
        found = {f.name: f.type for f in fields(cls)}.get(part)
        candidates = [found, *get_args(found)] if get_origin(found) else [found]
        cls = next((c for c in candidates if is_dataclass(c)), cls)
    return cls
