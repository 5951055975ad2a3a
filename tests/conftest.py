"""Tests compile into a cache of their own: a kernel edited in one file leaves its cached caller stale."""

import os
import tempfile
from pathlib import Path

os.environ.setdefault("NUMBA_CACHE_DIR", str(Path(tempfile.gettempdir()) / f"sphfilter-numba-{os.getuid()}"))
os.environ.setdefault("NUMBA_NUM_THREADS", "2")
os.environ.setdefault("MPLBACKEND", "Agg")
