"""From colours to the ellipsoid ρᵀCρ = 1 of the pixels that see every light (report 2.1–2.2).

Where half the object sees every light: ``fit`` (Least Median of Squares, on ``normal_equations`` with ``quartic_sums``
and ``noise_bias``), then ``refit`` by ``distance``. Where fewer do: ``from_patches`` takes ``candidates`` that grow
(``region_growing``), refits the leading ones (``hidden_lights``, ``membership``) and chooses one (``selection``).
Beside these: ``free_centre`` (the report's ambient term, 3.6), ``lack_of_fit`` (is the residual a function of the
normal?), ``specular`` (highlights as outliers).
"""
