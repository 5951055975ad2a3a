"""Clouds of weighted points: order along a curve, linearised blocks, guided noise, motion, weights.

Points are columns, x (n, N): loops over a state of many points are vector code. Models take rows.
"""
