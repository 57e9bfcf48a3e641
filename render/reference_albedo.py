"""Reflectance that varies over the surface, for the reference engine: a texture in front of Mitsuba's own functions.

Images are Mitsuba's `bitmap`, colours of vertices its `mesh_attribute`; what is added here is only their mean, weighted
with the spectra. Patterns are the functions that the other engine evaluates too.
"""

import functools
from types import ModuleType
from typing import Any

import numpy as np

from huesphere.render.backend import require_vectorised
from huesphere.scenes.albedo.albedo import Albedo, Constant, Image, VertexColours
from huesphere.scenes.build import Scene

VERTEX_ATTRIBUTE = "vertex_weight_{}"  # of the Mitsuba mesh, by the number of the channel's value


def albedo_texture(mi: ModuleType, scene: Scene, spectrum: Any) -> Any:
    """The reflectance of the object as a Mitsuba texture; ``spectrum`` makes the dictionary of a spectrum (W,).

    Raises InputError in a scalar variant.
    """
    require_vectorised(mi, "the reference engine has varying reflectance")
    assert scene.albedo is not None
    texture = _texture_class(mi, mi.variant())(mi.Properties())
    texture.albedo = scene.albedo
    texture.spectra = [mi.load_dict(spectrum(s)) for s in scene.reflectances[scene.is_object]]
    texture.sources = [
        [_nested(mi, channel.source, k) for k in range(_count(channel.source))] for channel in scene.albedo.channels
    ]
    return texture


def vertex_attributes(scene: Scene) -> dict[str, np.ndarray]:
    """Mesh attributes (V, 1) that the texture reads, by their names."""
    if scene.albedo is None or scene.mesh.colour is None:
        return {}
    mixes = [c.source.mix for c in scene.albedo.channels if isinstance(c.source, VertexColours)]
    return {_attribute(mix, k): scene.mesh.colour @ mix[:, k : k + 1] for mix in mixes for k in range(mix.shape[1])}


def _attribute(mix: np.ndarray, number: int) -> str:
    """The name of the attribute for one value of a channel: luminance, or one of three colours."""
    return VERTEX_ATTRIBUTE.format("luminance" if mix.shape[1] == 1 else "rgb"[number])


def _count(source: Any) -> int:
    """Number of values of a channel."""
    if isinstance(source, Image):
        return int(source.samples.shape[2])
    return int(source.mix.shape[1]) if isinstance(source, VertexColours) else 1


def _nested(mi: ModuleType, source: Any, number: int) -> Any:
    """One value of a channel as a Mitsuba texture; a pattern or constant as itself."""
    if isinstance(source, Image):
        samples = np.ascontiguousarray(source.samples[..., number : number + 1])
        options = {"raw": True, "filter_type": "bilinear", "wrap_mode": "repeat"}
        return mi.load_dict({"type": "bitmap", "bitmap": mi.Bitmap(samples), **options})
    if isinstance(source, VertexColours):
        return mi.load_dict({"type": "mesh_attribute", "name": _attribute(source.mix, number)})
    return source


@functools.cache
def _texture_class(mi: ModuleType, variant: str) -> type:
    """The texture as a class of the variant that is set."""
    import drjit as dr

    base: Any = mi.Texture

    class Mixture(base):
        """Σ_m w_m S_m(λ)."""

        def __init__(self, properties: Any) -> None:
            super().__init__(properties)
            self.albedo: Albedo | None = None
            self.spectra: list[Any] = []
            self.sources: list[list[Any]] = []

        def weights(self, si: Any, active: Any) -> list[Any]:
            albedo = self.albedo
            assert albedo is not None
            out = []
            for channel, nested in zip(albedo.channels, self.sources, strict=True):
                values = [self._value(source, channel.source, si, active) for source in nested]
                out += [channel.low + (channel.high - channel.low) * value for value in values]
            if albedo.rest is not None:
                out.insert(albedo.rest, dr.maximum(1 - sum(out), 0))
            total = sum(out)
            return [w / total for w in out] if albedo.adds_up else out

        def _value(self, nested: Any, source: Any, si: Any, active: Any) -> Any:
            if isinstance(source, Constant):
                return mi.Float(source.value)
            if isinstance(source, Image):
                at = mi.SurfaceInteraction3f(si)
                if source.place is not None:
                    (a, b, c), (d, e, f) = source.place.tolist()
                    at.uv = mi.Point2f(a * si.p.x + b * si.p.y + c, d * si.p.x + e * si.p.y + f)
                at.uv = mi.Point2f(at.uv.x, 1 - at.uv.y)  # Mitsuba's v grows downward in the picture
                return nested.eval_1(at, active)
            if isinstance(source, VertexColours):
                return nested.eval_1(si, active)
            assert self.albedo is not None
            x, y = self.albedo.origin
            at = (si.p - mi.Vector3f(x, y, 0)) / self.albedo.unit
            return nested.value(mi, dr, at)

        def eval(self, si: Any, active: Any = True) -> Any:
            total: Any = mi.UnpolarizedSpectrum(0.0)
            for weight, spectrum in zip(self.weights(si, active), self.spectra, strict=True):
                total = total + weight * spectrum.eval(si, active)
            return total & active

        def mean(self) -> Any:
            return mi.Float(0.5)  # only steers Mitsuba's choice between lobes

        def is_spatially_varying(self) -> bool:
            return True

        def to_string(self) -> str:
            return "Mixture[]"

    return Mixture
