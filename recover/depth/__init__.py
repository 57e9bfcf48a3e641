"""Depth from normals, and normals from a depth that is fitted to the picture.

``integration`` turns normals with gaps into depth (report 2.4); ``joint_fit`` fits one depth a pixel and F to the
colours together; ``smoothness_prior`` takes the noise out of what that leaves.
"""
