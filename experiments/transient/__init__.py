"""Transient densities: systems of the papers and of users, against closed forms, grids and many paths."""
