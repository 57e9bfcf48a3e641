"""Integrability of the *direction* of Gρ, in weak form, over its own noise: the albedo cancels.

A surface of one hue and of any brightness has ρ = a F n. With G = F⁻¹ (rows g1, g2, g3) the slopes p = −g1·ρ / g3·ρ and
q = −g2·ρ / g3·ρ do not depend on a, and the curls Σ (p φ_y − q φ_x) over smooth bumps φ vanish
(``recover.rotation.weak_form``). No derivative of noisy data is taken. A curl is divided by the standard deviation that
it would have if the unit colour d had independent noise: else flat surfaces, whose slopes are small, and steep ones,
whose slopes are bounded, would win. The curls leave the generalised bas-relief ambiguity (P. N. Belhumeur, D. J.
Kriegman & A. L. Yuille, IJCV 35, 1999): three numbers, which other cues must fix.

With u1 = g1·d, u2 = g2·d, h = (g3 − x g1 − y g2)·d, (x, y) the pixel's ray and 0 for parallel ones, and
i = h / (h² + ε²) for 1/h, j = di/dh: p = −u1 i, and noise δ of d changes p by a_p·δ with
a_p = −i g1 − u1 j (g3 − x g1 − y g2).
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from huesphere.recover.rotation.weak_form import TestFunctions

EDGE_ON = 0.03  # ε: the component toward the camera below which a slope is bounded


@dataclass(frozen=True)
class ColourCurl:
    """The curls of K bumps over P pixels, as functions of G."""

    functions: TestFunctions
    directions: np.ndarray  # (P, 3) unit colours d
    ray: np.ndarray  # (P, 2) of the pixels; 0 for parallel rays
    yy: sparse.csr_array  # (K, P) φ_y², and the other two products
    xy: sparse.csr_array
    xx: sparse.csr_array
    moments: np.ndarray  # (3, 3) second moments of d over the pixels

    @staticmethod
    def of(functions: TestFunctions, directions: np.ndarray, ray: np.ndarray | None) -> "ColourCurl":
        """Of the pixels' unit colours (P, 3) and rays (P, 2), None for parallel ones."""
        ray = np.zeros((len(directions), 2)) if ray is None else ray
        phi_x, phi_y = functions.phi_x, functions.phi_y
        return ColourCurl(
            functions,
            directions,
            ray,
            phi_y.power(2),
            phi_x * phi_y,
            phi_x.power(2),
            directions.T @ directions / len(directions),
        )

    def residual(self, G: np.ndarray) -> np.ndarray:
        """Curls (K,) over their standard deviation, for noise of d of deviation 1, in the gauge of ``gauged``."""
        at = _Slopes.at(self, self.gauged(G))
        return self._curl(at) / np.sqrt(self._variance(at))

    def gauged(self, G: np.ndarray) -> np.ndarray:
        """The bas-relief transform of G (3, 3) that leans to no side and is as deep as a ball; G itself in perspective.

        A bas-relief transformation z' = λ z + μ x + ν y multiplies every curl by λ, but their standard deviation by
        another factor. In one gauge the curls say nothing of λ, μ, ν, as they should; in perspective, where these are
        no ambiguity, they are left alone. Second moments over the pixels: g3·d is uncorrelated with g1·d and g2·d, and
        their mean square is that of g3·d, as over a half ball.
        """
        if self.ray.any():
            return G
        Q = G @ self.moments @ G.T
        flat = G[:2] - np.outer(Q[:2, 2] / Q[2, 2], G[2])
        across = np.trace(flat @ self.moments @ flat.T)
        return np.vstack([flat * np.sqrt(Q[2, 2] / across), G[2]])

    def jacobian(self, G: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(residual (K,), its derivative (K, 9) by the elements of G in rows)."""
        at = _Slopes.at(self, self.gauged(G))
        curl, variance = self._curl(at), self._variance(at)
        phi_x, phi_y = self.functions.phi_x, self.functions.phi_y
        d_curl = phi_y @ at.slope_by_G(0) - phi_x @ at.slope_by_G(1)
        d_variance = self.yy @ (2 * at.gain_by_G(0, at.a[0])) + self.xx @ (2 * at.gain_by_G(1, at.a[1]))
        d_variance -= 2 * (self.xy @ (at.gain_by_G(0, at.a[1]) + at.gain_by_G(1, at.a[0])))
        root = np.sqrt(variance)
        by_gauged = d_curl / root[:, None] - d_variance * (curl / (2 * variance * root))[:, None]
        return curl / root, by_gauged @ self._gauge_by_G(G)

    def _gauge_by_G(self, G: np.ndarray) -> np.ndarray:
        """Derivative (9, 9) of ``gauged``, by central differences: it is a function of nine numbers alone."""
        step = 1e-6 * np.linalg.norm(G)
        moved = [(self.gauged(G + e) - self.gauged(G - e)).ravel() for e in step * np.eye(9).reshape(9, 3, 3)]
        return np.stack(moved, axis=1) / (2 * step)

    def _curl(self, at: "_Slopes") -> np.ndarray:
        return self.functions.curl(-at.u[0] * at.i, -at.u[1] * at.i)

    def _variance(self, at: "_Slopes") -> np.ndarray:
        """Σ |φ_y a_p − φ_x a_q|² (K,)."""
        p, q = at.a
        found = self.yy @ (p * p).sum(1) + self.xx @ (q * q).sum(1) - 2 * (self.xy @ (p * q).sum(1))
        return np.maximum(found, 1e-300)  # type: ignore[no-any-return]


@dataclass(frozen=True)
class _Slopes:
    """What the curls need of the pixels, under one G; names as in the module's docstring."""

    d: np.ndarray  # (P, 3)
    G: np.ndarray  # (3, 3)
    u: tuple[np.ndarray, np.ndarray]  # (P,) each
    h_by_g: np.ndarray  # (P, 3) derivative of h by g1·d, g2·d, g3·d: (−x, −y, 1)
    i: np.ndarray  # (P,) bounded 1/h
    j: np.ndarray  # (P,) di/dh
    k: np.ndarray  # (P,) dj/dh
    toward: np.ndarray  # (P, 3) g3 − x g1 − y g2
    a: tuple[np.ndarray, np.ndarray]  # (P, 3) each: derivative of p and of q by d

    @staticmethod
    def at(curl: ColourCurl, G: np.ndarray) -> "_Slopes":
        d = curl.directions
        h_by_g = np.column_stack([-curl.ray, np.ones(len(d))])
        u, toward = d @ G.T, h_by_g @ G
        h = (toward * d).sum(axis=1)
        square = h * h + EDGE_ON**2
        i, j = h / square, (EDGE_ON**2 - h * h) / square**2
        k = (2 * h**3 - 6 * h * EDGE_ON**2) / square**3
        first, second = (-i[:, None] * G[m] - (u[:, m] * j)[:, None] * toward for m in (0, 1))
        return _Slopes(d, G, (u[:, 0], u[:, 1]), h_by_g, i, j, k, toward, (first, second))

    def slope_by_G(self, m: int) -> np.ndarray:
        """Derivative (P, 9) of p (m = 0) or q (m = 1) by the elements of G, in rows."""
        by_g = -(self.u[m] * self.j)[:, None] * self.h_by_g
        by_g[:, m] -= self.i
        return _outer(by_g, self.d)

    def gain_by_G(self, m: int, v: np.ndarray) -> np.ndarray:
        """Derivative (P, 9) of a_p·v (m = 0) or a_q·v (m = 1) by the elements of G, in rows, for fixed v (P, 3)."""
        along, toward = v @ self.G[m], (v * self.toward).sum(axis=1)
        by_g = -(along * self.j + toward * self.u[m] * self.k)[:, None] * self.h_by_g
        by_g[:, m] -= toward * self.j
        by_axis = -(self.u[m] * self.j)[:, None] * self.h_by_g
        by_axis[:, m] -= self.i
        return _outer(by_g, self.d) + _outer(by_axis, v)


def _outer(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(P, 9) products of the components of a (P, 3) and b (P, 3)."""
    return (a[:, :, None] * b[:, None, :]).reshape(len(a), 9)
