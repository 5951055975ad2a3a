"""Results as files: rows as CSV, records as JSON, settings as TOML; and what they are known by."""

import csv
import hashlib
import json
import os
from contextlib import contextmanager

import numpy as np
import tomli_w

__all__ = ["digest", "digest_of_files", "unfinished", "whole", "write_csv", "write_json", "write_rows",
           "write_toml"]  # fmt: skip


def digest(text):
    """Sixteen digits that a text is known by."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def digest_of_files(files):
    """Sixteen digits that the contents of files, one after the other, are known by."""
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]


def unfinished(out, settings):
    """Folder where finished parts wait until all are there: another one for other settings, a text."""
    return out / f"unfinished-{digest(settings)[:8]}"


@contextmanager
def whole(path):
    """Open a binary file to write to, which appears at `path` when all is written; folders are made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    with open(part, "wb") as file:
        yield file
    os.replace(part, path)


def write_csv(path, heading, rows):
    """Write a line of names and the rows below it; the folder is made if it is not there."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([heading, *rows])


def write_rows(path, rows):
    """Write flat dicts as CSV; the columns are those of the first."""
    write_csv(path, list(rows[0]), ([row[name] for name in rows[0]] for row in rows))


def write_json(path, record):
    """Write a record of plain values; numbers that are not finite become null."""
    text = json.dumps(_without_nan(record), indent=1, allow_nan=False)
    path.write_text(text, encoding="utf-8")


def write_toml(path, settings):
    """Write settings (dicts, lists and values), without those that are None."""
    path.write_text(tomli_w.dumps(_without_none(settings)), encoding="utf-8")


def _without_nan(tree):
    if isinstance(tree, dict):
        return {k: _without_nan(v) for k, v in tree.items()}
    if isinstance(tree, list | tuple):
        return [_without_nan(v) for v in tree]
    return None if isinstance(tree, float) and not np.isfinite(tree) else tree


def _without_none(tree):
    if isinstance(tree, dict):
        return {k: _without_none(v) for k, v in tree.items() if v is not None}
    return [_without_none(v) for v in tree] if isinstance(tree, list | tuple) else tree
