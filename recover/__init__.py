"""What the picture implies: normals, lights and depth from one colour picture. It never sees ground truth.

A picture walks io → pixels → ellipsoid (with cues) → rotation → lights → interreflection → every_pixel → depth;
``trust`` judges the result; ``methods`` chooses among these stages; ``full_size`` lets them work on a reduced picture
of a large one; ``run`` applies methods to files, ``cli`` is the command. ``geometry`` serves all.
"""
