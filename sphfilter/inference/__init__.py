"""Whole records: states smoothed, parameters fitted, models compared."""
