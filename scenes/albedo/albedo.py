"""Weights of reflectances at each point of a surface: S(x, λ) = Σ_m w_m(x) S_m(λ).

One reflectance with one weight varies in brightness alone. Several are a mixture, whose weights add up to 1; or they
are the three primaries of sRGB, with the samples of a picture as their weights. Wavelengths enter by the S_m alone, so
light transport stays exact in wavelength.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from huesphere.configs import schema
from huesphere.configs import textures as configs
from huesphere.configs.errors import InputError
from huesphere.scenes.albedo.image import LUMINANCE, read_linear
from huesphere.scenes.albedo.patterns import Pattern, pattern
from huesphere.scenes.colour_tables import colour_science
from huesphere.scenes.mesh import Mesh
from huesphere.scenes.spectra import on_grid, reflectance
from huesphere.scenes.view import View

SUM_TOLERANCE = 0.02  # of the weights of a mixture: five steps of 8-bit maps; within it they are scaled to add up to 1


@dataclass(frozen=True)
class Constant:
    """The same value everywhere."""

    value: float


@dataclass(frozen=True)
class Image:
    """Linear samples on the surface, bilinear between the middles of texels, repeated beyond the edges."""

    samples: np.ndarray  # (h, w, C) float32, row 0 at v = 1
    place: np.ndarray | None  # (2, 3): u = place[0] · (x, y, 1), v = place[1] · (x, y, 1); None: u, v are the mesh's


@dataclass(frozen=True)
class VertexColours:
    """The mesh's colours of vertices, linear over each face, times ``mix``."""

    mix: np.ndarray  # (3, C)


@dataclass(frozen=True)
class Channel:
    """A map of C values at each point, and what its values 0 and 1 stand for."""

    source: Constant | Image | VertexColours | Pattern
    low: float = 0.0
    high: float = 1.0


@dataclass(frozen=True)
class Albedo:
    """Weights (M,) of the object's reflectances at each point: the values of the channels one after the other."""

    channels: tuple[Channel, ...]
    rest: int | None  # place of the weight that is 1 − the sum of the others, among the M; None: there is none
    adds_up: bool  # whether the weights must add up to 1
    unit: float  # scene units to one unit of length of the patterns: half the object's width or height
    origin: tuple[float, float]  # x, y of the patterns' origin, scene units


def reflectances_of(surface: schema.Matte) -> list[np.ndarray]:
    """The object's reflectances (W,), in the order of the weights. Raises InputError."""
    if surface.mixture is not None:
        return [reflectance(one.reflectance, where=f"surface.mixture.{i}") for i, one in enumerate(surface.mixture)]
    if surface.srgb is not None:
        return list(srgb_primaries())
    found = [reflectance(surface.reflectance, where="surface.reflectance")]
    if surface.texture is not None:
        low, high = surface.texture.range
        if min(low, high) < 0 or max(low, high) * found[0].max() > 1 + 1e-6:
            got = f"{low:g} to {high:g} times a reflectance of up to {found[0].max():.4g}"
            raise InputError("surface.texture.range", got=got, expected="reflectances from 0 to 1")
    if surface.checker is not None:
        found.append(reflectance(surface.checker.reflectance, where="surface.checker.reflectance"))
    return found


def srgb_primaries() -> np.ndarray:
    """(3, W) reflectances whose mixture by linear R, G and B has that colour under D65; all 1 is white.

    I. Mallett & C. Yuksel, "Spectral primary decomposition for rendering with sRGB reflectance" (2019), as tabulated
    in colour-science.
    """
    table = colour_science().recovery.MSDS_BASIS_FUNCTIONS_sRGB_MALLETT2019
    return np.clip(on_grid(table).T, 0.0, 1.0)


def build_albedo(surface: schema.Matte, mesh: Mesh, view: View) -> Albedo | None:
    """The weights of a config's surface on ``mesh``, the object alone; None if they are the same everywhere.

    Raises InputError for pictures that cannot be read, for maps that need what the shape does not have, and for factors
    with which a reflectance would exceed 1.
    """
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    middle = (low + high) / 2
    unit, origin = float((high - low)[:2].max() / 2), (float(middle[0]), float(middle[1]))
    if surface.texture is not None:
        channel = _channel(surface.texture, mesh, view, "surface.texture", weights=False)
        return Albedo((channel,), None, False, unit, origin)
    if surface.srgb is not None:
        channel = _colours(surface.srgb, mesh, view)
        return Albedo((channel,), None, False, unit, origin)
    if surface.mixture is not None:
        rest = next((i for i, one in enumerate(surface.mixture) if one.weight == "rest"), None)
        channels = tuple(
            _weight(one.weight, mesh, view, f"surface.mixture.{i}.weight")
            for i, one in enumerate(surface.mixture)
            if one.weight != "rest"
        )
        return Albedo(channels, rest, True, unit, origin)
    return None


def _weight(spec: float | str | configs.MapModel, mesh: Mesh, view: View, where: str) -> Channel:
    if isinstance(spec, float):
        if not 0 <= spec <= 1:
            raise InputError(where, got=f"{spec:g}", expected="0 to 1")
        return Channel(Constant(spec))
    assert isinstance(spec, configs.MapModel)
    if min(spec.range) < 0 or max(spec.range) > 1:
        raise InputError(f"{where}.range", got=str(list(spec.range)), expected="weights from 0 to 1")
    return _channel(spec, mesh, view, where, weights=True)


def _channel(spec: configs.MapModel, mesh: Mesh, view: View, where: str, *, weights: bool) -> Channel:
    """A map of one value. ``weights``: whether pictures of whole numbers are taken to be linear."""
    low, high = spec.range
    if isinstance(spec, configs.ImageMap):
        return Channel(_image(spec, mesh, view, where, auto="linear" if weights else "srgb", channels=1), low, high)
    if isinstance(spec, configs.VertexColourMap):
        _require(mesh.colour, "vertex_colours", "colours of vertices", where)
        return Channel(VertexColours(LUMINANCE[:, None]), low, high)
    return Channel(pattern(spec), low, high)  # type: ignore[arg-type]


def _colours(spec: configs.ImageSource | configs.VertexColourSource, mesh: Mesh, view: View) -> Channel:
    """A map of three values, linear R, G and B."""
    if isinstance(spec, configs.ImageSource):
        return Channel(_image(spec, mesh, view, "surface.srgb", auto="srgb", channels=3))
    _require(mesh.colour, "vertex_colours", "colours of vertices", "surface.srgb")
    return Channel(VertexColours(np.eye(3)))


# More than seven parameters: a source with where it lies and how it is read.
def _image(spec: configs.ImageSource, mesh: Mesh, view: View, where: str, *, auto: str, channels: int) -> Image:
    if spec.mapping == "uv":
        _require(mesh.uv, "mapping: uv", "texture coordinates (mapping: front needs none)", where)
    try:
        samples = read_linear(Path(spec.path), encoding=spec.encoding, auto=auto, channels=channels)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    if samples.max() > 1:
        raise InputError(f"{where}: samples", got=f"up to {samples.max():.4g}", expected="0 to 1", where=spec.path)
    width, height = view.width * view.pixel_size, view.height * view.pixel_size
    place = np.array([[1 / width, 0, 0.5], [0, 1 / height, 0.5]]) if spec.mapping == "front" else None
    return Image(samples, place)


def _require(attribute: np.ndarray | None, key: str, what: str, where: str) -> None:
    if attribute is None:
        raise InputError(
            f"{where}: {key}", got=f"a shape without {what.split(' (')[0]}", expected=f"a shape with {what}"
        )
