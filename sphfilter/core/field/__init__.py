"""The log-density between the nodes of a lattice: cells, and polynomials fitted around each node."""
