"""The steps of a real camera between its lens and its files: their keys and three presets. Each step is off by default.

What they do is in `render.sensor` (up to the raw picture) and `render.developing` (from there to the picture for eyes).
"""

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from huesphere.configs.model import Model

Gain = Annotated[float, Field(gt=0)]
Triple = tuple[float, float, float]


class CameraChain(Model):
    """Keys of ``camera`` beyond geometry, sensitivity, exposure and noise."""

    preset: Literal["phone", "machine vision", "dslr"] | None = Field(
        default=None,
        description="a kind of camera, which gives the keys of the chain and of the noise that are not set",
    )
    blur: float = Field(default=0.0, ge=0, le=100, description="standard deviation of the point spread, pixels")
    vignetting: float = Field(default=0.0, ge=0, lt=1, description="share of the light that the corners lose")
    filter_array: Literal["RGGB", "BGGR", "GRBG", "GBRG"] | None = Field(
        default=None, description="colour filters of the four pixels at the top left; null: three sensors"
    )
    demosaicing: Literal["bilinear", "Malvar 2004", "Menon 2007"] = Field(
        default="Malvar 2004", description="how missing colours are interpolated behind a filter array"
    )
    response_spread: float = Field(
        default=0.0, ge=0, le=0.5, description="standard deviation of the pixels' gains (photo-response non-uniformity)"
    )
    dark_spread: float = Field(
        default=0.0, ge=0, le=0.5, description="standard deviation of the pixels' offsets, share of full scale"
    )
    pattern_seed: int = Field(
        default=0,
        ge=0,
        le=2**63 - 1,
        description="of gains and offsets, which are the same in all pictures of a sensor",
    )
    raw: bool = Field(default=False, description="also write raw.dng, the samples before demosaicing")
    develop: bool = Field(default=False, description="also write the developed picture, developed.jpg or developed.png")
    white_balance: Literal["none", "daylight", "grey world"] | tuple[Gain, Gain, Gain] = Field(
        default="none", description="of the developed picture: gains of red, green and blue"
    )
    colour_matrix: Literal["none", "fitted"] | tuple[Triple, Triple, Triple] = Field(
        default="none", description="of the developed picture: to linear sRGB; fitted: least squares over wavelengths"
    )
    tone_curve: Literal["none", "srgb", "film"] = Field(
        default="srgb", description="of the developed picture; film: an S-curve, then that of sRGB"
    )
    jpeg_quality: int | None = Field(
        default=None, ge=1, le=100, description="of the developed picture; null: a PNG, without loss"
    )

    @model_validator(mode="before")
    @classmethod
    def _with_preset(cls, data: Any) -> Any:
        """Keys that are not written have the values of the preset."""
        if isinstance(data, dict) and isinstance(data.get("preset"), str):
            return PRESETS.get(data["preset"], {}) | data
        return data


PRESETS: dict[str, dict[str, Any]] = {
    # Orders of magnitude of each class, not of one model: small pixels and strong processing; an industrial camera with
    # a global shutter and little processing; a large sensor with a good lens.
    "phone": {
        "blur": 0.6,
        "vignetting": 0.35,
        "filter_array": "RGGB",
        "response_spread": 0.01,
        "dark_spread": 5e-4,
        "read_noise": 1e-3,
        "full_well": 6000,
        "bits": 10,
        "black_level": 1 / 16,
        "raw": True,
        "develop": True,
        "white_balance": "grey world",
        "colour_matrix": "fitted",
        "tone_curve": "film",
        "jpeg_quality": 85,
    },
    "machine vision": {
        "blur": 0.4,
        "vignetting": 0.15,
        "filter_array": "RGGB",
        "demosaicing": "bilinear",
        "response_spread": 5e-3,
        "dark_spread": 2e-4,
        "read_noise": 6e-4,
        "full_well": 11_000,
        "bits": 12,
        "black_level": 1 / 64,
        "raw": True,
        "develop": True,
        "white_balance": "daylight",
    },
    "dslr": {
        "blur": 0.5,
        "vignetting": 0.25,
        "filter_array": "RGGB",
        "demosaicing": "Menon 2007",
        "response_spread": 3e-3,
        "dark_spread": 5e-5,
        "read_noise": 1e-4,
        "full_well": 50_000,
        "bits": 14,
        "black_level": 1 / 16,
        "raw": True,
        "develop": True,
        "white_balance": "daylight",
        "colour_matrix": "fitted",
        "tone_curve": "film",
        "jpeg_quality": 95,
    },
}
