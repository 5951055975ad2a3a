"""Tests compile into a cache of their own, named by the sources.

Numba notices a change of the file a function stands in, not of the files it calls into: a kernel edited
elsewhere would leave a cached caller stale.
"""

import hashlib
import os
import tempfile
from pathlib import Path

_ROOT = Path(__file__).parent.parent


def _source_hash():
    sources = [p for room in ("sphfilter", "reference_filters") for p in sorted((_ROOT / room).rglob("*.py"))]
    return hashlib.sha256(b"".join(p.read_bytes() for p in sources)).hexdigest()[:12]


_folder = Path(tempfile.gettempdir()) / f"sphfilter-test-cache-{os.getuid()}-{_source_hash()}"
os.environ.setdefault("NUMBA_CACHE_DIR", str(_folder))
os.environ.setdefault("NUMBA_NUM_THREADS", "2")
os.environ.setdefault("MPLBACKEND", "Agg")
# The matrices are small: threads only wait for each other, the longer the busier the machine is.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
