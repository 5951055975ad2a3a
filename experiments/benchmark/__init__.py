"""Filters side by side on the same measurements: error against a converged reference, and run time."""
