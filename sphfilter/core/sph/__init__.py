"""Smoothed particle hydrodynamics as published: kernels, neighbours, sums over them, the march (002, 001)."""
