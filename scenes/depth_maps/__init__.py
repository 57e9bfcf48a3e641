"""Depth maps from files: their formats, the samples that are no surface, and the sign and unit of depth."""
