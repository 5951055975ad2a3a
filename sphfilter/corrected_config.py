from .config import CorrectedScheme  # noqa: F401
