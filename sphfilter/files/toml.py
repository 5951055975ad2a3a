"""The tree of a TOML file."""

import tomllib
from os import PathLike
from pathlib import Path
from typing import Any

from ..errors import ConfigError


def read_toml(path: str | PathLike[str]) -> dict[str, Any]:
    """Read the tree of a TOML file; raises `ConfigError`."""
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as problem:
        raise ConfigError(f"cannot read {path}: {problem.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as problem:
        raise ConfigError(f"{path} is not valid TOML: {problem}") from None
