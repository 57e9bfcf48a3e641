"""What the picture implies: surface normals from one colour picture. Never sees ground truth."""
