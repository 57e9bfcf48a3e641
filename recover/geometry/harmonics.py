"""Irradiance as a smooth function of the normal: spherical harmonics, scaled by the response of the clamped cosine.

Under distant light of radiance L(ω) the irradiance of a convex surface is E(n) = ∫ L(ω) max(0, n·ω) dω. The clamped
cosine multiplies the harmonics of L of degree l by A_l: π, 2π/3, π/4, 0, −π/24, 0, π/64 … So nine coefficients a
channel (degrees 0, 1 and 2) hold all but about a percent of E. The basis functions here are the harmonics times |A_l|,
so that the coefficients are, up to sign, those of L itself: a prior on them can treat all degrees alike.

Sources: R. Ramamoorthi and P. Hanrahan, J. Opt. Soc. Am. A 18 (2001) 2448–2459, Eq. (19); R. Basri and D. W. Jacobs,
IEEE TPAMI 25(2) (2003) 218–233.
"""

from math import factorial, pi, sqrt

import numpy as np
from numpy.polynomial import Polynomial
from numpy.polynomial.legendre import Legendre


def clamped_cosine(degree: int) -> float:
    """A_l, the factor by which max(0, cos θ) multiplies harmonics of ``degree`` l; 0 for odd degrees from 3 on."""
    if degree == 1:
        return 2 * pi / 3
    if degree % 2:
        return 0.0
    half = degree // 2
    return (
        2
        * pi
        * (-1) ** (half - 1)
        / ((degree + 2) * (degree - 1))
        * factorial(degree)
        / (2**degree * factorial(half) ** 2)
    )


class Harmonics:
    """The K real orthonormal spherical harmonics of the given ``degrees``, times |A_l|, as polynomials of n.

    With n off the unit sphere the polynomials still have values, and ``at`` returns their gradients in space.
    """

    def __init__(self, degrees: tuple[int, ...]) -> None:
        # Each term is Re or Im of (n1 + i n2)^order times a polynomial in n3: the order, True for Im, the polynomial
        # and its derivative.
        self._terms: list[tuple[int, bool, Polynomial, Polynomial]] = []
        for degree in degrees:
            legendre = Legendre.basis(degree).convert(kind=Polynomial)
            for order in range(degree + 1):
                norm = (2 * degree + 1) / (4 * pi) * factorial(degree - order) / factorial(degree + order)
                scale = sqrt(norm * (2 if order else 1)) * abs(clamped_cosine(degree))
                in_z = scale * (legendre.deriv(order) if order else legendre)
                self._terms += [(order, sine, in_z, in_z.deriv()) for sine in ((False, True) if order else (False,))]

    def __len__(self) -> int:
        return len(self._terms)

    def at(self, n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(values (P, K), gradients (P, K, 3)) at normals (P, 3)."""
        xy = n[:, 0] + 1j * n[:, 1]
        powers = [np.ones(len(n), complex)]
        for _ in range(max(order for order, *_ in self._terms)):
            powers.append(powers[-1] * xy)
        values, gradients = np.empty((len(n), len(self))), np.empty((len(n), len(self), 3))
        for k, (order, sine, in_z, by_z) in enumerate(self._terms):
            factor, derivative = in_z(n[:, 2]), order * powers[max(order - 1, 0)]
            part, by_x, by_y = (
                np.imag(c) if sine else np.real(c) for c in (powers[order], derivative, 1j * derivative)
            )
            values[:, k] = part * factor
            gradients[:, k] = np.stack([by_x * factor, by_y * factor, part * by_z(n[:, 2])], axis=-1)
        return values, gradients
