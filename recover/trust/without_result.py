"""What stands for the result of a test that has too few pixels: as bad as can be, the same in every test."""

LARGEST_DEG = 90.0
FEWEST = 50  # pixels, for a test to have a result
