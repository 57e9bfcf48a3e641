"""The run configuration: every key, its unit, its range and its default, as validated models.

The models are the one place where keys are named; `configs/schema.json` is their JSON Schema, for editors.
"""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, field_validator, model_validator

TransportName = Literal["linear", "direct", "one-bounce", "full"]


class Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


# ---- spectra -------------------------------------------------------------------------------------------------------


class GaussianBand(Model):
    """A band ``peak · exp(−(λ − centre)² / 2σ²)``."""

    centre: float = Field(gt=200, lt=2000, description="nm")
    sigma: float = Field(gt=0, le=1000, description="nm")
    peak: float = Field(default=1.0, gt=0)


class GaussianSpectrum(Model):
    gaussian: GaussianBand


class BlackbodySpectrum(Model):
    blackbody: float = Field(ge=500, le=100_000, description="colour temperature, K")


class DaylightSpectrum(Model):
    daylight: float = Field(ge=4000, le=25_000, description="correlated colour temperature of CIE daylight, K")


class CsvSpectrum(Model):
    csv: str = Field(description="two columns: wavelength in nm, value; relative to the config")


def _number_written_as_text(value: Any) -> Any:
    """YAML 1.1 reads 1e-3 as text; where a number may stand, take it as the number it is."""
    if isinstance(value, str):
        try:
            return float(value)
        except ValueError:
            return value
    return value


SpectrumSpec = Annotated[
    float | str | GaussianSpectrum | BlackbodySpectrum | DaylightSpectrum | CsvSpectrum,
    BeforeValidator(_number_written_as_text),
]

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


class DepthMap(Model):
    """Depth on a grid: npz (depth, mask), npy, EXR, 16-bit PNG or plain text; one sample = one unit of depth."""

    kind: Literal["depth_map"]
    path: str
    depth_scale: float = Field(default=1.0, gt=0, description="grid steps per stored unit of depth")
    toward_camera: bool = Field(default=True, description="stored depth grows toward the camera")


class MeshFile(Model):
    """Any mesh that trimesh reads, centred and scaled into the picture."""

    kind: Literal["mesh"]
    path: str
    rotation: tuple[float, float, float] = Field(
        default=(0.0, 0.0, 0.0), description="about x, then y, then z, degrees"
    )
    smooth: float = Field(default=40.0, ge=0, le=180, description="creases sharper than this stay sharp, degrees")


ShapeSpec = Annotated[
    Bust | Ball | Ellipsoid | VGroove | Bowl | DepthMap | MeshFile,
    Field(discriminator="kind"),
]

# ---- surface, lights, camera ---------------------------------------------------------------------------------------


class Lambertian(Model):
    kind: Literal["lambertian"] = "lambertian"
    reflectance: SpectrumSpec = "light skin"


def _not_null(value: tuple[float, float, float]) -> tuple[float, float, float]:
    if sum(v * v for v in value) == 0:
        raise ValueError("a direction may not be (0, 0, 0)")
    return value


class DistantLight(Model):
    kind: Literal["distant"] = "distant"
    direction: tuple[float, float, float] = Field(description="toward the light, camera frame, any length")
    spectrum: SpectrumSpec = "D65"
    intensity: float = Field(default=1.0, ge=0)

    _direction = field_validator("direction")(classmethod(lambda cls, v: _not_null(v)))


class Camera(Model):
    projection: Literal["orthographic"] = "orthographic"
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
    sensitivity: str | CsvSpectrum = "Nikon 5100 (NPL)"
    exposure: Literal["auto"] | Annotated[float, Field(gt=0)] = "auto"
    read_noise: float = Field(default=0.0, ge=0, le=1, description="standard deviation, share of full scale")
    full_well: float | None = Field(default=None, gt=1, description="photo-electrons at full scale")
    bits: int | None = Field(default=None, ge=2, le=24)
    seed: int = Field(default=0, ge=0, description="of the camera's noise")


# ---- what to do ----------------------------------------------------------------------------------------------------


class Render(Model):
    transport: tuple[TransportName, ...] = ("linear", "direct", "one-bounce", "full")
    target_rms: float = Field(default=1e-3, ge=1e-6, le=0.5, description="relative standard error asked for")
    max_bounces: int | None = Field(default=None, ge=1, le=1000)
    samples: int = Field(default=256, ge=1, le=1 << 20, description="per pixel, of the reference engine only")
    seed: int = Field(default=0, ge=0, description="of the light transport")

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
    methods: tuple[str, ...] = ("drew-kontsevich", "weak-integrability")


class RunConfig(Model):
    """One item of a run: a shape, its surface, the lights, the camera, and what to do with them."""

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,99}$", description="also the name of its folder")
    shape: ShapeSpec
    surface: Lambertian = Lambertian()
    lights: tuple[DistantLight, ...] = Field(min_length=1)
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
