"""Light that parts of the surface send each other: how much there is (``albedo``), and the picture without it
(``removal``).
"""
