"""What the camera measures: light transport, sensor, ground truth, and the data set on disk."""
