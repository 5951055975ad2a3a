"""One file per scheme; a scheme is four functions: place, rhs, read_out, health."""
