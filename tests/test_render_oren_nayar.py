"""The rough matte surface: the formula as it is published, its limit, and the moon that has no dark rim."""

import numpy as np
import pytest

from huesphere.configs.load import load_config
from huesphere.render.oren_nayar import oren_nayar_bsdf
from huesphere.render.picture import assemble
from huesphere.render.spectral import linear_model
from huesphere.render.transport import trace
from huesphere.scenes.build import build_scene


def published(theta_i, theta_r, azimuth, sigma):
    """The qualitative model of Oren & Nayar (1994) at albedo 1, times the cosine; angles in radians."""
    a = 1 - 0.5 * sigma**2 / (sigma**2 + 0.33)
    b = 0.45 * sigma**2 / (sigma**2 + 0.09)
    large, small = max(theta_i, theta_r), min(theta_i, theta_r)
    return (a + b * max(0, np.cos(azimuth)) * np.sin(large) * np.tan(small)) * np.cos(theta_i) / np.pi


def test_it_is_the_published_formula_and_directions_may_change_places(mi):
    surface = oren_nayar_bsdf(mi, 25.0, {"type": "spectrum", "value": 1.0})
    rng = np.random.default_rng(0)
    theta, azimuth = rng.uniform(0.01, 1.5, (2, 64)), rng.uniform(-np.pi, np.pi, (2, 64))
    vectors = np.stack([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)], axis=1)
    interaction = mi.SurfaceInteraction3f()
    interaction.wavelengths = 550.0
    values = []
    for toward, view in ((0, 1), (1, 0)):
        interaction.wi = mi.Vector3f(vectors[view].astype(np.float32))
        outgoing = mi.Vector3f(vectors[toward].astype(np.float32))
        values.append(np.array(surface.eval(mi.BSDFContext(), interaction, outgoing))[0] / np.cos(theta[toward]))
    expected = [published(*theta[:, k], azimuth[0, k] - azimuth[1, k], np.radians(25)) for k in range(64)]
    assert values[0] == pytest.approx(expected / np.cos(theta[0]), rel=1e-3)
    assert values[0] == pytest.approx(values[1], rel=1e-3)  # Helmholtz


def picture(mi, surface):
    settings = ["camera.resolution=[24,24]", "shape={kind: sphere, detail: 32}", f"surface={surface}"]
    scene = build_scene(load_config("sphere_quick", overrides=[*settings, "lights=[{direction: [0,0,1]}]"]))
    traced = trace(scene, mi, reach="direct", target_rms=0.1, max_bounces=None, seed=0, progress=lambda *_: None)
    return scene, traced.pixels.points.normal, assemble(scene, traced, "direct", mi).colour[traced.mask()]


def test_without_roughness_it_is_lambertian(mi):
    _, _, matte = picture(mi, "{reflectance: 0.5}")
    _, _, smooth = picture(mi, "{kind: oren_nayar, reflectance: 0.5, sigma: 0}")
    assert smooth == pytest.approx(matte, rel=1e-4)


def test_a_full_moon_is_flat_and_is_not_said_to_obey_the_linear_model(mi):
    scene, normal, rough = picture(mi, "{kind: oren_nayar, reflectance: 0.5, sigma: 40}")
    _, _, matte = picture(mi, "{reflectance: 0.5}")
    rim = (normal[:, 2] > 0.2) & (normal[:, 2] < 0.5)
    middle = normal[:, 2] > 0.9
    assert rough[rim].mean() / rough[middle].mean() > 1.3 * matte[rim].mean() / matte[middle].mean()
    assert linear_model(scene) is None
