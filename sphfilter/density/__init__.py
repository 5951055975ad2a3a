"""What a filter carries: a density, its answers, its start, its lattices, its storage, its health."""
