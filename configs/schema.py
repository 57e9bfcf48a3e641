"""The run configuration: every key, its unit, its range and its default, as validated models.

Keys are named nowhere else; those of spectra and lights are in `configs.spectra` and `configs.lights`.
`render --schema` prints the JSON Schema of these models, for editors.
"""

from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from huesphere.configs.camera_chain import CameraChain
from huesphere.configs.lights import LightSpec
from huesphere.configs.model import Model
from huesphere.configs.photographed import PhotographedLights, Photographs, conflict
from huesphere.configs.spectra import CsvSpectrum, SpectrumSpec
from huesphere.configs.textures import MOST_INGREDIENTS, ColourMapSpec, Ingredient, MapSpec

LARGEST_RATIO = 1_000_000  # of two lengths of one shape
MOST_PIXELS = 2**23  # of a picture that is rendered, 8.4 million: the renderer takes up to 2 kB for each
LARGEST_SEED = 2**63 - 1
MOST_LIGHTS = 256

TransportName = Literal["linear", "direct", "one-bounce", "full"]


# ---- shape ---------------------------------------------------------------------------------------------------------


class Bust(Model):
    """The built-in portrait bust."""

    kind: Literal["bust"]
    detail: int = Field(default=180, ge=32, le=640, description="grid cells across the picture when it is meshed")


class Ball(Model):
    """A whole sphere, the half of it that faces the camera, or one octant of it (x, y, z > 0)."""

    kind: Literal["sphere", "hemisphere", "octant"]
    background: bool = Field(default=False, description="a black plane behind it")
    detail: int = Field(default=128, ge=8, le=1024, description="facets along a quarter of a great circle")


class Ellipsoid(Model):
    kind: Literal["ellipsoid"]
    semi_axes: tuple[float, float, float] = Field(default=(1.0, 0.7, 0.8), description="along x, y, z")
    rotation: tuple[float, float, float] = Field(
        default=(0.0, 0.0, 0.0), description="about x, then y, then z, degrees"
    )
    detail: int = Field(default=128, ge=8, le=1024)

    @field_validator("semi_axes")
    @classmethod
    def _positive(cls, value: tuple[float, float, float]) -> tuple[float, float, float]:
        if min(value) <= 0:
            raise ValueError("every semi-axis must be positive")
        if max(value) > LARGEST_RATIO * min(value):
            raise ValueError(f"the longest semi-axis may be {LARGEST_RATIO:,} times the shortest")
        return value


class VGroove(Model):
    """Two plane walls that meet in a vertical line at the back; the opening faces the camera."""

    kind: Literal["v_groove"]
    angle: float = Field(default=90.0, gt=5, lt=180, description="between the walls, degrees")
    turn: float = Field(default=0.0, ge=-80, le=80, description="of the whole groove about the view axis, degrees")
    detail: int = Field(default=64, ge=2, le=512)


class Bowl(Model):
    """The inside of a spherical cap, open toward the camera."""

    kind: Literal["bowl"]
    opening: float = Field(default=70.0, gt=5, le=90, description="half-angle of the cap, degrees; 90: a half sphere")
    detail: int = Field(default=128, ge=8, le=1024)


class Sculpture(Model):
    """A random solid, convex and concave, with overhangs and holes; each seed gives another one."""

    kind: Literal["sculpture"]
    seed: int = Field(default=0, ge=0, le=LARGEST_SEED, description="of the solid; random: another in each draw")
    detail: int = Field(default=80, ge=24, le=256, description="grid cells along an edge of the cube it is meshed in")
    size: float = Field(default=1.0, ge=0.5, le=2, description="factor of the radii of its parts: slender to stout")
    holes: int = Field(default=1, ge=0, le=8, description="tunnels through it that the camera may look through")
    relief: float = Field(default=0.3, ge=0, le=1, description="bumps and ripples on its surface, from 0 for none")
    rotation: tuple[float, float, float] = Field(
        default=(0.0, 0.0, 0.0), description="about x, then y, then z, degrees; random: any"
    )


class DepthMap(Model):
    """Depth on a grid: npz (depth, mask), npy, EXR, 16-bit PNG or TIFF, text, ESRI ASCII grid or x y z."""

    kind: Literal["depth_map"]
    path: str
    depth_scale: Literal["auto"] | Annotated[float, Field(gt=0)] = Field(
        default="auto",
        description="grid steps per stored unit of depth; auto: 1, or what the spacing that the file states gives",
    )
    toward_camera: bool | None = Field(
        default=None,
        description="whether stored depth grows toward the camera; null: yes, except for the distances of a renderer",
    )
    no_data: Literal["auto", "none"] | float | tuple[float, ...] = Field(
        default="auto",
        description="stored value or values that stand for no surface, beside what is not finite; none: there is none",
    )
    channel: str | None = Field(default=None, description="EXR: the channel that holds the depth, where several might")


class MeshFile(Model):
    """Any mesh that trimesh reads, centred and scaled into the picture."""

    kind: Literal["mesh"]
    path: str
    rotation: tuple[float, float, float] = Field(
        default=(0.0, 0.0, 0.0), description="about x, then y, then z, degrees"
    )
    smooth: float = Field(default=40.0, ge=0, le=180, description="creases sharper than this stay sharp, degrees")


class Markers(Model):
    """Dots on a square lattice over a gel's membrane."""

    spacing: float = Field(default=2.2, gt=0, description="of the lattice, mm")
    radius: float = Field(default=0.4, gt=0, description="of a dot, mm")
    reflectance: SpectrumSpec = 0.03


class IndenterMap(Model):
    """A depth map of an object that is pressed into a gel."""

    path: str
    width: float = Field(default=12.0, gt=0, description="of the whole grid of the depth map, mm")


class Gel(Model):
    """The membrane of a tactile sensor as its camera sees it, pressed by an object. The scene's unit is 1 mm."""

    kind: Literal["gel"]
    size: tuple[Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)]] = Field(
        default=(52.0, 40.0), description="width and height of the membrane, mm"
    )
    indenter: Literal["none", "ball", "key", "screw"] | IndenterMap = Field(
        default="ball", description="what is pressed; none: the membrane at rest"
    )
    diameter: float = Field(default=8.0, gt=0, description="of the ball, the screw's thread or the key's bow, mm")
    press: float = Field(default=1.0, gt=0, description="how far its foremost point is pressed in, mm")
    position: tuple[float, float] = Field(default=(0.0, 0.0), description="of its middle on the membrane, mm")
    turn: float = Field(default=0.0, description="about the view axis, degrees")
    softness: float = Field(default=0.6, gt=0, description="length over which the membrane smooths what touches it, mm")
    markers: Markers | None = Field(default=Markers(), description="null: none")
    detail: int = Field(default=320, ge=16, le=2048, description="grid cells along the membrane's longer side")


ShapeSpec = Annotated[
    Bust | Ball | Ellipsoid | VGroove | Bowl | DepthMap | MeshFile | Sculpture | Gel | Photographs,
    Field(discriminator="kind"),
]
AnyLightSpec = Annotated[LightSpec | PhotographedLights, Field(discriminator="kind")]

# ---- surface, room, camera ---------------------------------------------------------------------------------------


class Checker(Model):
    """A second reflectance, in the black fields of a three-dimensional chess board."""

    reflectance: SpectrumSpec
    size: float = Field(default=0.25, gt=0, description="of a field, scene units")
    by: Literal["face", "vertex"] = Field(
        default="face", description="whole mesh faces, by their centres; or around each vertex, to half way to the next"
    )


PLAIN = "light skin"  # the reflectance where a config names none


class Matte(Model):
    """A matte surface of one reflectance, or of one that varies: at most one of the four keys after it is given."""

    reflectance: SpectrumSpec = PLAIN
    checker: Checker | None = None
    texture: MapSpec | None = Field(default=None, description="factor of the reflectance at each point: one hue")
    mixture: tuple[Ingredient, ...] | None = Field(
        default=None, min_length=2, max_length=MOST_INGREDIENTS, description="reflectances mixed by weights"
    )
    srgb: ColourMapSpec | None = Field(
        default=None, description="colours for a display, up-sampled to reflectances (Mallett & Yuksel 2019)"
    )

    @model_validator(mode="after")
    def _one_way_to_vary(self) -> "Matte":
        """Refuse keys that would not be used."""
        given = [key for key in ("checker", "texture", "mixture", "srgb") if getattr(self, key) is not None]
        if len(given) > 1:
            raise ValueError(f"{given[0]} and {given[1]} exclude each other")
        if given and given[0] in ("mixture", "srgb") and self.reflectance != PLAIN:
            raise ValueError(f"{given[0]} has reflectances of its own, so that reflectance would not be used")
        if self.mixture is not None and sum(one.weight == "rest" for one in self.mixture) > 1:
            raise ValueError("mixture: the weight of one reflectance only may be the rest")
        return self


class Lambertian(Matte):
    kind: Literal["lambertian"] = "lambertian"


class Coated(Matte):
    """A matte base under a rough dielectric coat, which adds a highlight in the colour of the light."""

    kind: Literal["coated"]
    roughness: float = Field(default=0.15, ge=0.01, le=1, description="GGX alpha of the coat")
    index: float = Field(default=1.5, ge=1.01, le=3, description="refractive index of the coat")
    highlight_share: float = Field(
        default=0.05, gt=0, lt=1, description="truth marks pixels where the highlight exceeds this share of the colour"
    )


class OrenNayar(Matte):
    """A matte surface of rough facets (Oren & Nayar 1994), flatter in shading than a Lambertian one."""

    kind: Literal["oren_nayar"]
    sigma: float = Field(default=20.0, ge=0, le=60, description="standard deviation of the facets' slopes, degrees")


SurfaceSpec = Annotated[Lambertian | Coated | OrenNayar, Field(discriminator="kind")]


class Room(Model):
    """A closed box around the object, open to nothing: its walls reflect, each with its own reflectance.

    Centred on the optical axis; the camera stands inside, in front of the object. Sizes in scene units.
    """

    width: float = Field(default=6.0, gt=0)
    height: float = Field(default=6.0, gt=0)
    behind: float = Field(default=1.0, gt=0, description="from the object's hindmost point to the back wall")
    before: float = Field(default=4.0, gt=0, description="from the object's foremost point to the front wall")
    left: SpectrumSpec = 0.5
    right: SpectrumSpec = 0.5
    floor: SpectrumSpec = 0.5
    ceiling: SpectrumSpec = 0.5
    back: SpectrumSpec = 0.5
    front: SpectrumSpec = 0.5
    detail: int = Field(default=24, ge=1, le=256, description="mesh cells along a wall")


class Camera(CameraChain):
    projection: Literal["orthographic", "perspective"] = "orthographic"
    field_of_view: float = Field(default=30.0, gt=0.1, lt=150, description="perspective: across the height, degrees")
    resolution: tuple[Annotated[int, Field(ge=4, le=16384)], Annotated[int, Field(ge=4, le=16384)]] = Field(
        default=(256, 256), description="width, height in pixels"
    )
    view_height: Literal["auto"] | Annotated[float, Field(gt=0)] = Field(
        default="auto", description="height of the picture on the object, in the shape's units"
    )
    pixel: Literal["centre", "area"] = Field(
        default="centre",
        description="shade at the pixel's centre (the pair of the true normal there) or average over its area",
    )
    sensitivity: str | CsvSpectrum = Field(
        default="Nikon 5100 (NPL)", description="name of a camera (below), or a table of wavelength and three values"
    )
    exposure: Literal["auto"] | Annotated[float, Field(gt=0)] = Field(
        default="auto",
        description="factor from the light to samples of full scale 1; auto: the 99.9th percentile of the object's "
        "colours is put at 0.9",
    )
    read_noise: float = Field(default=0.0, ge=0, le=1, description="standard deviation, share of full scale")
    full_well: float | None = Field(default=None, gt=1, le=1e9, description="photo-electrons at full scale")
    bits: int | None = Field(default=None, ge=2, le=24, description="of a sample; null: not quantised")
    black_level: float = Field(default=0.0, ge=0, lt=0.9, description="pedestal under the noise, share of full scale")
    encoding: Literal["linear", "srgb"] = Field(
        default="linear", description="srgb: display-encoded, as a phone would write it"
    )
    seed: int = Field(default=0, ge=0, le=LARGEST_SEED, description="of the camera's noise")

    @field_validator("resolution")
    @classmethod
    def _not_too_many_pixels(cls, value: tuple[int, int]) -> tuple[int, int]:
        if value[0] * value[1] > MOST_PIXELS:
            raise ValueError(f"{value[0] * value[1]:,} pixels, at most {MOST_PIXELS:,} are rendered")
        return value


# ---- what to do ----------------------------------------------------------------------------------------------------


class Render(Model):
    transport: tuple[TransportName, ...] = ("linear", "direct", "one-bounce", "full")
    target_rms: float = Field(default=1e-3, ge=1e-6, le=0.5, description="relative standard error asked for")
    max_bounces: int | None = Field(
        default=None,
        ge=1,
        le=1000,
        description="most reflections of the light in transport full; null: as many as the accuracy needs",
    )
    samples: int = Field(default=256, ge=1, le=1 << 20, description="per pixel, of the reference engine only")
    seed: int = Field(default=0, ge=0, le=LARGEST_SEED, description="of the light transport")

    @field_validator("transport", mode="before")
    @classmethod
    def _one_or_many(cls, value: Any) -> Any:
        return [v.strip() for v in value.split(",")] if isinstance(value, str) else value

    @field_validator("transport")
    @classmethod
    def _some(cls, value: tuple[TransportName, ...]) -> tuple[TransportName, ...]:
        if not value:
            raise ValueError("name at least one transport")
        return tuple(dict.fromkeys(value))


class Recover(Model):
    methods: tuple[str, ...] = ("auto",)
    lights: Literal["unknown", "told"] = Field(
        default="unknown",
        description="told: the picture's header holds where point, sphere and distant lights are, not their colours",
    )


class RunConfig(Model):
    """One item of a run: a shape, its surface, the lights, the camera, and what to do with them."""

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,99}$", description="also the name of its folder")
    shape: ShapeSpec
    surface: SurfaceSpec = Lambertian()
    room: Room | None = None
    lights: tuple[AnyLightSpec, ...] = Field(min_length=1, max_length=MOST_LIGHTS)
    camera: Camera = Camera()
    render: Render = Render()
    recover: Recover = Recover()

    @model_validator(mode="before")
    @classmethod
    def _default_kinds(cls, data: Any) -> Any:
        """`kind` may be left out where there is an obvious one."""
        if not isinstance(data, dict):
            return data
        data = dict(data)
        if isinstance(data.get("surface"), dict):
            data["surface"] = {"kind": "lambertian", **data["surface"]}
        if isinstance(data.get("lights"), list | tuple):
            data["lights"] = [{"kind": "distant", **x} if isinstance(x, dict) else x for x in data["lights"]]
        return data

    @model_validator(mode="after")
    def _lights_can_be_known(self) -> "RunConfig":
        """Places of lights can be given to recovery only where each light has one, and in orthographic pictures."""
        if self.recover.lights == "told":
            kinds = sorted(light.kind for light in self.lights if not light.has_place)
            if kinds:
                raise ValueError(f"recover.lights: the place of a light of kind {kinds[0]!r} cannot be told")
            if self.camera.projection != "orthographic":
                raise ValueError("recover.lights: places can be told of orthographic pictures only")
        return self

    @model_validator(mode="after")
    def _markers_are_on_one_reflectance(self) -> "RunConfig":
        """The markers of a gel are a second reflectance by face, beside which no other way to vary is built."""
        varies = [key for key in ("checker", "texture", "mixture", "srgb") if getattr(self.surface, key) is not None]
        if varies and getattr(self.shape, "markers", None) is not None:
            raise ValueError(f"surface.{varies[0]} and the markers of a gel exclude each other: set shape.markers=null")
        return self

    @model_validator(mode="after")
    def _photographs_are_as_they_are(self) -> "RunConfig":
        defaults = {key: type(self).model_fields[key].default for key in ("surface", "room", "camera", "render")}
        problem = conflict(self, defaults)
        if problem is not None:
            raise ValueError(problem)
        return self
