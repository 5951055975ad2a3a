"""What users keep in files: models, sensors and starts as TOML, measurements as CSV.

The modules of settings import neither numba nor sympy: what is wrong with a file is said at once.
"""
