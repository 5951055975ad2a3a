"""One exponential family: log p is a polynomial in a frame that moves with the density."""
