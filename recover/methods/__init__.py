"""The methods by name (``table``), and the steps that they are made of.

A picture goes through usable pixels → ellipsoid → root → rotation → convex or concave → normals and uncertainty.
``auto`` and its first ellipsoid (``initial``) decide which steps a picture calls for; ``near_lights`` serves pictures
whose header gives the positions of near lights.
"""
