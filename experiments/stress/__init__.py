"""Where do the filters break? A grid of hard cells, each with a verdict against a named reference."""
