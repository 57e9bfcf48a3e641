"""Pictures of any size: F, lights and surface are found on a reduced picture, then each pixel's normal from its colour.

``picture`` makes the small picture by means over blocks of pixels; ``normals`` takes its estimate back to the size
of the picture. ``recover.methods.calling`` decides, for every method, whether a picture is large enough for that.
"""
