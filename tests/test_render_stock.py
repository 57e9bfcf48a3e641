"""The stock spectral path tracer on scenes of every kind: worst pixel by t statistic, mean to parts in a thousand."""

import numpy as np
import pytest
from stock import require_equal_to_stock

from huesphere.configs.load import load_config
from huesphere.render.picture import assemble
from huesphere.render.transport import trace
from huesphere.scenes.build import build_scene

pytestmark = pytest.mark.slow

BOWL = "shape={kind: bowl, opening: 75, detail: 48}"
TWO_LIGHTS = "lights=[{direction: [0.3,0.2,1], spectrum: FL2}, {direction: [-0.3,0.2,1], spectrum: A}]"
ROOM = (
    "room={left: red, right: green, ceiling: white 9.5 (.05 D), floor: blue, back: 0.5, front: 0.6,"
    " width: 5, height: 5, detail: 24}"
)
SCENES = {
    "concave": [BOWL, "surface.reflectance=0.9", TWO_LIGHTS],
    "rectangle": [
        BOWL,
        "surface.reflectance=0.8",
        "lights=[{kind: rectangle, position: [0.5,0.3,1.5], edge_u: [0.6,0,0], edge_v: [0,-0.6,0], spectrum: A}]",
    ],
    "ball of light": [
        "shape={kind: v_groove, angle: 80, detail: 32}",
        "lights=[{kind: sphere, position: [1.6,0.2,2.2], radius: 0.4, spectrum: D65}]",
    ],
    "point": [BOWL, "lights=[{kind: point, position: [0.3,0.2,1.0], spectrum: FL2}]"],
    "sky": [
        BOWL,
        "surface.reflectance=0.8",
        "lights=[{kind: sky, up: [0.3,1,0.2], zenith: {daylight: 15000}, horizon: FL2, ground: A}]",
    ],
    "perspective": [BOWL, "surface.reflectance=orange", "camera.projection=perspective", TWO_LIGHTS],
    "two materials by vertex": [
        BOWL,
        "surface={reflectance: orange, checker: {reflectance: blue sky, size: 0.3, by: vertex}}",
        TWO_LIGHTS,
    ],
    "two materials": [BOWL, "surface={reflectance: orange, checker: {reflectance: blue sky, size: 0.3}}", TWO_LIGHTS],
    "room": [
        "shape={kind: sphere, detail: 96}",
        "surface.reflectance=0.7",
        ROOM,
        "lights=[{kind: point, position: [0,1.5,1.5], spectrum: D65}]",
    ],
    "coat": [
        "shape={kind: ellipsoid, detail: 96}",
        "surface={kind: coated, reflectance: light skin, roughness: 0.3}",
        TWO_LIGHTS,
    ],
    "coat, ball of light": [
        "shape={kind: ellipsoid, detail: 96}",
        "surface={kind: coated, reflectance: light skin, roughness: 0.3}",
        "lights=[{kind: sphere, position: [0.8,0.2,2.2], radius: 0.5, spectrum: D65}]",
    ],
    "coat, sky": [
        "shape={kind: ellipsoid, detail: 96}",
        "surface={kind: coated, reflectance: light skin, roughness: 0.3}",
        "lights=[{kind: sky, up: [0.3,1,0.2], zenith: {daylight: 15000}, horizon: FL2, ground: A}]",
    ],
    "rough matte": [
        "shape={kind: ellipsoid, detail: 96}",
        "surface={kind: oren_nayar, reflectance: orange, sigma: 30}",
        TWO_LIGHTS,
    ],
    "textured coat": [
        "shape={kind: ellipsoid, detail: 96}",
        "surface={kind: coated, mixture: [{reflectance: orange, weight: {kind: noise, size: 1}}, {reflectance: 0.2}]}",
        TWO_LIGHTS,
    ],
    "coat, rectangle": [
        "shape={kind: ellipsoid, detail: 96}",
        "surface={kind: coated, reflectance: light skin, roughness: 0.3}",
        "lights=[{kind: rectangle, position: [0.5,0.3,2], edge_u: [0.8,0,0], edge_v: [0,-0.8,0], spectrum: A}]",
    ],
}


@pytest.mark.parametrize("name", SCENES)
def test_equal_to_the_stock_path_tracer_within_its_noise(mi, name):
    overrides = ["camera.pixel=area", "camera.resolution=[32,32]", *SCENES[name]]
    scene = build_scene(load_config("sphere_quick", overrides=overrides))
    require_equal_to_stock(mi, scene, "direct" if scene.coat else "full")


def test_a_room_by_its_walls_is_the_room_by_rays(mi):
    # The same room as part of the mesh, traced by hemispheres that meet walls like any surface.
    from dataclasses import replace

    from huesphere.scenes.primitives import join

    overrides = ["camera.resolution=[24,24]", *SCENES["room"], "shape={kind: bowl, opening: 60, detail: 32}"]
    scene = build_scene(load_config("sphere_quick", overrides=overrides))
    plain = replace(scene, mesh=join([scene.mesh, scene.enclosure.mesh()]), enclosure=None)
    pictures = []
    for each in (scene, plain):
        traced = trace(each, mi, reach="full", target_rms=3e-3, max_bounces=None, seed=0, progress=lambda *_: None)
        pictures.append(assemble(each, traced, "full").colour[traced.pixels.row, traced.pixels.col])
    difference = np.sqrt(np.mean(((pictures[0] - pictures[1]) / pictures[1].mean(axis=0)) ** 2))
    assert difference < 3 * 3e-3
    assert pictures[0].mean(axis=0) == pytest.approx(pictures[1].mean(axis=0), rel=4e-3)
