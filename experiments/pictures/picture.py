"""What a picture is: figures, and sentences that say what they show."""

from typing import NamedTuple

__all__ = ["Picture"]


class Picture(NamedTuple):
    """Figures by file stem, and sentences that say what they show."""

    figures: dict
    sentences: tuple
