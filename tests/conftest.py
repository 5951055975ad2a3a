"""Tests compile into a cache of their own."""

import os
import tempfile
from pathlib import Path

_folder = Path(tempfile.gettempdir()) / f"sphfilter-test-cache-{os.getuid()}"
os.environ.setdefault("NUMBA_CACHE_DIR", str(_folder))
os.environ.setdefault("NUMBA_NUM_THREADS", "2")
os.environ.setdefault("MPLBACKEND", "Agg")
# The matrices are small: threads only wait for each other, the longer the busier the machine is.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
