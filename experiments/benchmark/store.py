"""Rows on disk: one small file for each competitor and run, written as soon as it is measured."""

import json
from functools import cache
from pathlib import Path

import reference_filters
import sphfilter
from experiments.show.files import whole
from sphfilter.campaign.identity import digest_of_files


@cache
def code_digest():
    """A digest of the source of library and reference filters: rows of other code are measured again."""
    folders = (Path(package.__file__).parent for package in (sphfilter, reference_filters))
    return digest_of_files(path for folder in folders for path in sorted(folder.rglob("*.py")))


class Rows:
    """Measured rows by scenario, competitor and run, in a folder."""

    def __init__(self, folder):
        self._folder = folder

    def read(self, scenario, key, run, made_of):
        """The row, or None if it is not there or was made of something else."""
        path = self._path(scenario, key, run)
        if not path.exists():
            return None
        row = json.loads(path.read_text(encoding="utf-8"))
        return row if row.pop("made_of") == made_of else None

    def write(self, scenario, key, run, made_of, row):
        """Keep a row."""
        with whole(self._path(scenario, key, run)) as file:
            file.write(json.dumps({"made_of": made_of} | row).encode())

    def _path(self, scenario, key, run):
        return self._folder / scenario / f"{key}-run{run}.json"
