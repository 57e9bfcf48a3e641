"""Scores a run folder: reads pictures, truth and estimates from disk, and raises an error if they do not match.

An *item* is one picture of a run, with the id ``<config>/<transport>``; a *case* is one method on one item. Nothing
here runs a method or draws a figure.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.configs.load import read_yaml
from huesphere.configs.own_folder import inside
from huesphere.eval import metrics
from huesphere.eval.calibration import count_errors
from huesphere.eval.frames import OURS, Frame
from huesphere.eval.metrics import Row
from huesphere.eval.normal_map import read_normal_map
from huesphere.eval.references import REFERENCES
from huesphere.eval.regions import RegionErrors, errors_by_region, region_map
from huesphere.eval.verdict import NO_VERDICT, Verdict, verdict_of
from huesphere.recover.io.estimate import Estimate, read_estimate
from huesphere.render.dataset import TRANSPORTS, Observation, Truth, read_observation, read_truth
from huesphere.render.manifest import item_folder, read_manifest, sha256_of
from huesphere.render.results import results_root

# Edges in degrees of the histogram that every score carries: ten bins a decade, 0.001 to 180, shared by all reports.
HISTOGRAM_EDGES_DEG = np.concatenate([[0.0], np.geomspace(1e-3, 100.0, 51), [180.0]])
QUANTILES = np.linspace(0.0, 1.0, 401)


@dataclass(frozen=True)
class Item:
    """One picture of a run, as the manifest lists it."""

    config: str
    transport: str
    status: str  # "done", or the renderer's name of the failure
    folder: Path
    methods: tuple[str, ...]  # that the item's config.yaml asks for; () if it cannot be read
    external: Mapping[str, Path] = field(default_factory=dict)  # normal maps of other programs, by name of method
    frames: Mapping[str, Frame] = field(default_factory=dict)  # of these maps, by name of method; others are in ours
    results: Path | None = None  # folder outside the run with further estimates; None: there is none

    @property
    def id(self) -> str:
        """<config>/<transport>."""
        return f"{self.config}/{self.transport}"

    @property
    def estimate_folders(self) -> tuple[Path, ...]:
        """Where estimates may lie, in the order in which they are looked for."""
        return tuple(place / "estimates" for place in (self.results, self.folder) if place is not None)

    def estimates_of(self, method: str) -> Path | None:
        """The folder that has the method's estimate; None if there is none on disk."""
        return next((place for place in self.estimate_folders if (place / f"{method}.json").is_file()), None)


@dataclass(frozen=True)
class Scene:
    """An item's picture and truth, and the numbers that depend on these only."""

    item: Item
    observation: Observation
    truth: Truth
    sha256: str  # of observation.exr
    mask: np.ndarray  # (H, W) bool, object pixels: in the truth's mask, with a finite true normal
    floor_deg: float  # as Row.oracle_linear_median_deg
    cond_F: float  # as Row.cond_F


@dataclass(frozen=True)
class Score:
    """The numbers of one case, without images: its row of metrics.csv and the distribution of its errors."""

    row: Row
    quantiles_deg: np.ndarray  # (401,) errors at QUANTILES of the scored pixels; NaN where nothing was scored
    counts: np.ndarray  # (52,) int, scored pixels per bin of HISTOGRAM_EDGES_DEG
    verdict: Verdict = NO_VERDICT  # what the method says of its own result
    regions: tuple[RegionErrors, ...] = ()  # errors by what the light does at a pixel
    stated: np.ndarray | None = None  # scored pixels by stated and true error (eval.calibration); None: none stated

    def __repr__(self) -> str:
        row = self.row
        told = f", {row.verdict}" if row.verdict else ""
        return (
            f"Score({row.method} on {row.config}/{row.transport}: {row.status}{told}, "
            f"median {row.median_deg:.3g}°, mean {row.mean_deg:.3g}°, {row.coverage:.0%} covered)"
        )


@dataclass(frozen=True)
class Case:
    """One case with its images."""

    score: Score
    estimate: Estimate | None  # None if there is none on disk; then the score has the status "missing"
    error_deg: np.ndarray  # (H, W) float64, NaN where not scored


def read_items(run_dir: Path, out: Path | None = None) -> list[Item]:
    """Return the items of a run: configs in the manifest's order, transports from `linear` to `full`.

    ``out``: folder outside the run that has further estimates (``render.results``). Raises InputError if the manifest
    is damaged or has no items.
    """
    items = []
    root = results_root(run_dir, out)
    for entry in read_manifest(run_dir)["items"]:
        config, _, transport = str(entry["id"]).rpartition("/")
        if not config or not transport:
            raise InputError(
                "item id", got=entry["id"], expected="<config>/<transport>", where=run_dir / "manifest.json"
            )
        folder = item_folder(run_dir, entry["id"])
        results = None if root == run_dir else item_folder(root, entry["id"])
        items.append(
            Item(config, transport, str(entry["status"]), folder, _configured_methods(folder), results=results)
        )
    if not items:
        raise InputError("the run holds no items", where=run_dir / "manifest.json")
    return sorted(items, key=_order([item.config for item in items]))


def methods_on_disk(item: Item) -> tuple[str, ...]:
    """Names of the methods that have an estimate of the item on disk, sorted. Raises InputError for a link."""
    for place in item.estimate_folders:
        if place.is_symlink() or (place.exists() and not place.is_dir()):
            raise InputError("not a folder", where=place)
    return tuple(sorted({path.stem for place in item.estimate_folders for path in place.glob("[!.]*.json")}))


def methods_to_score(item: Item, wanted: Sequence[str] = ()) -> tuple[str, ...]:
    """Return ``wanted``, or if empty the config's methods and all others with an estimate; and external maps."""
    if wanted:
        return tuple(dict.fromkeys((*wanted, *item.external)))
    return tuple(dict.fromkeys((*item.methods, *methods_on_disk(item), *item.external)))


def read_scene(item: Item) -> Scene:
    """Read picture and truth of an item. Raises InputError where a file is missing, damaged, or of another size."""
    path = inside(item.folder, "observation.exr")
    observation, truth = read_observation(path), read_truth(inside(item.folder, "truth.exr"))
    if observation.mask.shape != truth.mask.shape:
        raise InputError("truth.exr and observation.exr differ in size", where=item.folder)
    mask = truth.mask & np.isfinite(truth.normals).all(axis=-1)
    floor, condition = _floor_and_condition(observation.rgb, truth, mask)
    return Scene(item, observation, truth, sha256_of(path), mask, floor, condition)


def score_case(scene: Scene, method: str) -> Case:
    """Score one method on one picture.

    Raises InputError where the estimate is damaged, of another size, or was made from another picture.
    """
    item, truth = scene.item, scene.truth
    row = Row(item.config, item.transport, method, "missing", knows=REFERENCES.get(method, ""))
    row = replace(row, oracle_linear_median_deg=scene.floor_deg, cond_F=scene.cond_F)
    not_scored = np.full(scene.mask.shape, metrics.NAN)
    estimate = _estimate(scene, method)
    if estimate is None:
        row = replace(row, pixels=int(scene.mask.sum()), message="no estimate on disk")
        return Case(replace(score_of(row, not_scored), verdict=verdict_of(row)), None, not_scored)
    error = metrics.error_image(estimate.normals, estimate.valid, truth.normals, scene.mask)
    row = replace(row, status=estimate.status, seconds=estimate.seconds, message=estimate.message)
    row = replace(row, verdict="" if method in item.external else estimate.verdict)
    stated = estimate.uncertainty_deg
    row = metrics.measure(row, error, estimate.normals, truth.normals, scene.mask, estimate.inlier, stated)
    row = metrics.reason_shares(row, estimate.reason, scene.mask)
    regions = errors_by_region(region_map(truth, estimate.reason, scene.mask), error, stated)
    medians = {f"{one.region.replace(' ', '_')}_median_deg": one.median_deg for one in regions}
    row = replace(row, **medians)  # type: ignore[arg-type]
    counts = count_errors(stated, error)
    judged = replace(
        score_of(row, error),
        verdict=verdict_of(row, estimate.doubts),
        regions=regions,
        stated=counts if counts.any() else None,
    )
    return Case(judged, estimate, error)


def _estimate(scene: Scene, method: str) -> Estimate | None:
    """Return a method's estimate, from an external normal map or from the item's folder; None if there is none.

    Raises InputError if it is damaged or was made from another picture.
    """
    if method in scene.item.external:
        height, width = scene.mask.shape
        frame = scene.item.frames.get(method, OURS)
        return read_normal_map(scene.item.external[method], method, (height, width), frame=frame, mask=scene.mask)
    folder = scene.item.estimates_of(method)
    if folder is None:
        return None
    estimate, sha256 = read_estimate(folder, method)
    if sha256 != scene.sha256:
        raise InputError(
            "this estimate was made from another picture than the observation.exr beside it: "
            "make it again with evaluate --overwrite",
            where=folder / f"{method}.json",
        )
    if estimate.valid.shape != scene.mask.shape:
        raise InputError("the estimate is not of the picture's size", where=folder / f"{method}.exr")
    return estimate


def score_of(row: Row, error_deg: np.ndarray) -> Score:
    """Return ``row`` with the distribution of ``error_deg``, an (H, W) image with NaN where not scored."""
    error = error_deg[np.isfinite(error_deg)]
    quantiles = metrics.quantiles(error, QUANTILES) if error.size else np.full(QUANTILES.shape, metrics.NAN)
    return Score(row, quantiles, np.histogram(error, HISTOGRAM_EDGES_DEG)[0])


def pooled(scores: Sequence[Score]) -> Score:
    """Return the distribution of errors over several pictures.

    Each picture counts in proportion to its coverage, whatever its number of pixels: a picture of which the method
    leaves out half has half the weight. In ``counts``, which are sums of the pictures' counts, large pictures do count
    more. The row's ``pixels`` and ``scored`` are sums and its coverage is the mean. Every score must have scored
    pixels.
    """
    if len(scores) == 1:
        return scores[0]
    pixels, given = sum(s.row.pixels for s in scores), sum(s.row.scored for s in scores)
    coverage = float(np.mean([s.row.coverage for s in scores]))
    row = replace(scores[0].row, pixels=pixels, scored=given, coverage=coverage)
    samples = np.concatenate([s.quantiles_deg for s in scores])
    weights = np.repeat([s.row.coverage for s in scores], QUANTILES.size)
    errors = np.quantile(samples, QUANTILES, weights=weights, method="inverted_cdf")
    stated = [s.stated for s in scores if s.stated is not None]
    counts = np.sum([s.counts for s in scores], axis=0)
    return Score(row, errors, counts, stated=np.sum(stated, axis=0) if stated else None)


def in_order(transports: Iterable[str]) -> list[str]:
    """The distinct levels of transport, from `linear` to `full`; others after them."""
    known = {transport: n for n, transport in enumerate(TRANSPORTS)}
    return sorted(dict.fromkeys(transports), key=lambda transport: known.get(transport, len(known)))


def unscored(item: Item, methods: Sequence[str]) -> list[Score]:
    """Return scores without numbers, one for each method, for an item that was not rendered; status is the item's."""
    message = "the picture was not rendered: nothing to recover from"
    rows = [Row(item.config, item.transport, method, item.status, message=message) for method in methods or ("",)]
    return [replace(score_of(row, np.full((1, 1), metrics.NAN)), verdict=verdict_of(row)) for row in rows]


def _order(configs: Sequence[str]) -> Callable[[Item], tuple[int, int]]:
    """A key to sort items by: place of their config in ``configs``, then place of their transport in TRANSPORTS."""
    first = {config: n for n, config in reversed(list(enumerate(configs)))}
    known = {transport: n for n, transport in enumerate(TRANSPORTS)}
    return lambda item: (first[item.config], known.get(item.transport, len(known)))


def _configured_methods(folder: Path) -> tuple[str, ...]:
    """The methods that the config.yaml in an item's folder asks for; () if there is none. Raises InputError."""
    path = inside(folder, "config.yaml")
    if not path.exists():
        return ()
    try:
        return tuple(str(method) for method in read_yaml(path)[0]["recover"]["methods"])
    except (KeyError, TypeError):
        return ()


def _floor_and_condition(rgb: np.ndarray, truth: Truth, mask: np.ndarray) -> tuple[float, float]:
    """(Row.oracle_linear_median_deg, Row.cond_F) of a picture (H, W, 3); NaN with fewer than three usable pixels."""
    usable = mask & np.isfinite(rgb).all(axis=-1)
    if usable.sum() < 3:
        return metrics.NAN, metrics.NAN
    colours, normals = rgb[usable], truth.normals[usable]
    F = truth.facts.get("F")
    if F is None:
        F = metrics.fit_colour_matrix(colours, normals)
    return metrics.linear_floor(colours, normals)[1], metrics.colour_condition(np.asarray(F))
