"""How a config writes what varies over a surface: an image, colours of vertices, or a pattern in space.

Every map has one value at each point of the surface, from 0 to 1; its ``range`` says what 0 and 1 stand for. Patterns
are functions of the position alone, in units of half the object's size. `scenes.albedo` computes them.
"""

from typing import Annotated, Literal

from pydantic import Field

from huesphere.configs.lights import Direction
from huesphere.configs.model import Model
from huesphere.configs.spectra import SpectrumSpec

MOST_INGREDIENTS = 16
LARGEST_PATTERN_SEED = 2**31 - 1
PATTERN_UNIT = "1 is half the object's width or height, whichever is larger"  # of lengths of patterns


class MapModel(Model):
    """What all maps of one value share."""

    range: tuple[float, float] = Field(default=(0.0, 1.0), description="what the map's values 0 and 1 stand for")


class ImageSource(Model):
    """A picture file on the surface: PNG, JPEG, TIFF, EXR or npy."""

    kind: Literal["image"]
    path: str
    mapping: Literal["uv", "front"] = Field(
        default="uv",
        description="uv: by the shape's texture coordinates; front: along the camera's axis, so that it covers the "
        "picture",
    )
    encoding: Literal["auto", "srgb", "linear"] = Field(
        default="auto",
        description="of the samples; auto: float samples and weights are linear, other 8- and 16-bit pictures sRGB",
    )


class ImageMap(MapModel, ImageSource):
    """The luminance of a picture, one channel or three."""


class VertexColourSource(Model):
    """The colours that a mesh file gives its vertices."""

    kind: Literal["vertex_colours"]


class VertexColourMap(MapModel, VertexColourSource):
    """The luminance of the colours of the vertices."""


class NoiseMap(MapModel):
    """Smooth random blotches, of the same statistics everywhere and in all directions."""

    kind: Literal["noise"]
    size: float = Field(default=0.4, gt=0, description=f"of the largest blotches; {PATTERN_UNIT}")
    octaves: int = Field(default=3, ge=1, le=8, description="each with half the size and 0.6 of the amplitude before")
    contrast: float = Field(default=1.0, gt=0, le=20, description="1: values spread about evenly over 0 to 1")
    seed: int = Field(default=0, ge=0, le=LARGEST_PATTERN_SEED)


class StripesMap(MapModel):
    """Parallel stripes, as if the object were cut from a layered block."""

    kind: Literal["stripes"]
    period: float = Field(default=0.3, gt=0, description=f"of one stripe and one gap; {PATTERN_UNIT}")
    direction: Direction = Field(default=(0.0, 1.0, 0.0), description="across the stripes, camera frame, any length")
    sharpness: float = Field(default=1.0, ge=0.1, le=50, description="0.1: a sine; 50: edges of 1 % of the period")


class CracksMap(MapModel):
    """Plates (1) with cracks between them (0): the boundaries of Voronoi cells about random points."""

    kind: Literal["cracks"]
    size: float = Field(default=0.4, gt=0, description=f"of a plate; {PATTERN_UNIT}")
    width: float = Field(default=0.03, gt=0, description=f"of a crack; {PATTERN_UNIT}")
    seed: int = Field(default=0, ge=0, le=LARGEST_PATTERN_SEED)


class DirtMap(MapModel):
    """Ragged patches (0) on a clean ground (1)."""

    kind: Literal["dirt"]
    size: float = Field(default=0.5, gt=0, description=f"of the largest patches; {PATTERN_UNIT}")
    cover: float = Field(default=0.4, gt=0, lt=1, description="share of space that is dirty")
    softness: float = Field(default=0.3, ge=0.01, le=5, description="of the edges of patches")
    seed: int = Field(default=0, ge=0, le=LARGEST_PATTERN_SEED)


MapSpec = Annotated[
    ImageMap | VertexColourMap | NoiseMap | StripesMap | CracksMap | DirtMap, Field(discriminator="kind")
]
ColourMapSpec = Annotated[ImageSource | VertexColourSource, Field(discriminator="kind")]


class Ingredient(Model):
    """One reflectance of a mixture, and its weight at each point of the surface."""

    reflectance: SpectrumSpec
    weight: float | Literal["rest"] | MapSpec = Field(
        default="rest", description="0 to 1, or a map; rest: what the other weights leave of 1"
    )
