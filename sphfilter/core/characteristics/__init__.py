"""The log-density carried from lattice to lattice along weighted, backward characteristics."""
