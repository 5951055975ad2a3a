"""Results as files: rows as CSV, settings as TOML; and what they are known by."""

import hashlib
from contextlib import contextmanager

import tomli_w

from sphfilter.density import storage
from sphfilter.files.write import write_csv


def digest(text):
    """Sixteen digits that a text is known by."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def unfinished(out, settings):
    """Folder where finished parts wait until all are there: another one for other settings, a text."""
    return out / f"unfinished-{digest(settings)[:8]}"


@contextmanager
def whole(path):
    """Open a file as `storage.whole` does; folders are made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with storage.whole(path) as file:
        yield file


def write_rows(path, rows):
    """Write flat dicts as CSV; the columns are those of the first."""
    write_csv(path, list(rows[0]), ([row[name] for name in rows[0]] for row in rows))


def write_toml(path, settings):
    """Write settings (dicts, lists and values), without those that are None."""
    path.write_text(tomli_w.dumps(_without_none(settings)), encoding="utf-8")


def _without_none(tree):
    if isinstance(tree, dict):
        return {k: _without_none(v) for k, v in tree.items() if v is not None}
    return [_without_none(v) for v in tree] if isinstance(tree, list | tuple) else tree
