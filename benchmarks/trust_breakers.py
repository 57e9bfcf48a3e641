"""Pictures for benchmarks/trust.py that break an assumption of the method, one each, by the name of what breaks it.

Where a kind can be described to the renderer it is rendered (highlights, two reflectances, near lights, skies, shapes
and light sets that do not determine a surface). The others change a picture that was rendered with even reflectance,
before its noise (``OPTICS``) or behind it (``SENSOR``).
"""

import io
import tempfile
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
from scipy import ndimage
from trust_scenes import (
    SHAPES,
    Config,
    Drawn,
    Sample,
    config_of,
    depth_map,
    grid_of,
    lights_apart,
    random_noise,
    random_reflectance,
    random_spectrum,
    rendered,
    shapes_here,
    toward,
)

from huesphere.render.dataset import CameraInfo
from huesphere.scenes.encoding import decode_srgb, encode_srgb

BASES = ("sphere", "ellipsoid", "bust", "relief_smooth", "relief_detailed", "sculpture", "superellipsoid", "lathe")
CAMERA = "Nikon 5100 (NPL)"
WORST_CONDITION = 15.0  # of F of the base
BRIGHT = 0.85  # full scale 1: where the brightest pixels of the object are put
Random = np.random.Generator

# ---- what is rendered: the configuration is changed -----------------------------------------------------------------


def _gloss(config: Config, rng: Random, folder: Path, size: int) -> Drawn:
    drawn = {"roughness": float(rng.uniform(0.05, 0.5)), "index": float(rng.uniform(1.15, 2.2))}
    config["surface"] = {"kind": "coated", "reflectance": config["surface"]["reflectance"]} | drawn
    return drawn


def _two_albedos(config: Config, rng: Random, folder: Path, size: int) -> Drawn:
    first, second = rng.choice(
        ["red", "green", "blue", "yellow", "orange", "cyan", "dark skin", "white 9.5 (.05 D)"], 2, False
    )
    unit = size / 2 if config["shape"]["kind"] == "depth_map" else 1.0
    checker = {"reflectance": str(second), "size": float(rng.uniform(0.25, 1.2)) * unit}
    config["surface"] = {"reflectance": str(first), "checker": checker}
    return {"first": str(first)} | checker


def _near_lights(config: Config, rng: Random, folder: Path, size: int) -> Drawn:
    radius = size / 2 if config["shape"]["kind"] == "depth_map" else 1.0
    distances = []
    for light in config["lights"]:
        distance = float(rng.uniform(1.5, 3.0))
        direction = np.array(light.pop("direction"))
        light |= {"kind": "point", "position": (direction * distance * radius).tolist()}
        light["intensity"] *= (distance * radius) ** 2
        distances.append(distance)
    return {"distances": distances}


def _one_light(config: Config, rng: Random, folder: Path, size: int) -> Drawn:
    config["lights"] = config["lights"][:1]
    return {}


def _two_lights(config: Config, rng: Random, folder: Path, size: int) -> Drawn:
    config["lights"] = config["lights"][:2]
    return {}


def _coplanar_lights(config: Config, rng: Random, folder: Path, size: int) -> Drawn:
    """All lights in one plane through the object's middle."""
    middle = np.array(toward(rng.uniform(0, 20), rng.uniform(0, 2 * np.pi)))
    across = np.cross(middle, rng.standard_normal(3))
    across /= np.linalg.norm(across)
    angles = np.radians(np.linspace(-40, 40, len(config["lights"])) + rng.uniform(-5, 5, len(config["lights"])))
    for light, angle in zip(config["lights"], angles, strict=True):
        light["direction"] = (np.cos(angle) * middle + np.sin(angle) * across).tolist()
    return {"angles_deg": np.degrees(angles).tolist()}


def _sky_dome(config: Config, rng: Random, folder: Path, size: int) -> Drawn:
    """One to three domes without a sun, half the time of colours like those of lights."""
    coloured = bool(rng.random() < 0.5)
    config["lights"] = [
        {
            "kind": "sky",
            "up": toward(rng.uniform(10, 80), rng.uniform(0, 2 * np.pi)),
            "zenith": random_spectrum(rng, coloured=coloured),
            "horizon": random_spectrum(rng, coloured=coloured),
            "intensity": float(rng.uniform(0.5, 1.5)),
        }
        for _ in range(int(rng.integers(1, 4)))
    ]
    return {"domes": len(config["lights"])}


def _height_field(config: Config, depth: np.ndarray, mask: np.ndarray, folder: Path) -> None:
    """Put a height field, both in half picture sizes, in place of the shape."""
    config["shape"] = depth_map(depth * len(depth) / 2, mask, folder)


def _turned(rng: Random, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates (u, v) of the picture, each (size, size), turned by any angle."""
    x, y = grid_of(size)
    angle = rng.uniform(0, 2 * np.pi)
    return np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x


def _flat(config: Config, rng: Random, folder: Path, size: int) -> Drawn:
    u, v = _turned(rng, size)
    slope = float(np.tan(np.radians(rng.uniform(0, 40))))
    _height_field(config, slope * u, np.hypot(u, v) < 0.93, folder)
    return {"slope": slope}


def _cylinder(config: Config, rng: Random, folder: Path, size: int) -> Drawn:
    u, v = _turned(rng, size)
    radius, slope = float(rng.uniform(0.6, 0.9)), float(rng.uniform(-0.5, 0.5))
    mask = (np.abs(u) < 0.97 * radius) & (np.abs(v) < 0.9) & (np.maximum(*np.abs(grid_of(size))) < 0.97)
    _height_field(config, np.sqrt(np.maximum(radius**2 - u**2, 1e-3)) + slope * v, mask, folder)
    return {"radius": radius, "slope": slope}


def _cone(config: Config, rng: Random, folder: Path, size: int) -> Drawn:
    u, v = _turned(rng, size)
    steep = float(np.tan(np.radians(rng.uniform(20, 60))) * rng.choice([1.0, 1.0, -1.0]))
    _height_field(config, -steep * np.hypot(u, v), np.hypot(u, v) < 0.93, folder)
    return {"steepness": steep}


def _second_surface(config: Config, rng: Random, folder: Path, size: int) -> Drawn:
    """A paraboloid or saddle, by chance with a slope, over a rectangle."""
    (u, v), (x, y) = _turned(rng, size), grid_of(size)
    bends = rng.uniform(0.25, 1.2, 2) * rng.choice([-1.0, 1.0], 2)
    slope = rng.uniform(-0.4, 0.4, 2) * rng.integers(2)
    mask = (np.abs(x) < 0.95) & (np.abs(y) < rng.uniform(0.6, 0.95))
    _height_field(config, (bends[0] * u**2 + bends[1] * v**2) / 2 + slope[0] * u + slope[1] * v, mask, folder)
    return {"bends": bends.tolist(), "slope": slope.tolist()}


RENDERED: dict[str, Callable[[Config, Random, Path, int], Drawn]] = {
    "gloss": _gloss,
    "two_albedos": _two_albedos,
    "near_lights": _near_lights,
    "one_light": _one_light,
    "two_lights": _two_lights,
    "coplanar_lights": _coplanar_lights,
    "sky_dome": _sky_dome,
    "flat": _flat,
    "cylinder": _cylinder,
    "cone": _cone,
    "second_surface": _second_surface,
}

# ---- what is done to the light of a picture -------------------------------------------------------------------------


def _control(rgb: np.ndarray, mask: np.ndarray, rng: Random) -> tuple[np.ndarray, Drawn]:
    """Nothing: what the method makes of these pictures where no assumption is broken."""
    return rgb, {}


def _albedo_gradient(rgb: np.ndarray, mask: np.ndarray, rng: Random) -> tuple[np.ndarray, Drawn]:
    """Brightness from .4 to 1 along a direction of the picture, with a slow wave in it."""
    u, v = _turned(rng, len(mask))
    ramp = u + rng.uniform(0, 0.4) * np.sin(2 * v + rng.uniform(0, 6))
    low, high = ramp[mask].min(), ramp[mask].max()
    return rgb * (0.4 + 0.6 * (ramp - low) / (high - low))[..., None], {"darkest": 0.4}


def _texture(rgb: np.ndarray, mask: np.ndarray, rng: Random) -> tuple[np.ndarray, Drawn]:
    """Patches of three to five brightnesses of .3 to 1."""
    sigma = float(rng.uniform(0.03, 0.12) * len(mask))
    field = ndimage.gaussian_filter(rng.standard_normal(mask.shape), sigma)
    levels = rng.uniform(0.3, 1.0, int(rng.integers(3, 6)))
    edges = np.quantile(field[mask], np.arange(1, len(levels)) / len(levels))
    return rgb * levels[np.digitize(field, edges)][..., None], {"sigma_px": sigma, "levels": levels.tolist()}


def _ambient(rgb: np.ndarray, mask: np.ndarray, rng: Random) -> tuple[np.ndarray, Drawn]:
    """A colour added to all pixels of the object: .1 to .4 of its light."""
    share = float(rng.uniform(0.1, 0.4))
    colour = rgb[mask].mean() * rng.uniform(0.7, 1.3, 3) * share / (1 - share)
    return rgb + colour * mask[..., None], {"share": share}


def _vignetting(rgb: np.ndarray, mask: np.ndarray, rng: Random) -> tuple[np.ndarray, Drawn]:
    """Darker by 10 to 40 % in the corners, with the square of the distance from the middle."""
    x, y = grid_of(len(mask))
    fall = float(rng.uniform(0.1, 0.4))
    return rgb * (1 - fall * (x**2 + y**2) / 2)[..., None], {"fall": fall}


def _blur(rgb: np.ndarray, mask: np.ndarray, rng: Random) -> tuple[np.ndarray, Drawn]:
    """A Gaussian of 1 to 3 pixels, across the rim too."""
    sigma = float(rng.uniform(1, 3))
    return ndimage.gaussian_filter(rgb, (sigma, sigma, 0)), {"sigma_px": sigma}


def _shuffled_pixels(rgb: np.ndarray, mask: np.ndarray, rng: Random) -> tuple[np.ndarray, Drawn]:
    shuffled = rgb.copy()
    shuffled[mask] = rng.permutation(rgb[mask])
    return shuffled, {}


def _noise_only(rgb: np.ndarray, mask: np.ndarray, rng: Random) -> tuple[np.ndarray, Drawn]:
    """Even or normal random colours on the object, of single pixels or of patches."""
    sigma = float(rng.choice([0.0, 0.0, 1.0, 4.0]))
    colours = rng.random(rgb.shape)
    if sigma:
        colours = ndimage.gaussian_filter(colours - 0.5, (sigma, sigma, 0))
        colours = np.clip(0.5 + 0.2 * colours / colours.std(), 0.0, None)
    return colours * mask[..., None], {"sigma_px": sigma}


OPTICS: dict[str, Callable[[np.ndarray, np.ndarray, Random], tuple[np.ndarray, Drawn]]] = {
    "control": _control,
    "albedo_gradient": _albedo_gradient,
    "texture": _texture,
    "ambient": _ambient,
    "vignetting": _vignetting,
    "blur": _blur,
    "shuffled_pixels": _shuffled_pixels,
    "noise_only": _noise_only,
}

# ---- what the camera does behind the noise --------------------------------------------------------------------------


Told = tuple[np.ndarray, CameraInfo, Drawn]  # the picture, what is stated of the camera, what was drawn


def _black_level(rgb: np.ndarray, mask: np.ndarray, camera: CameraInfo, rng: Random) -> Told:
    level = float(rng.uniform(0.02, 0.1))
    return level + (1 - level) * rgb, camera, {"level": level}


def _gamma(rgb: np.ndarray, mask: np.ndarray, camera: CameraInfo, rng: Random) -> Told:
    return encode_srgb(np.clip(rgb, 0, 1)), camera, {}


def _clipping(rgb: np.ndarray, mask: np.ndarray, camera: CameraInfo, rng: Random) -> Told:
    """So bright that 5 to 30 % of the pixels have a channel at full scale; half the time nothing says so."""
    share, told = float(rng.uniform(0.05, 0.3)), bool(rng.random() < 0.5)
    clipped = np.clip(rgb / np.quantile(rgb[mask].max(axis=-1), 1 - share), None, 1.0)
    return clipped, replace(camera, saturation=1.0 if told else None), {"share": share, "told": told}


def _jpeg(rgb: np.ndarray, mask: np.ndarray, camera: CameraInfo, rng: Random) -> Told:
    """Eight-bit sRGB, quality 60 to 90, colour at half resolution, decoded to light as the product's reader does."""
    quality = int(rng.integers(60, 91))
    samples = np.round(255 * encode_srgb(np.clip(rgb, 0, 1))).astype(np.uint8)
    file = imageio.imwrite("<bytes>", samples, extension=".jpg", quality=quality, subsampling="4:2:0")
    decoded = decode_srgb(imageio.imread(io.BytesIO(file), extension=".jpg") / 255)
    camera = CameraInfo(known=False, bits=8, saturation=1.0, stored_as="srgb")
    return decoded, camera, {"quality": quality}


SENSOR: dict[str, Callable[[np.ndarray, np.ndarray, CameraInfo, Random], Told]] = {
    "black_level": _black_level,
    "gamma": _gamma,
    "clipping": _clipping,
    "jpeg": _jpeg,
}
KINDS = (*RENDERED, *OPTICS, *SENSOR)

# ---- a picture ------------------------------------------------------------------------------------------------------


def _base_lights(rng: Random) -> list[Config]:
    """Three to five Gaussian bands 20 to 50 degrees off axis, about evenly around it."""
    count = int(rng.integers(3, 6))
    start = rng.uniform(0, 2 * np.pi)
    return [
        {
            "direction": toward(rng.uniform(20, 50), start + (k + rng.uniform(-0.3, 0.3)) * 2 * np.pi / count),
            "spectrum": random_spectrum(rng, coloured=True),
            "intensity": float(rng.uniform(0.5, 1.5)),
        }
        for k in rng.permutation(count)
    ]


def broken(kind: str, seed: int, size: int) -> Sample:
    """Picture number ``seed`` of a kind. Half of them state their noise, the others nothing of their camera."""
    rng = np.random.default_rng([2, zlib.crc32(kind.encode()), seed])
    here = shapes_here()
    bases = [*BASES, *(name for name in ("planck", "teapot", "mozart") if name in here)]
    name = str(rng.choice(bases))
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        surface = {"reflectance": random_reflectance(rng)}
        lights = lights_apart(lambda: _base_lights(rng), surface, CAMERA, WORST_CONDITION)
        config = config_of(SHAPES[name][1](rng, size, folder), surface, lights, size, CAMERA)
        drawn: Drawn = RENDERED[kind](config, rng, folder, size) if kind in RENDERED else {}
        picture = rendered(config)
    shaped = kind in ("flat", "cylinder", "cone", "second_surface")
    rgb, mask = picture.rgb, picture.mask
    if kind in OPTICS:
        rgb, more = OPTICS[kind](rgb, mask, rng)
        drawn |= more
    rgb = rgb * BRIGHT / np.percentile(rgb[mask], 99.5)
    noise = random_noise(rng)
    rgb = rgb + noise * rng.standard_normal(rgb.shape)
    camera = CameraInfo(read_noise=noise) if rng.random() < 0.5 else CameraInfo(known=False)
    if kind in SENSOR:
        rgb, camera, more = SENSOR[kind](rgb, mask, camera, rng)
        drawn |= more
    drawn = {"shape": kind if shaped else name, "closed": "relief" if shaped else SHAPES[name][0], "broken": drawn}
    drawn |= {"lights": config["lights"], "surface": config["surface"], "noise": noise, "told": camera.known}
    return Sample("breakers", kind, seed, rgb, mask, picture.normals, camera, drawn | picture.facts)
