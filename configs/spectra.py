"""How a config writes a spectrum: as a constant, a name, a formula or a file. `scenes.spectra` reads them."""

from typing import Annotated, Any

from pydantic import BeforeValidator, Field

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
