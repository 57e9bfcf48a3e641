"""Pictures of any size: what is global is found on a reduced picture, and every pixel then follows from its own colour.

``picture`` makes the small picture by means over blocks of pixels; ``normals`` takes its estimate back to the size
of the picture. ``recover.methods.calling`` decides, for every method, whether a picture is large enough for that.
"""
