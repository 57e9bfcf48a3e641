"""Meshes from files: their formats, polygons as triangles, and faces turned to one side."""
