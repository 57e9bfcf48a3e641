"""Reflectance that varies over a surface: weights of a few reflectances, by images, colours of vertices or patterns."""
