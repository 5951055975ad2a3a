"""One file per scheme: how a density is carried through the Fokker-Planck-Kolmogorov equation."""
