"""The numba core: arrays in, arrays out, in the letters of the papers."""
