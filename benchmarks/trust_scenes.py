"""Pictures for benchmarks/trust.py: random scenes of many shapes by the product's renderer, and mixed photographs.

A picture is made from its family, kind and seed alone. Frames are those of the product: camera frame, x right, y up,
z toward the camera, row 0 at the top; rgb is linear light with full scale 1.
"""

import contextlib
import importlib.util
import io
import json
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from recover_shells import MOZART
from scipy import ndimage
from scipy.spatial.transform import Rotation

from huesphere.configs.load import validate
from huesphere.render.backend import choose_backend, load_mitsuba
from huesphere.render.dataset import CameraInfo, lights_seen
from huesphere.render.picture import assemble
from huesphere.render.sensor import exposure_gain
from huesphere.render.spectral import linear_model
from huesphere.render.transport import trace
from huesphere.render.truth import ground_truth
from huesphere.scenes.build import build_scene
from huesphere.scenes.primitives import ball

Config = dict[str, Any]
Drawn = dict[str, Any]

SCANS = MOZART.parents[1] / "shapes"
REAL = MOZART.parents[1] / "real"
PHOTOGRAPHED = ("diligent_ball", "diligent_cat", "grey_sphere")
MIXES = ("lamps", "gels", "natural")
TARGET_RMS = 1e-3  # of the renderer, relative
CONDITIONS = (8.0, 80.0)  # the worst cond F that a scene may have is drawn from this range, evenly in its logarithm
MOST_DRAWS = 100  # of lights, until one is within it; after them the best draw is taken
ILLUMINANTS = (
    *("A", "D50", "D65", "D75", "FL2", "FL7", "FL11", "HP1", "HP2", "HP4", "LED-B1", "LED-B3", "LED-B5"),
    *("LED-BH1", "LED-RGB1", "LED-V1"),
)
PATCHES = ("light skin", "dark skin", "blue sky", "foliage", "orange", "moderate red", "bluish green", "yellow green")
CAMERAS = ("Nikon 5100 (NPL)", "Nikon 5100 (NPL)", "Sigma SDMerill (NPL)", "three-chip")


@dataclass(frozen=True)
class Sample:
    """A picture with what is true of it."""

    family: str  # "scenes", "breakers" or "real"
    kind: str  # shape of a scene, what breaks the assumptions, or object and mix of a photograph
    seed: int
    rgb: np.ndarray  # (H, W, 3) float32
    mask: np.ndarray  # (H, W) bool
    normals: np.ndarray  # (H, W, 3) float32, NaN off the mask
    camera: CameraInfo  # as it is stated to recovery
    drawn: Drawn  # JSON-able: shape, lights, reflectance, noise and what follows from them


@dataclass(frozen=True)
class Rendered:
    """A picture before noise, exposed, and its truth."""

    rgb: np.ndarray  # (H, W, 3) float64
    mask: np.ndarray  # (H, W) bool
    normals: np.ndarray  # (H, W, 3) float32
    facts: Drawn  # share that sees all lights, cond F, indirect share, share of pixels


def write_sample(folder: Path, name: str, sample: Sample) -> None:
    """Write ``sample`` as <folder>/<family>/<name>.npz, as a whole or not at all."""
    path = sample_path(folder, sample.family, name)
    path.parent.mkdir(parents=True, exist_ok=True)
    packed = io.BytesIO()
    np.savez_compressed(
        packed,
        rgb=sample.rgb.astype(np.float32),
        mask=sample.mask,
        normals=sample.normals.astype(np.float32),
        noise=sample.camera.read_noise,
        family=sample.family,
        kind=sample.kind,
        seed=sample.seed,
        camera=json.dumps(asdict(sample.camera)),
        drawn=json.dumps(sample.drawn, default=float),
    )
    partial = path.with_suffix(".partial")
    partial.write_bytes(packed.getvalue())
    partial.replace(path)


def sample_path(folder: Path, family: str, name: str) -> Path:
    """Where the sample of that name is, or is to be."""
    return folder / family / f"{name}.npz"


def read_sample(path: Path) -> Sample:
    """The sample in a file of `write_sample`."""
    with np.load(path) as file:
        camera = CameraInfo(**json.loads(str(file["camera"])))
        drawn = json.loads(str(file["drawn"]))
        family, kind, seed = str(file["family"]), str(file["kind"]), int(file["seed"])
        return Sample(family, kind, seed, file["rgb"], file["mask"], file["normals"], camera, drawn)


# ---- shapes of the schema ------------------------------------------------------------------------------------------


def _sphere(rng: np.random.Generator, size: int, folder: Path) -> Config:
    return {"kind": "sphere", "detail": 64}


def _hemisphere(rng: np.random.Generator, size: int, folder: Path) -> Config:
    return {"kind": "hemisphere", "detail": 64}


def _octant(rng: np.random.Generator, size: int, folder: Path) -> Config:
    """The product's octant through a file, which moves it to the middle of the picture."""
    part = ball(64, part="octant")
    path = folder / "octant.ply"
    trimesh.Trimesh(part.vertices, part.faces, process=False).export(path)
    return {"kind": "mesh", "path": str(path)}


def _ellipsoid(rng: np.random.Generator, size: int, folder: Path) -> Config:
    axes = rng.uniform(0.45, 1.0, 3).tolist()
    return {"kind": "ellipsoid", "semi_axes": axes, "rotation": _any_pose(rng), "detail": 48}


def _v_groove(rng: np.random.Generator, size: int, folder: Path) -> Config:
    return {"kind": "v_groove", "angle": rng.uniform(60, 150), "turn": rng.uniform(-80, 80), "detail": 24}


def _bowl(rng: np.random.Generator, size: int, folder: Path) -> Config:
    return {"kind": "bowl", "opening": rng.uniform(35, 88), "detail": 40}


def _bust(rng: np.random.Generator, size: int, folder: Path) -> Config:
    return {"kind": "bust", "detail": 100}


def _any_pose(rng: np.random.Generator) -> list[float]:
    """Angles about x, y, z (degrees) of a rotation drawn evenly from all."""
    return Rotation.random(random_state=rng).as_euler("xyz", degrees=True).tolist()


# ---- height fields -------------------------------------------------------------------------------------------------


def grid_of(size: int) -> tuple[np.ndarray, np.ndarray]:
    """(x, y) of the pixels' centres, each (size, size), from −1 to 1; y up."""
    row, column = np.mgrid[:size, :size] + 0.5
    return column / size * 2 - 1, 1 - row / size * 2


def depth_map(depth: np.ndarray, mask: np.ndarray, folder: Path) -> Config:
    """The shape of a height field (H, W) in pixels; its middle height is set to 0."""
    path = folder / "depth.npz"
    np.savez(path, depth=depth - np.median(depth[mask]), mask=mask)
    return {"kind": "depth_map", "path": str(path)}


def _outline(rng: np.random.Generator, size: int) -> np.ndarray:
    """The mask of a relief: a rectangle, a disc, or a closed curve with a few waves."""
    x, y = grid_of(size)
    form = rng.integers(3)
    if form == 0:
        return (np.abs(x) < 0.96) & (np.abs(y) < rng.uniform(0.7, 0.96))
    angle, radius = np.arctan2(y, x), np.full_like(x, 0.85 if form == 2 else 0.95)
    for waves in range(2, 6 if form == 2 else 2):
        radius += rng.normal(0, 0.12 / waves) * np.cos(waves * angle + rng.uniform(0, 2 * np.pi))
    return np.hypot(x, y) < np.minimum(radius, 0.97)


def _relief(rng: np.random.Generator, size: int, folder: Path, detailed: bool) -> Config:
    """Bumps and hollows over a dome, plain or dish; detailed: with ripples of all scales down to 4 pixels."""
    x, y = grid_of(size)
    mask = _outline(rng, size)
    depth = rng.choice([0.0, 0.5, 0.8, -0.4]) * np.sqrt(np.maximum(1.3 - x * x - y * y, 0.02))
    for _ in range(int(rng.integers(5, 16))):
        cx, cy = rng.uniform(-0.8, 0.8, 2)
        width = rng.uniform(0.15, 0.45)
        depth += rng.uniform(-0.6, 0.6) * width * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * width**2))
    if detailed:
        for scale in (0.16, 0.08, 0.04):
            ripples = ndimage.gaussian_filter(rng.standard_normal((size, size)), max(1.3, scale * size / 2))
            depth += ripples / ripples.std() * scale * rng.uniform(0.08, 0.25)
    steep = np.percentile(np.hypot(*np.gradient(depth * size / 2))[mask], 95)
    depth *= np.tan(np.radians(rng.uniform(30, 60))) / steep
    return depth_map(depth * size / 2, mask, folder)


def _relief_smooth(rng: np.random.Generator, size: int, folder: Path) -> Config:
    return _relief(rng, size, folder, detailed=False)


def _relief_detailed(rng: np.random.Generator, size: int, folder: Path) -> Config:
    return _relief(rng, size, folder, detailed=True)


def _mozart(rng: np.random.Generator, size: int, folder: Path) -> Config:
    return {"kind": "depth_map", "path": str(MOZART), "depth_scale": rng.uniform(0.8, 1.8)}


# ---- meshes --------------------------------------------------------------------------------------------------------


def _mesh(mesh: trimesh.Trimesh, rng: np.random.Generator, folder: Path) -> Config:
    path = folder / "shape.ply"
    mesh.export(path)
    return {"kind": "mesh", "path": str(path), "rotation": _any_pose(rng), "smooth": 60}


def _sculpture(rng: np.random.Generator, size: int, folder: Path) -> Config:
    return {"kind": "sculpture", "seed": int(rng.integers(2**31)), "detail": 64, "relief": float(rng.uniform(0, 0.5))}


def _superellipsoid(rng: np.random.Generator, size: int, folder: Path) -> Config:
    """|x/a|^p + |y/b|^p + |z/c|^p = 1 with waves over it."""
    sphere = trimesh.creation.icosphere(subdivisions=5)
    d, power = sphere.vertices, rng.uniform(1.6, 5.0)
    radius = np.sum(np.abs(d / rng.uniform(0.6, 1.0, 3)) ** power, axis=-1) ** (-1 / power)
    for _ in range(int(rng.integers(3, 9))):
        wave = rng.normal(0, 1, 3) * rng.uniform(2, 7)
        radius = radius * (
            1 + rng.uniform(0.01, 0.12 / np.linalg.norm(wave) ** 0.5) * np.cos(d @ wave + rng.uniform(0, 6))
        )
    return _mesh(trimesh.Trimesh(d * radius[:, None], sphere.faces, process=False), rng, folder)


def _lathe(rng: np.random.Generator, size: int, folder: Path) -> Config:
    """A turned vase: a random profile about an axis, closed at both ends."""
    t = np.linspace(0, np.pi, 100)
    radius = 0.6 * np.sin(t) ** 0.5 * (1 + sum(rng.uniform(-0.25, 0.25) * np.cos(k * t) for k in range(1, 6)))
    profile = np.stack([np.maximum(radius, 0), -np.cos(t) * rng.uniform(0.7, 1.1)], axis=-1)
    return _mesh(trimesh.creation.revolve(profile, sections=120), rng, folder)


def _torus(rng: np.random.Generator, size: int, folder: Path) -> Config:
    return _mesh(trimesh.creation.torus(1.0, rng.uniform(0.25, 0.55), 110, 64), rng, folder)


def _knot(rng: np.random.Generator, size: int, folder: Path) -> Config:
    """A tube along a torus knot."""
    p, q = ((2, 3), (3, 2), (2, 5))[int(rng.integers(3))]
    around, along = 36, 320
    t = np.arange(along) / along * 2 * np.pi
    ring = 1 + 0.45 * np.cos(q * t)
    curve = np.stack([ring * np.cos(p * t), ring * np.sin(p * t), 0.45 * np.sin(q * t)], axis=-1)
    tangent = np.roll(curve, -1, axis=0) - np.roll(curve, 1, axis=0)
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    side = np.cross(tangent, curve - np.stack([np.cos(p * t), np.sin(p * t), 0 * t], axis=-1))
    side /= np.linalg.norm(side, axis=-1, keepdims=True)
    up, angle = np.cross(side, tangent), np.arange(around) / around * 2 * np.pi
    circle = np.cos(angle)[None, :, None] * side[:, None] + np.sin(angle)[None, :, None] * up[:, None]
    vertices = (curve[:, None] + rng.uniform(0.14, 0.22) * circle).reshape(-1, 3)
    i, j = (grid.ravel() for grid in np.mgrid[:along, :around])
    a, b = i * around + j, (i + 1) % along * around + j
    c, d = i * around + (j + 1) % around, (i + 1) % along * around + (j + 1) % around
    mesh = trimesh.Trimesh(vertices, np.concatenate([np.stack([a, b, c], -1), np.stack([c, b, d], -1)]), process=False)
    if mesh.volume < 0:
        mesh.invert()
    return _mesh(mesh, rng, folder)


def _scan(name: str) -> Callable[[np.random.Generator, int, Path], Config]:
    """A scan: half the time upright and turned by up to 40 degrees, else in any pose."""

    def shape(rng: np.random.Generator, size: int, folder: Path) -> Config:
        pose = rng.uniform(-40, 40, 3).tolist() if rng.random() < 0.5 else _any_pose(rng)
        return {"kind": "mesh", "path": str(SCANS / f"{name}.ply"), "rotation": pose}

    return shape


SHAPES: dict[str, tuple[str, Callable[[np.random.Generator, int, Path], Config]]] = {  # name: how it closes, maker
    "sphere": ("ball", _sphere),
    "hemisphere": ("ball", _hemisphere),
    "octant": ("ball", _octant),
    "ellipsoid": ("ball", _ellipsoid),
    "v_groove": ("groove", _v_groove),
    "bowl": ("bowl", _bowl),
    "bust": ("ball", _bust),
    "relief_smooth": ("relief", _relief_smooth),
    "relief_detailed": ("relief", _relief_detailed),
    "sculpture": ("ball", _sculpture),
    "superellipsoid": ("ball", _superellipsoid),
    "lathe": ("ball", _lathe),
    "torus": ("ball", _torus),
    "knot": ("ball", _knot),
    **{name: ("ball", _scan(name)) for name in ("planck", "bunny", "fandisk", "teapot")},
    "mozart": ("relief", _mozart),
}


def shapes_here() -> tuple[str, ...]:
    """The names in SHAPES whose files are here."""
    scans = {name: SCANS / f"{name}.ply" for name in ("planck", "bunny", "fandisk", "teapot")} | {"mozart": MOZART}
    return tuple(name for name in SHAPES if name not in scans or scans[name].is_file())


# ---- lights, reflectance, picture ----------------------------------------------------------------------------------


def toward(tilt_deg: float, azimuth: float) -> list[float]:
    """The unit vector so many degrees off the view axis, at an azimuth in radians."""
    tilt = np.radians(tilt_deg)
    return [float(v) for v in (np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt))]


def random_spectrum(rng: np.random.Generator, *, coloured: bool) -> Any:
    """A Gaussian band; unless ``coloured`` as likely a black body, or as likely again a lamp or CIE illuminant."""
    kind = 0 if coloured else rng.integers(3)
    if kind == 0:
        return {"gaussian": {"centre": float(rng.uniform(440, 640)), "sigma": float(rng.uniform(15, 45))}}
    if kind == 1:
        return {"blackbody": float(np.exp(rng.uniform(np.log(2200), np.log(12_000))))}
    return str(rng.choice(ILLUMINANTS))


def _random_lights(rng: np.random.Generator) -> list[Config]:
    """Three to nine distant lights from 10 degrees off axis to a widest angle of 35, 50, 65 or 80."""
    widest = rng.choice([35.0, 50.0, 65.0, 80.0])
    return [
        {
            "direction": toward(rng.uniform(10, widest), rng.uniform(0, 2 * np.pi)),
            "spectrum": random_spectrum(rng, coloured=False),
            "intensity": float(rng.uniform(0.5, 1.5)),
        }
        for _ in range(int(rng.integers(3, 10)))
    ]


def lights_apart(lights: Callable[[], list[Config]], surface: Config, camera: str, worst: float) -> list[Config]:
    """The first of MOST_DRAWS draws of ``lights`` with cond F ≤ ``worst``, or the one nearest to it."""
    best, least = lights(), np.inf
    for _ in range(MOST_DRAWS):
        drawn = lights()
        config = config_of({"kind": "sphere", "detail": 8}, surface, drawn, 8, camera)
        model = linear_model(build_scene(validate(config, where="trust")))
        condition = np.inf if model is None else float(np.linalg.cond(model))
        if condition < least:
            best, least = drawn, condition
        if least <= worst:
            break
    return best


def random_reflectance(rng: np.random.Generator) -> float | str:
    """A grey of .2 to .9, or a measured patch."""
    return float(rng.uniform(0.2, 0.9)) if rng.random() < 0.5 else str(rng.choice(PATCHES))


def random_noise(rng: np.random.Generator, most: float = 3e-3) -> float:
    """Standard deviation of the read noise, share of full scale: 0 half the time, else from 3e-4 to ``most``."""
    return 0.0 if rng.random() < 0.5 else float(np.exp(rng.uniform(np.log(3e-4), np.log(most))))


def config_of(shape: Config, surface: Config, lights: list[Config], size: int, camera: str) -> Config:
    """A configuration of the product, as a mapping."""
    return {
        "name": "trust",
        "shape": shape,
        "surface": surface,
        "lights": lights,
        "camera": {"resolution": [size, size], "sensitivity": camera},
        "render": {"transport": ["full"], "target_rms": TARGET_RMS},
    }


def rendered(config: Config) -> Rendered:
    """The picture of a configuration with all bounces, exposed; of a coated surface by direct light alone."""
    checked = validate(config, where="trust")
    mi = load_mitsuba(choose_backend())
    scene = build_scene(checked)
    level = "full" if scene.coat is None else "direct"
    options = {"target_rms": checked.render.target_rms, "max_bounces": None, "seed": 0}
    traced = trace(scene, mi, reach=level, progress=lambda share, what: None, **options)
    colour = assemble(scene, traced, level, mi).colour
    mask = traced.mask()
    gain = exposure_gain(colour[mask], checked.camera)
    truth = ground_truth(scene, traced, gain, cast_shadows=True)
    direct = assemble(scene, traced, "direct", mi).colour
    model = linear_model(scene)
    seen = lights_seen(truth)[mask]
    facts: Drawn = {
        "sees_all": float((seen > len(scene.lights) - 0.01).mean()),
        "cond_F": None if model is None else float(np.linalg.cond(model)),
        "indirect": float(1 - direct[mask].sum() / colour[mask].sum()),
        "share_of_picture": float(mask.mean()),
    }
    return Rendered(gain * colour.astype(np.float64), mask, truth.normals, facts)


def random_scene(seed: int, size: int) -> Sample:
    """Scene number ``seed``; shapes come in turn."""
    shapes = shapes_here()
    name = shapes[seed % len(shapes)]
    rng = np.random.default_rng([1, seed])
    with tempfile.TemporaryDirectory() as folder:
        shape = SHAPES[name][1](rng, size, Path(folder))
        surface, camera = {"reflectance": random_reflectance(rng)}, str(rng.choice(CAMERAS))
        worst = float(np.exp(rng.uniform(*np.log(CONDITIONS))))
        lights = lights_apart(lambda: _random_lights(rng), surface, camera, worst)
        picture = rendered(config_of(shape, surface, lights, size, camera))
    noise = random_noise(rng)
    rgb = picture.rgb + noise * rng.standard_normal(picture.rgb.shape)
    told = shape | ({"path": Path(shape["path"]).name} if "path" in shape else {})
    drawn: Drawn = {"shape": name, "closed": SHAPES[name][0], "made": told, "lights": lights, "surface": surface}
    drawn |= {"camera": camera, "noise": noise} | picture.facts
    return Sample("scenes", name, seed, rgb, picture.mask, picture.normals, CameraInfo(read_noise=noise), drawn)


# ---- photographs ---------------------------------------------------------------------------------------------------


def photograph(name: str, mix: str, seed: int) -> Sample:
    """Single-light photographs of an object added up under coloured lights, by the recipe that lies beside them."""
    spec = importlib.util.spec_from_file_location("mix", REAL / "mix.py")
    if spec is None or spec.loader is None:
        raise ImportError(REAL / "mix.py")
    recipe = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(recipe)
    with np.load(REAL / f"{name}.npz") as data:
        rgb, weights, lights = recipe.mixed(data, mix, seed)
        mask, normals, directions = data["mask"], data["normals"], data["light_directions"][lights]
    mask = mask & np.isfinite(normals).all(axis=-1)
    drawn: Drawn = {"shape": name, "closed": "ball", "mix": mix, "weights": weights.tolist()}
    if np.isfinite(directions).all():
        drawn["lights"] = directions.tolist()
        with contextlib.suppress(np.linalg.LinAlgError):
            drawn["cond_F"] = float(np.linalg.cond(weights.T @ directions))
    return Sample("real", f"{name}_{mix}", seed, rgb, mask, normals, CameraInfo(known=False), drawn)
