"""A picture, mask or estimate on disk, and the page about it.

In order: ``picture`` reads any picture as an observation in linear light; ``estimate`` is the record of what a method
found, with its reader and writer; ``page`` draws the HTML page of a picture.
"""
