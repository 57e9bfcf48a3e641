"""Hints on the rotation that need no light and no derivative of noisy data.

``linear_integrability`` scores rotations by integrability in a form that is linear in them; ``silhouette`` reads the
rotation off the object's outline; ``convexity`` chooses between a surface and the same surface turned inside out.
"""
