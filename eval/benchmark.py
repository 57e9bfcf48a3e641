"""The frozen test set: which scenes it has, how it is made, and how it lies on disk.

A set is a folder. ``pictures/`` is a run folder without truth, so that `recover` and other programs can work on it;
``truth.npz`` holds the truth of all scenes in one separate file; ``benchmark.json`` says which edition it is, how each
scene was made, and the sha256 of each scene's arrays and of all. Nothing in these files depends on the time, on the
version of Python, or on the order in which scenes were made, so two sets of one edition are equal byte for byte on
machines whose renderers compute alike, and the sums of benchmark.json say whether they are.

An edition never changes once it is published. Other surfaces or shapes make a new entry in EDITIONS.
"""

import hashlib
import itertools
import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.configs.load import validate
from huesphere.configs.own_folder import write_text
from huesphere.configs.regular_file import MANIFEST_BYTES, read_text
from huesphere.configs.suggest import suggested
from huesphere.eval.regions import region_map
from huesphere.render.dataset import Observation, read_observation, read_truth, write_observation
from huesphere.render.exr import FORMAT_VERSION
from huesphere.render.manifest import sha256_of

Data = dict[str, Any]  # a part of a config
DESCRIPTION, TRUTH, PICTURES = "benchmark.json", "truth.npz", "pictures"


@dataclass(frozen=True)
class Edition:
    """What a set is made of. Each pair of shape and surface has one scene for each of its ``variants``."""

    name: str
    shapes: Mapping[str, Data]
    surfaces: Mapping[str, tuple[Data, str]]  # the config's surface, and the transport of its pictures
    lights: Mapping[str, Sequence[Data]]
    noises: tuple[float, ...]  # read noise, share of full scale
    variants: int
    resolution: int = 128  # pixels a side
    seed: int = 20_000  # the first scene's; each scene has its own


@dataclass(frozen=True)
class BenchmarkScene:
    """One scene of an edition."""

    id: str
    shape: str
    surface: str
    lights: str
    noise: float
    transport: str
    seed: int
    config: Data

    @property
    def cell(self) -> tuple[str, str]:
        """Its place in the matrix of shapes and surfaces."""
        return self.shape, self.surface


def _gel(centre: float, sigma: float = 25.0) -> Data:
    return {"gaussian": {"centre": centre, "sigma": sigma}}


def _distant(directions: Sequence[tuple[float, float, float]], spectra: Sequence[Any]) -> list[Data]:
    """Distant lights from these directions, in the camera frame, with these spectra."""
    pairs = zip(directions, spectra, strict=True)
    return [{"kind": "distant", "direction": list(way), "spectrum": spectrum} for way, spectrum in pairs]


_THREE = [(0.5, 0.0, 1.0), (-0.25, 0.43, 1.0), (-0.25, -0.43, 1.0)]
_FIVE = [(0.5, 0.2, 1.0), (-0.5, 0.2, 1.0), (0.0, -0.5, 1.0), (0.3, 0.5, 1.0), (-0.2, 0.4, 1.0)]
_WIDE = [(1.38, 0.37, 1.0), (-1.34, 0.49, 1.0), (0.0, -1.43, 1.0), (0.71, 1.24, 1.0), (-0.6, 1.29, 1.0)]
_GELS = [_gel(610.0), _gel(540.0), _gel(460.0, 20.0), _gel(580.0, 40.0), _gel(500.0, 40.0)]

V1 = Edition(
    name="v1",
    shapes={
        "bust": {"kind": "bust"},
        "sphere": {"kind": "sphere"},
        "octant": {"kind": "octant"},
        "ellipsoid": {"kind": "ellipsoid"},
        "bowl": {"kind": "bowl"},
    },
    surfaces={  # a coat's light between surfaces has noise from sampling, so its pictures are of direct light
        "skin": ({"kind": "lambertian", "reflectance": "light skin"}, "full"),
        "bright": ({"kind": "lambertian", "reflectance": 0.8}, "full"),
        "coated": ({"kind": "coated", "reflectance": "light skin"}, "direct"),
        "two": ({"kind": "lambertian", "reflectance": "light skin", "checker": {"reflectance": 0.3}}, "full"),
    },
    lights={
        "three-gels": _distant(_THREE, _GELS[:3]),
        "five-natural": _distant(_FIVE, ["A", "B", "C", "D65", "FL2"]),
        "five-gels": _distant(_FIVE, _GELS),
        "wide-gels": _distant(_WIDE, _GELS),
    },
    noises=(0.0, 1e-3, 5e-3),
    variants=2,
)
EDITIONS = {V1.name: V1}  # v2: the surfaces with textures, as a new Edition; v1 stays as it is


def find_edition(name: str) -> Edition:
    """The edition of that name. Raises InputError."""
    if name not in EDITIONS:
        expected = suggested(name, EDITIONS, f"one of {', '.join(EDITIONS)}")
        raise InputError("no such benchmark", got=name, expected=expected, where="--benchmark")
    return EDITIONS[name]


def scenes_of(edition: Edition) -> list[BenchmarkScene]:
    """The scenes of an edition, in order.

    Lights and noises go round over the scenes at different paces, so that every shape and every surface meets all of
    them in turn.
    """
    found = []
    lights = list(edition.lights)
    cells = itertools.product(enumerate(edition.shapes), enumerate(edition.surfaces), range(edition.variants))
    for number, ((row, shape), (column, surface), variant) in enumerate(cells):
        place = row + column + variant * (len(lights) // edition.variants)
        name = lights[place % len(lights)]
        noise = edition.noises[(row + 2 * column + variant) % len(edition.noises)]
        material, transport = edition.surfaces[surface]
        seed = edition.seed + number
        label = f"{shape}-{surface}-{variant + 1}"
        config = {
            "name": label,
            "shape": edition.shapes[shape],
            "surface": material,
            "lights": list(edition.lights[name]),
            "camera": {"resolution": [edition.resolution] * 2, "read_noise": noise, "seed": seed},
            "render": {"transport": [transport], "target_rms": 0.002, "seed": seed},
        }
        found.append(BenchmarkScene(label, shape, surface, name, noise, transport, seed, config))
    return found


# ---- making a set --------------------------------------------------------------------------------------------------


def make_benchmark(
    edition: Edition,
    folder: Path,
    *,
    only: Sequence[str] = (),
    jobs: int = 1,
    progress: Callable[[float, str], None] = lambda share, what: None,
    log: Callable[[str], None] = lambda line: None,
) -> Path:
    """Render the scenes of ``edition`` and freeze them in ``folder``; returns the path of benchmark.json.

    Needs the renderer. Rendered scenes are kept in ``folder/.making`` until all are there, so that a set whose making
    was interrupted can go on. ``only``: ids of the scenes of a part of the set, for tests; benchmark.json then says
    that it is a part. Raises InputError if there is a set in ``folder`` already, or for ids that are not the edition's.
    """
    from huesphere.render.run import render_configs

    if (folder / DESCRIPTION).exists():
        raise InputError("holds a benchmark already", expected="another --out", where=folder)
    every = scenes_of(edition)
    unknown = sorted(set(only) - {scene.id for scene in every})
    if unknown:
        raise InputError("no such scene of the benchmark", got=unknown[0], expected=every[0].id)
    scenes = [scene for scene in every if not only or scene.id in only]
    making = folder / ".making"
    configs = [validate(scene.config, where=f"benchmark {edition.name}") for scene in scenes]
    render_configs(configs, making, jobs=jobs, progress=progress, log=log)
    description = _freeze(edition, scenes, making, folder)
    shutil.rmtree(making)
    description["part"] = len(scenes) < len(every)
    path = folder / DESCRIPTION
    write_text(path, json.dumps(description, indent=1, sort_keys=True) + "\n")
    return path


def _freeze(edition: Edition, scenes: Sequence[BenchmarkScene], making: Path, folder: Path) -> Data:
    """Write pictures and truth of rendered scenes into ``folder``; returns what benchmark.json says."""
    truth_arrays: dict[str, np.ndarray] = {}
    records, items = [], []
    for scene in scenes:
        source = making / scene.id / scene.transport
        observation, truth = read_observation(source / "observation.exr"), read_truth(source / "truth.exr")
        place = folder / PICTURES / scene.id / scene.transport
        place.mkdir(parents=True, exist_ok=True)
        write_observation(place / "observation.exr", observation)
        write_text(place / "config.yaml", "recover: {methods: [auto]}\n")
        own = {
            "normals": np.where(truth.mask[..., None], truth.normals, np.nan).astype("<f4"),
            "mask": truth.mask.astype("u1"),
            "region": region_map(truth, None, truth.mask).astype("i1"),
        }
        truth_arrays |= {f"{scene.id}/{name}": array for name, array in own.items()}
        picture = {"rgb": observation.rgb.astype("<f4"), "mask": observation.mask.astype("u1")}
        records.append(_record(scene) | {"picture_sha256": digest(picture), "truth_sha256": digest(own)})
        names = ("config.yaml", "observation.exr")
        files = [{"path": f"{scene.id}/{scene.transport}/{n}", "sha256": sha256_of(place / n)} for n in names]
        item_id = f"{scene.id}/{scene.transport}"
        items.append({"id": item_id, "status": "done", "seed": scene.seed, "seconds": 0.0, "files": files})
    manifest = {
        "format_version": FORMAT_VERSION,
        "versions": {},
        "items": sorted(items, key=lambda item: str(item["id"])),
    }
    write_text(folder / PICTURES / "manifest.json", json.dumps(manifest, indent=1, sort_keys=True) + "\n")
    with (folder / TRUTH).open("wb") as file:
        np.savez_compressed(file, **truth_arrays)  # type: ignore[arg-type]  # zip entries are dated 1980 by NumPy
    sums = [(r["id"], r["picture_sha256"], r["truth_sha256"]) for r in records]
    return {
        "format_version": FORMAT_VERSION,
        "benchmark": edition.name,
        "resolution": edition.resolution,
        "scenes": records,
        "sha256": hashlib.sha256(json.dumps(sums).encode()).hexdigest(),
    }


def _record(scene: BenchmarkScene) -> Data:
    """What benchmark.json says of a scene, but for its sums."""
    words = {name: getattr(scene, name) for name in ("id", "shape", "surface", "lights", "noise", "transport", "seed")}
    return words | {"config": scene.config}


def digest(arrays: Mapping[str, np.ndarray]) -> str:
    """The sha256 of named arrays: of names, types, shapes and bytes, whatever file format they are kept in.

    Every NaN counts as the same one.
    """
    total = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        if array.dtype.kind == "f":
            array = np.where(np.isnan(array), np.array(np.nan, array.dtype), array)
        total.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        total.update(array.tobytes())
    return total.hexdigest()


# ---- reading a set -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SceneTruth:
    """The truth of one scene."""

    normals: np.ndarray  # (H, W, 3) float32, unit, NaN off the object
    mask: np.ndarray  # (H, W) bool
    region: np.ndarray  # (H, W) int8, as eval.regions.region_map


@dataclass(frozen=True)
class Benchmark:
    """A set on disk."""

    folder: Path
    name: str  # of its edition
    sha256: str
    part: bool  # it has not all scenes of its edition
    scenes: tuple[BenchmarkScene, ...]

    def __repr__(self) -> str:
        return f"Benchmark({self.name}, {len(self.scenes)} scenes, {self.folder})"

    def picture(self, scene: BenchmarkScene) -> Observation:
        """The picture of a scene."""
        return read_observation(self.folder / PICTURES / scene.id / scene.transport / "observation.exr")

    def truth(self, scene: BenchmarkScene) -> SceneTruth:
        """The truth of a scene. Raises InputError if the file has none of it."""
        path = self.folder / TRUTH
        try:
            with np.load(path, allow_pickle=False) as file:
                normals, mask, region = (file[f"{scene.id}/{name}"] for name in ("normals", "mask", "region"))
        except (OSError, KeyError, ValueError) as error:
            raise InputError("no truth of this scene", got=f"{type(error).__name__}: {error}", where=path) from None
        return SceneTruth(normals, mask != 0, region)


def open_benchmark(folder: Path) -> Benchmark:
    """The set in ``folder``. Raises InputError if there is none, or its description is damaged."""
    path = folder / DESCRIPTION
    if not path.is_file():
        raise InputError("no benchmark there", expected="a folder made by evaluate --benchmark v1", where=folder)
    try:
        record = json.loads(read_text(path, most=MANIFEST_BYTES))
        names = ("id", "shape", "surface", "lights", "noise", "transport", "seed", "config")
        scenes = tuple(BenchmarkScene(**{name: one[name] for name in names}) for one in record["scenes"])
        return Benchmark(folder, str(record["benchmark"]), str(record["sha256"]), bool(record["part"]), scenes)
    except (ValueError, KeyError, TypeError) as error:
        raise InputError("a damaged benchmark", got=f"{type(error).__name__}: {error}", where=path) from None


def check_sums(benchmark: Benchmark) -> list[str]:
    """The ids of scenes whose picture or truth is not that of benchmark.json. Raises InputError if one is missing."""
    record = json.loads(read_text(benchmark.folder / DESCRIPTION, most=MANIFEST_BYTES))
    wrong = []
    for scene, told in zip(benchmark.scenes, record["scenes"], strict=True):
        observation, truth = benchmark.picture(scene), benchmark.truth(scene)
        picture = {"rgb": observation.rgb.astype("<f4"), "mask": observation.mask.astype("u1")}
        own = {"normals": truth.normals, "mask": truth.mask.astype("u1"), "region": truth.region}
        if (digest(picture), digest(own)) != (told["picture_sha256"], told["truth_sha256"]):
            wrong.append(scene.id)
    return wrong
