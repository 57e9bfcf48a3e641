"""Objects of one hue whose brightness varies from place to place: ρ = a(x) F n, with the albedo a free at every pixel.

``curl`` measures how far the directions Gρ, G = F⁻¹, are from those of a surface, and ``albedo`` what G makes of the
albedo; ``fit`` weighs both against the template of the silhouette (``recover.cues``) and finds G.
"""
