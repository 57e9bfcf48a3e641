"""Normals from one colour picture: scenes with known normals, their recovery, and how well it went."""
