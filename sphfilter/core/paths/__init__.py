"""Clouds of weighted points along random paths: normals in bulk, step lengths, blocks of paths, weights."""
