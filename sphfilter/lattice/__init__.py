"""Where particles lie, arrays only: level sets, regular lattices, closing in on a posterior."""
