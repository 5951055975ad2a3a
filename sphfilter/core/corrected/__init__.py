"""Moment-corrected SPH: whitened kernel sums whose velocity field obeys the moment equations."""
