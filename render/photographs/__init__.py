"""Photographs of one object under one light each: read from the folders in which data sets publish them, and mixed."""
