"""Says which lights hardly reach what the camera sees, and why; refuses a picture that nothing lights."""

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.render.transport import Transport
from huesphere.scenes.build import Scene
from huesphere.scenes.extent import projected
from huesphere.scenes.lights.source import Light

HARDLY = 0.1  # share of the object's pixels: a light that reaches fewer is named


def faint_lights(scene: Scene, traced: Transport) -> list[str]:
    """A line for each light that reaches less than a tenth of the pixels of the object, with the likely reason.

    Lights that shine from behind are named also if they reach more, where no light shines from the front.
    """
    direct = traced.images[:, :, 0].mean(axis=0)
    reached, facing = (direct > 0).mean(axis=1), (traced.facing > 0).mean(axis=1)
    on = [bool(light.spectrum.max() > 0) for light in scene.lights]
    behind = [_shines_from_behind(light) for light in scene.lights]
    all_behind = any(on) and all(b for b, shines in zip(behind, on, strict=True) if shines)
    lines = []
    for i, light in enumerate(scene.lights):
        if on[i] and (reached[i] < HARDLY or all_behind):
            why = _why(light, scene, traced, hidden=reached[i] < HARDLY <= facing[i])
            share = f"{reached[i]:.0%} of" if reached[i] > 0 else "nothing of"
            lines.append(f"{_named(i, light)} reaches {share} the object that the camera sees: {why}")
    return lines


def require_light(scene: Scene, traced: Transport, colour: np.ndarray) -> None:
    """Raise InputError, which names the first light that should shine, if the picture ``colour`` (H, W, 3) is black."""
    if (colour[traced.mask()] > 0).any():
        return
    shining = [i for i, light in enumerate(scene.lights) if light.spectrum.max() > 0]
    if not shining:
        raise InputError("nothing is lit", got="lights of intensity 0 only", expected="a light that shines")
    lines = faint_lights(scene, traced)
    if lines:
        more = f" (and {len(lines) - 1} more lights)" if len(lines) > 1 else ""
        raise InputError(f"no light reaches the object: {lines[0]}{more}")
    raise InputError(
        "the picture is black, although light reaches the object",
        expected="spectra of lights, surface and camera that have wavelengths in common",
    )


def _named(number: int, light: Light) -> str:
    """A light as the truth file calls it, with its kind and place."""
    place = ""
    if light.known_direction is not None:
        place = f", direction ({_numbers(light.known_direction)})"
    elif (centre := _centre(light)) is not None:
        place = f", at ({_numbers(centre)})"
    name = "" if light.name == f"light {number}" else f"{light.name}: "
    return f"light {number} ({name}{light.kind}{place})"


def _numbers(vector: np.ndarray) -> str:
    return ", ".join(f"{x:.4g}" for x in vector)


def _centre(light: Light) -> np.ndarray | None:
    """The position (3,) of a light near the object; None for others."""
    return getattr(light, "centre", None)


def _shines_from_behind(light: Light) -> bool:
    return light.known_direction is not None and bool(light.known_direction[2] < 0)


def _why(light: Light, scene: Scene, traced: Transport, *, hidden: bool) -> str:
    """The likely reason why a light does not reach what the camera sees. ``hidden``: without shadows it would."""
    if _shines_from_behind(light):
        return "it shines from behind; a direction points toward its light, not the way that light travels"
    centre = _centre(light)
    if centre is not None:
        depth = traced.pixels.points.position[:, 2]
        span = f"the surface's z is {depth.min():.4g} to {depth.max():.4g} scene units"
        surface = _depth_at(centre, scene, traced)
        if surface is not None and centre[2] < surface:
            return f"it is inside or behind the object, {surface - centre[2]:.4g} scene units below its surface; {span}"
        if centre[2] < depth.min():
            return f"it is behind the object; {span}"
        normal = getattr(light, "normal", None)
        if normal is not None and (traced.pixels.points.position - centre).mean(axis=0) @ normal < 0:
            return "it shines to the other side (toward edge_u x edge_v)"
    if hidden:
        return "the scene itself is in its way"
    return "the surface faces away from it"


def _depth_at(centre: np.ndarray, scene: Scene, traced: Transport) -> float | None:
    """z of the surface at the pixel in which the camera would see the point ``centre``; None off the object."""
    if scene.view.eye is not None and centre[2] >= scene.view.eye:
        return None
    col, row = np.floor(projected(scene.view, centre[None])[0]).astype(int)
    here = np.flatnonzero((traced.pixels.row == row) & (traced.pixels.col == col))
    return float(traced.pixels.points.position[here[0], 2]) if len(here) else None
