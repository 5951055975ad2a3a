"""Clouds of weighted points: order along a curve, linearised blocks, guided noise, motion, weights."""
