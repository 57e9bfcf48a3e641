"""Spectra and cameras: known numbers, laws, and refusals."""

import numpy as np
import pytest

from huesphere.configs.errors import InputError
from huesphere.configs.load import load_config
from huesphere.configs.spectra import CsvSpectrum, GaussianBand, GaussianSpectrum
from huesphere.scenes.cameras import NAMES, sensitivity
from huesphere.scenes.spectra import VISIBLE, WAVELENGTHS, emission, reflectance, table_ends


@pytest.mark.parametrize("name", ["A", "B", "C", "D65", "FL2", "FL12", "LED-B3"])
def test_emitters_have_mean_one_over_the_visible(name):
    assert emission(name)[VISIBLE].mean() == pytest.approx(1.0)


def test_illuminant_a_is_the_blackbody_it_is_defined_as():
    # CIE 15: illuminant A is Planck's law at 2848 K with c2 = 1.435e-2 m K, that is 2855.5 K with today's c2.
    from huesphere.configs.spectra import BlackbodySpectrum

    planck = emission(BlackbodySpectrum(blackbody=2855.5))
    assert np.abs(planck / emission("A") - 1)[VISIBLE].max() < 2e-3


def test_light_skin_has_the_published_value():
    # ISO 17321-1, light skin at 600 nm.
    import colour

    table = colour.SDS_COLOURCHECKERS["ISO 17321-1"]["light skin"]
    assert reflectance("light skin")[WAVELENGTHS == 600][0] == pytest.approx(table[600.0])


def test_gaussian_band_has_its_width():
    band = emission(GaussianSpectrum(gaussian=GaussianBand(centre=550, sigma=20)))
    mean = np.average(WAVELENGTHS, weights=band)
    assert mean == pytest.approx(550, abs=1e-6)
    assert np.sqrt(np.average((WAVELENGTHS - mean) ** 2, weights=band)) == pytest.approx(20, rel=1e-4)


def test_a_number_is_a_constant_reflectance():
    assert (reflectance(0.8) == 0.8).all()


@pytest.mark.parametrize("bad", [1.2, -0.1, "light skim"])
def test_impossible_reflectances_are_refused(bad):
    with pytest.raises(InputError):
        reflectance(bad)


def test_unknown_illuminant_suggests_the_nearest():
    with pytest.raises(InputError, match="did you mean 'D65'"):
        emission("D66")


def test_csv_is_linear_between_its_points_and_keeps_its_end_values_beyond(tmp_path):
    path = tmp_path / "lamp.csv"
    path.write_text("wavelength, power\n# a comment\n500, 0\n600, 1\n")
    values = emission(CsvSpectrum(csv=str(path)))
    assert values[WAVELENGTHS == 550][0] / values[WAVELENGTHS == 600][0] == pytest.approx(0.5)
    assert (values[WAVELENGTHS > 600] == values[WAVELENGTHS == 600]).all()
    assert (values[WAVELENGTHS < 500] == 0).all()


def test_a_grey_card_measured_over_part_of_the_spectrum_is_grey_beyond_it_and_the_log_says_so(tmp_path):
    (tmp_path / "grey.csv").write_text("430 0.4\n650 0.4\n")
    (tmp_path / "band.csv").write_text("500 0\n550 1\n600 0\n")
    spec = CsvSpectrum(csv=str(tmp_path / "grey.csv"))
    assert (reflectance(spec) == 0.4).all()
    lamp = f"lights.0.spectrum={{csv: {tmp_path / 'band.csv'}}}"
    config = load_config("sphere_quick", overrides=[f"surface.reflectance={{csv: {spec.csv}}}", lamp])
    (line,) = table_ends(config)  # the band ends with 0: nothing of it is carried on
    assert "grey.csv" in line
    assert "430 nm" in line
    assert "650 nm" in line


@pytest.mark.parametrize(
    "text", ["", "400 1 2\n500 1 2\n", "500 1\n400 1\n", "4.0e-7 1\n7.0e-7 1\n", "400 nan\n700 1\n"]
)
def test_bad_csv_is_refused(tmp_path, text):
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(InputError):
        emission(CsvSpectrum(csv=str(path)))


@pytest.mark.parametrize("name", NAMES)
def test_camera_has_three_channels_that_see(name):
    curves = sensitivity(name)
    assert curves.shape == (len(WAVELENGTHS), 3)
    assert curves.min() >= 0
    assert (curves.sum(axis=0) > 0).all()


def test_unknown_camera_is_refused():
    with pytest.raises(InputError, match="unknown camera"):
        sensitivity("Sony DXC-151")
