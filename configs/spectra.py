"""How a config writes a spectrum: as a constant, a name, a formula or a file. `scenes.spectra` reads them."""

import re
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field

from huesphere.configs.model import Model


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
    """A number in quotes, where a number may stand, is the number that it looks like."""
    if isinstance(value, str):
        if value.lower() in ("yes", "no", "on", "off"):
            raise ValueError("expected a number or a name")
        try:
            return float(value)
        except ValueError:
            return value
    return value


SpectrumSpec = Annotated[
    float | str | GaussianSpectrum | BlackbodySpectrum | DaylightSpectrum | CsvSpectrum,
    BeforeValidator(_number_written_as_text),
]

# ---- emitters ------------------------------------------------------------------------------------------------------

LEAST_TEMPERATURE = 100.0  # a constant from here on looks like a temperature in K: emitters are scaled to mean 1


def _no_bare_temperature(value: SpectrumSpec) -> SpectrumSpec:
    """Refuse 6500 or "6500 K" for an emitter, which would be a constant spectrum, or an unknown name."""
    kelvin = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*K\s*", value) if isinstance(value, str) else None
    number = float(kelvin[1]) if kelvin else value
    if isinstance(number, float) and (kelvin or number >= LEAST_TEMPERATURE):
        raise ValueError(
            f"a colour temperature is written {{daylight: {number:g}}} or {{blackbody: {number:g}}}, "
            "a constant spectrum is written 1"
        )
    return value


EmitterSpec = Annotated[SpectrumSpec, AfterValidator(_no_bare_temperature)]
