"""Whether an estimate is to be believed: evidence from the picture, its weighing, the verdict, the stated errors.

``evidence`` collects the figures, with ``outline`` (agreement with the silhouette), ``alternatives`` (how firmly
integrability holds the rotation) and ``hollow`` (convex or concave by interreflection); ``factors`` turns them into
credibilities; ``stated_error`` gives every pixel its error; ``verdict`` puts all together, for every method.
"""
