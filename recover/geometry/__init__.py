"""Mathematics that knows nothing of pictures: spheres, rays, slopes, rotations, quadratic forms, a grid of depths.

Imports nothing else of ``recover``; every other package may import from here.
"""
