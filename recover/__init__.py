"""What the picture implies: normals, lights and depth from one colour picture. It never sees ground truth.

A picture walks io → pixels → ellipsoid (with cues) → rotation → lights → interreflection → every_pixel → depth;
``methods`` chooses among these stages, ``run`` applies methods to files, ``cli`` is the command. ``geometry`` serves
all.
"""
