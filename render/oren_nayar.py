"""The rough matte surface of M. Oren & S. K. Nayar, "Generalization of Lambert's reflectance model" (1994).

V-shaped facets whose slope angles have the standard deviation σ (radians; ``sigma_deg`` in degrees), each a Lambertian
surface. This is the qualitative model of the paper, without light between facets, so that it is linear in the
reflectance S:

    f = S/π (A + B max(0, cos Δφ) sin α tan β),
    A = 1 − σ² / (2 (σ² + 0.33)),   B = 0.45 σ² / (σ² + 0.09),

α and β the larger and the smaller angle of the directions from the normal, Δφ the angle between their azimuths.
"""

import functools
from types import ModuleType
from typing import Any

import numpy as np

from huesphere.render.backend import require_vectorised


def oren_nayar_bsdf(mi: ModuleType, sigma_deg: float, reflectance: Any) -> Any:
    """The surface as a scattering function of Mitsuba; ``reflectance`` is a Mitsuba texture or its dictionary.

    ``mi`` is the Mitsuba module with a variant set, ``sigma_deg`` is σ in degrees. Raises InputError in a scalar
    variant.
    """
    require_vectorised(mi, "surface.kind: oren_nayar is rendered")
    surface = _bsdf_class(mi, mi.variant())(mi.Properties())
    square = np.radians(sigma_deg) ** 2
    surface.a, surface.b = float(1 - 0.5 * square / (square + 0.33)), float(0.45 * square / (square + 0.09))
    surface.reflectance = mi.load_dict(reflectance) if isinstance(reflectance, dict) else reflectance
    return surface


@functools.cache
def _bsdf_class(mi: ModuleType, variant: str) -> type:
    """The scattering function as a class of the variant that is set.

    Directions are sampled with a density proportional to the cosine of their angle from the normal.
    """
    import drjit as dr

    base: Any = mi.BSDF

    class OrenNayar(base):
        def __init__(self, properties: Any) -> None:
            super().__init__(properties)
            flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
            self.m_components = [flags]
            self.m_flags = flags
            self.a, self.b = 1.0, 0.0
            self.reflectance: Any = None

        def _front(self, si: Any, wo: Any, active: Any) -> Any:
            return active & (mi.Frame3f.cos_theta(si.wi) > 0) & (mi.Frame3f.cos_theta(wo) > 0)

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> tuple[Any, Any]:
            sampled = mi.BSDFSample3f()
            sampled.wo = mi.warp.square_to_cosine_hemisphere(sample2)
            sampled.pdf = mi.warp.square_to_cosine_hemisphere_pdf(sampled.wo)
            sampled.eta = 1.0
            sampled.sampled_type = +self.m_flags
            sampled.sampled_component = 0
            front = self._front(si, sampled.wo, active) & (sampled.pdf > 0)
            value = self.eval(ctx, si, sampled.wo, front)
            return sampled, dr.select(front, value / dr.maximum(sampled.pdf, 1e-30), 0)

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            cos_i, cos_o = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(wo)
            across = dr.maximum(dr.dot(si.wi, wo) - cos_i * cos_o, 0)  # sin θi sin θo cos Δφ
            factor = self.a + self.b * across / dr.maximum(dr.maximum(cos_i, cos_o), 1e-6)
            value = self.reflectance.eval(si, active) * (factor * cos_o / dr.pi)
            return dr.select(self._front(si, wo, active), value, 0)

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return dr.select(self._front(si, wo, active), mi.warp.square_to_cosine_hemisphere_pdf(wo), 0)

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> tuple[Any, Any]:
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

        def to_string(self) -> str:
            return "OrenNayar[]"

    return OrenNayar
