"""Scores one method on a benchmark: its normal maps are found, their frame and coverage checked, and a row is made.

Whatever the method is, it is scored from normal maps: those in a folder, those that a function of the user returns for
each picture, or those of a method of ours. The result is a zip file that holds the maps, the row and the scores of each
scene, and the row again as a small JSON file for the leaderboard.
"""

import importlib
import io
import json
import re
import sys
import time
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.configs.own_folder import replacing, write_text
from huesphere.eval.benchmark import Benchmark, BenchmarkScene, SceneTruth
from huesphere.eval.frames import FRAMES, OURS, Frame
from huesphere.eval.map_samples import SUFFIXES
from huesphere.eval.metrics import angular_error_deg, error_columns, median
from huesphere.eval.normal_map import read_map
from huesphere.recover.methods.table import METHODS
from huesphere.render.dataset import Observation

BEST_DEG, WORST_DEG = 0.1, 30.0  # errors at which a pixel is worth all of its points, and none
RESAMPLES = 2000
LEAST_SHARE = 0.5  # of the scenes for which there must be a map
FRAME_PIXELS = 2000  # of each scene, by which frames are compared
BETTER_TIMES, BETTER_BY_DEG = 0.6, 5.0  # by how much another frame must be better to be held for the right one
ZIP_DATE = (1980, 1, 1, 0, 0, 0)  # of every entry, so that the same maps make the same file
NAN = float("nan")

Normals = Callable[[BenchmarkScene], "tuple[np.ndarray, np.ndarray] | None"]  # -> normals (H, W, 3), valid (H, W)


@dataclass(frozen=True)
class SceneScore:
    """How one scene went. Errors in degrees over the pixels with a normal, NaN where there are none."""

    id: str
    shape: str
    surface: str
    points: float  # 0 to 100, over all pixels of the object: see ``points_of``
    coverage: float
    median_deg: float
    mean_deg: float
    p90_deg: float
    seconds: float  # NaN for maps from a folder


@dataclass(frozen=True)
class Row:
    """One method on one benchmark: a line of the leaderboard."""

    name: str
    benchmark: str
    sha256: str  # of the benchmark
    part: bool  # the benchmark was only a part of its edition
    points: float  # mean over the scenes
    low: float  # 95 % interval of the points, by resampling scenes
    high: float
    coverage: float  # mean over the scenes
    median_deg: float  # median over the scenes of their median errors; a scene without normals counts as the worst
    mean_deg: float  # mean over the scenes that have normals
    missing: tuple[str, ...]  # scenes without a map
    matrix: Mapping[str, Mapping[str, float]]  # mean points by shape and surface
    scenes: tuple[SceneScore, ...]

    def __repr__(self) -> str:
        return f"Row({self.name} on {self.benchmark}: {self.points:.1f} points, {self.coverage:.0%} covered)"


def points_of(error_deg: np.ndarray, pixels: int) -> float:
    """Points from 0 to 100 of a scene: mean over all object pixels of what their errors are worth.

    An error of BEST_DEG or less is worth 1, of WORST_DEG or more 0, and between them its logarithm counts linearly, so
    that halving every error is worth the same wherever one stands. A pixel without a normal is worth 0: leaving out
    pixels never pays. ``error_deg`` (N,) are the errors of the pixels that have a normal.

    >>> round(points_of(np.array([0.1, 30.0]), 2), 6), points_of(np.array([0.05]), 4)
    (50.0, 25.0)
    """
    if not pixels:
        return 0.0
    with np.errstate(divide="ignore"):
        worth = np.log(WORST_DEG / error_deg) / np.log(WORST_DEG / BEST_DEG)
    return float(100.0 * np.clip(worth, 0.0, 1.0).sum() / pixels)


def submit(
    benchmark: Benchmark, given: str, name: str, folder: Path, *, frame: Frame | None = None
) -> tuple[Row, Path]:
    """Score a method and write <folder>/<name>-<benchmark>.zip and <name>-<benchmark>.json; returns (row, zip).

    Args:
        benchmark: the set.
        given: a folder of normal maps, "module:function", or the name of a method of ours.
        name: of the method on the leaderboard.
        folder: where to write.
        frame: of the maps; None: ours, and a clearly better one is an error.

    Raises InputError for maps that cannot be read, are of another size, in another frame, or of too few scenes.
    """
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._+ ()/-]{0,59}", name):
        expected = "1 to 60 letters, digits, spaces and ._+-()/, the first a letter or digit"
        raise InputError("--name", got=name, expected=expected)
    source, timed = _source(benchmark, given)
    maps: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    seconds: dict[str, float] = {}
    for scene in benchmark.scenes:
        began = time.perf_counter()
        found = source(scene)
        if found is not None:
            maps[scene.id] = found
            seconds[scene.id] = time.perf_counter() - began if timed else NAN
    missing = tuple(scene.id for scene in benchmark.scenes if scene.id not in maps)
    if len(maps) < LEAST_SHARE * len(benchmark.scenes):
        expected = f"at least {LEAST_SHARE:.0%}, such as {benchmark.scenes[0].id}.npy"
        raise InputError("normal maps", got=f"of {len(maps)} of {len(benchmark.scenes)} scenes", expected=expected)
    used = _checked_frame(benchmark, maps, frame)
    maps = {key: (used.to_camera(normals), valid) for key, (normals, valid) in maps.items()}
    scores = [_scene_score(scene, benchmark.truth(scene), maps.get(scene.id), seconds) for scene in benchmark.scenes]
    row = row_of(benchmark, name, scores, missing)
    stem = f"{file_stem(name)}-{benchmark.name}"
    folder.mkdir(parents=True, exist_ok=True)
    write_text(folder / f"{stem}.json", row_text(row))
    path = folder / f"{stem}.zip"
    with replacing(path) as partial:
        _write_zip(partial, row, maps)
    return row, path


def file_stem(name: str) -> str:
    """A method's name as part of a file's name, with a hyphen for what no file's name should have.

    >>> file_stem("a network (lab/net.py)")
    'a-network-lab-net.py'
    """
    return re.sub(r"[ ()/]+", "-", name).strip("-")


# ---- where normals come from ---------------------------------------------------------------------------------------


def _source(benchmark: Benchmark, given: str) -> tuple[Normals, bool]:
    """(a function from a scene to its normals or None, whether its time is that of the method)."""
    if given in METHODS:
        return lambda scene: _by_our_method(given, benchmark.picture(scene)), True
    if Path(given).is_dir():
        return lambda scene: _from_folder(Path(given), scene, benchmark.truth(scene)), False
    if ":" in given:
        function = _loaded(given)
        return lambda scene: _by_function(function, given, benchmark.picture(scene)), True
    expected = "a folder of normal maps, module:function, or the name of a method"
    raise InputError("--submit", got=given, expected=expected)


def _by_our_method(name: str, observation: Observation) -> tuple[np.ndarray, np.ndarray]:
    from huesphere.recover.run import recover_one

    estimate = recover_one(observation, name)
    return estimate.normals.astype(np.float64), estimate.valid


def _from_folder(folder: Path, scene: BenchmarkScene, truth: SceneTruth) -> tuple[np.ndarray, np.ndarray] | None:
    """The map <scene>.<ending> or <scene>/<transport>.<ending> in ``folder``; None if there is none."""
    stems = (folder / scene.id, folder / scene.id / scene.transport)
    found = [stem.with_name(stem.name + ending) for stem in stems for ending in SUFFIXES]
    files = [path for path in found if path.is_file()]
    if len(files) > 1:
        raise InputError("two normal maps for one scene", got=files[1].name, expected="one", where=files[0])
    if not files:
        return None
    height, width = truth.mask.shape
    read = read_map(files[0], (height, width), truth.mask)
    return read.vectors, read.valid


def _loaded(given: str) -> Callable[[np.ndarray, np.ndarray], Any]:
    """The function that "module:function" names; modules in the current folder are found too. Raises InputError."""
    module, _, name = given.partition(":")
    here = str(Path.cwd())
    sys.path.insert(0, here)
    try:
        function = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError("--submit", got=f"{given}: {error}", expected="module:function that can be imported") from None
    finally:
        sys.path.remove(here)
    if not callable(function):
        raise InputError("--submit", got=f"{given} is no function", expected="module:function")
    return function  # type: ignore[no-any-return]


def _by_function(function: Callable[..., Any], given: str, observation: Observation) -> tuple[np.ndarray, np.ndarray]:
    """What a user's function gives for a picture: normals (H, W, 3) in the camera frame, NaN or zero for none."""
    normals = np.asarray(function(observation.rgb.copy(), observation.mask.copy()), dtype=np.float64)
    if normals.shape != observation.rgb.shape:
        expected = f"normals of shape {observation.rgb.shape}"
        raise InputError("--submit", got=f"{given} gives shape {normals.shape}", expected=expected)
    length = np.linalg.norm(normals, axis=-1)
    with np.errstate(invalid="ignore"):
        valid = np.isfinite(length) & (length > 0)
    unit = np.full(normals.shape, np.nan)
    unit[valid] = normals[valid] / length[valid, None]
    return unit, valid


def _checked_frame(
    benchmark: Benchmark, maps: Mapping[str, tuple[np.ndarray, np.ndarray]], given: Frame | None
) -> Frame:
    """The frame of the maps. Raises InputError if most normals face away from the camera in it.

    So it does, unless the frame was ``given``, if another one agrees clearly better with the truth: a map in the wrong
    frame is a mistake of the sender, not of the method. The other solution (−x, −y, z) of a picture is no frame.
    """
    frame = given or OURS
    pairs = []
    for scene in benchmark.scenes:
        if scene.id in maps:
            normals, valid = maps[scene.id]
            truth = benchmark.truth(scene)
            both = np.flatnonzero(valid & truth.mask)
            at = both[:: max(1, both.size // FRAME_PIXELS)]
            pairs.append((normals.reshape(-1, 3)[at], truth.normals.reshape(-1, 3)[at]))
    mine, true = (np.concatenate(part) for part in zip(*pairs, strict=True))
    if not len(mine):
        return frame
    errors = {one.axes: median(angular_error_deg(one.to_camera(mine), true)) for one in FRAMES}
    turned = ("RUB", "LDB")  # ours and the other solution of the same picture
    best = min((one for one in FRAMES if one.axes not in turned or one == frame), key=lambda one: errors[one.axes])
    now, then = errors[frame.axes], errors[best.axes]
    clearly = then < min(BETTER_TIMES * now, now - BETTER_BY_DEG)
    if np.median(frame.to_camera(mine)[:, 2]) < 0 or (given is None and clearly):
        hint = f"; in the frame {best.name} the median error is {then:.1f}° instead of {now:.1f}°" if clearly else ""
        raise InputError("the frame of the maps", got=frame.description + hint, expected=f"--frame {best.name}")
    return frame


# ---- scores --------------------------------------------------------------------------------------------------------


def _scene_score(
    scene: BenchmarkScene,
    truth: SceneTruth,
    found: tuple[np.ndarray, np.ndarray] | None,
    seconds: Mapping[str, float],
) -> SceneScore:
    error = np.zeros(0)
    if found is not None:
        normals, valid = found
        inside = valid & truth.mask
        error = angular_error_deg(normals[inside], truth.normals[inside])
        error = error[np.isfinite(error)]
    columns = error_columns(error)
    pixels = int(truth.mask.sum())
    return SceneScore(
        scene.id,
        scene.shape,
        scene.surface,
        points_of(error, pixels),
        error.size / pixels if pixels else 0.0,
        columns.get("median_deg", NAN),
        columns.get("mean_deg", NAN),
        columns.get("p90_deg", NAN),
        seconds.get(scene.id, NAN),
    )


def row_of(benchmark: Benchmark, name: str, scores: Sequence[SceneScore], missing: Sequence[str] = ()) -> Row:
    """The row of a method, from its scores of all scenes."""
    points = np.array([score.points for score in scores])
    drawn = np.random.default_rng(0).integers(0, len(points), (RESAMPLES, len(points)))
    low, high = np.quantile(points[drawn].mean(axis=1), [0.025, 0.975])
    cells: dict[str, dict[str, list[float]]] = {}
    for score in scores:
        cells.setdefault(score.shape, {}).setdefault(score.surface, []).append(score.points)
    medians = np.array([180.0 if np.isnan(score.median_deg) else score.median_deg for score in scores])
    means = np.array([score.mean_deg for score in scores])
    return Row(
        name,
        benchmark.name,
        benchmark.sha256,
        benchmark.part,
        float(points.mean()),
        float(low),
        float(high),
        float(np.mean([score.coverage for score in scores])),
        float(np.median(medians)),
        float(np.nanmean(means)) if np.isfinite(means).any() else NAN,
        tuple(missing),
        {shape: {surface: float(np.mean(v)) for surface, v in own.items()} for shape, own in cells.items()},
        tuple(scores),
    )


# ---- files ---------------------------------------------------------------------------------------------------------


def row_text(row: Row) -> str:
    """A row as JSON: numbers with six significant digits, null for what is not known."""
    return json.dumps(_plain(asdict(row)), indent=1, sort_keys=True) + "\n"


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    if isinstance(value, float):
        return float(f"{value:.6g}") if np.isfinite(value) else None
    return value


def read_row(path: Path) -> Row:
    """The row in a JSON file that ``submit`` wrote. Raises InputError."""
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        entries: list[dict[str, Any]] = [
            {k: NAN if v is None else v for k, v in one.items()} for one in record["scenes"]
        ]
        scenes = tuple(SceneScore(**entry) for entry in entries)
        record = {k: NAN if v is None else v for k, v in record.items()}
        return Row(**record | {"scenes": scenes, "missing": tuple(record["missing"])})
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError("not a row of the leaderboard", got=f"{type(error).__name__}: {error}", where=path) from None


def _write_zip(path: Path, row: Row, maps: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> None:
    """Write row.json, scenes.csv and normals/<scene>.npy (float32, NaN for none, camera frame)."""
    fields = list(asdict(row.scenes[0]))
    lines = [",".join("" if v is None else str(v) for v in _plain(list(asdict(s).values()))) for s in row.scenes]
    files = {"row.json": row_text(row).encode(), "scenes.csv": "\n".join([",".join(fields), *lines, ""]).encode()}
    for name in sorted(maps):
        normals, valid = maps[name]
        buffer = io.BytesIO()
        np.save(buffer, np.where(valid[..., None], normals, np.nan).astype("<f4"))
        files[f"normals/{name}.npy"] = buffer.getvalue()
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            entry = zipfile.ZipInfo(name, ZIP_DATE)
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, content)
