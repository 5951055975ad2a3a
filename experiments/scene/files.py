"""The TOML files that commands read: found by name or path, and changed key by key with --set."""

import tomllib
from pathlib import Path

from sphfilter.errors import ConfigError, nearest


def file_names(folder):
    """Names of the TOML files in a folder."""
    return sorted(path.stem for path in folder.glob("*.toml"))


def find_file(name, folder, kind):
    """Path of a TOML file: a name in the project's folder, or a path that ends in .toml.

    `kind` is what the files are, for errors: "scenario". Raises `ConfigError` if there is no such file; the
    nearest name is told.
    """
    own = str(name).endswith(".toml")
    path = Path(name) if own else folder / f"{name}.toml"
    if path.is_file():
        return path
    if own:
        raise ConfigError(f"the file {name} does not exist (`list` names those of the project)")
    known = file_names(folder)
    raise ConfigError(f"no {kind} {name!r}{nearest(name, known)}; there are {', '.join(known)}")


def changes_of(args):
    """What --set asks for, values by dotted key."""
    return dict(parse_change(text) for text in args.changes)


def parse_change(text):
    """Key and value of a text "key=value", the value in TOML's syntax or a bare word."""
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise ConfigError(f"a change is key=value, not {text!r}; for instance scheme.kernel=gaussian")
    try:
        return key.strip(), tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return key.strip(), value.strip()


def change(tree, key, value):
    """Set a dotted key of a TOML tree; the settings check it later."""
    parts = key.split(".")
    for i, part in enumerate(parts[:-1]):
        tree = tree.setdefault(part, {})
        if not isinstance(tree, dict):
            raise ConfigError(f"cannot set {key}: {'.'.join(parts[: i + 1])} is a value, not a table")
    tree[parts[-1]] = value
