"""From rotated normals N = Ĝρ to normals n = Rᵀ N: the rotation that makes them a surface.

``closed_form`` is the report's (3.1–3.4); ``alternation`` its untried variant (3.5); ``weak_form`` asks for
integrability without derivatives of noisy data; ``tangents`` fits a depth on a grid of cells, for noisy pictures.
"""
