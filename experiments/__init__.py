"""Experiments: scenarios, the commands that run them, and the only room that draws."""

import os

# The matrices here are tiny: threads inside BLAS take turns at waiting and cost up to ten times the work.
# It must be said before numpy is imported; worker processes inherit it.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
