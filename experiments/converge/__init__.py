"""Accuracy studies: filters against exact ones, transient densities against closed forms and grids."""
