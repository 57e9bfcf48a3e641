"""Study `real_photographs`: how far methods err on photographs of real objects, and which cause it is due to.

Each picture is a mixture of photographs under single lights (``render.photographs``). For one method the causes are
removed one at a time, with what calibrated photometric stereo from all photographs tells: uneven brightness by division
by the albedo, highlights by clipping each photograph to its diffuse fit, shadows by leaving pixels out; and the same
normals are shaded as a matte surface under the same lights, with and without that albedo.
"""

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.configs.load import load_config
from huesphere.configs.photographed import Photographs
from huesphere.configs.study import RealPhotographs
from huesphere.eval import metrics
from huesphere.eval.calibrated import BRIGHTNESS
from huesphere.eval.studies import plots
from huesphere.eval.studies.page import Figure, Section, Study, Table
from huesphere.eval.studies.pictures import Log, text
from huesphere.recover.methods.table import METHODS, check_methods
from huesphere.render.dataset import Observation
from huesphere.render.photographs.item import Mixed, mix, observed
from huesphere.render.photographs.read import open_photographs

TITLE = "What limits recovery on real photographs"
AS_IT_IS = "as it is"
SHADE = 0.5  # a photograph darker than this share of its diffuse fit is taken to lie in a shadow
SHINE = 1.1  # highlights are clipped to this multiple of the diffuse fit
LEAST_ALBEDO = 0.02  # of the median: darker paint is not divided out
SUITES = (".npz",)  # files of a folder that are sets by themselves


@dataclass(frozen=True)
class _Result:
    """One method on one picture. Degrees over the pixels with a normal; NaN without any."""

    object: str
    lights: str
    seed: int
    cause: str  # what was removed; AS_IT_IS: nothing
    method: str
    verdict: str
    median_deg: float
    mean_deg: float
    coverage: float
    stated: float  # median stated error over the median error
    condition: float  # of the best F
    misfit: float  # RMS of ρ − F n over RMS of ρ, with that F
    floor_deg: float  # median error of the best 3 × 3 matrix


def real_photographs(study: RealPhotographs, folder: Path, log: Log, jobs: int) -> Study:
    """Measure every set of photographs in ``study.path``; without one, the study says in one line that it is skipped.

    ``jobs``: processes. Raises InputError for a folder without sets.
    """
    if study.path is None:
        line = "Skipped: no folder of photographs is given (--set path=FOLDER)."
        return Study("real_photographs", TITLE, (line,), (), ({"skipped": line},))
    check_methods((*study.methods, study.causes_method))
    sets = sets_in(Path(study.path))
    work = [(path, kind, seed) for path in sets for kind in study.lights for seed in range(study.mixes)]
    results: list[_Result] = []
    measure = partial(_measure, study)
    if jobs < 2 or len(work) < 4:
        for number, one in enumerate(work, start=1):
            results += measure(one)
            log(f"{number} of {len(work)} pictures")
    else:
        # New processes, not forked ones: threads of numba do not survive a fork.
        with ProcessPoolExecutor(max_workers=jobs, mp_context=get_context("spawn")) as pool:
            for number, found in enumerate(pool.map(measure, work), start=1):
                results += found
                log(f"{number} of {len(work)} pictures")
    return Study("real_photographs", TITLE, _answer(study, results), _sections(study, results), _rows(results))


def sets_in(folder: Path) -> list[Path]:
    """The sets with true normals in ``folder``, sorted: npz files and folders. Raises InputError if there is none."""
    if not folder.is_dir():
        raise InputError("path: no such folder of photographs", where=folder)
    found = []
    for path in sorted(folder.iterdir()):
        if path.is_dir() or path.suffix.lower() in SUITES:
            try:
                open_photographs(Photographs(kind="photographs", path=str(path)))
            except InputError:
                continue
            found.append(path)
    if not found:
        raise InputError("path: no set of photographs with true normals", where=folder)
    return found


# ---- one picture -----------------------------------------------------------------------------------------------------


def _measure(study: RealPhotographs, work: tuple[Path, str, int]) -> list[_Result]:
    """All methods on one mixture, and one method on it without each of the causes."""
    path, lights, seed = work
    sets = [f"lights.0.colours={lights}", f"lights.0.seed={seed}", f"shape.reduce={study.reduce}"]
    config = load_config("photographs", overrides=sets, shape=str(path))
    mixed = mix(config)
    observation = observed(mixed, config)[0]
    name, normals = path.stem, mixed.photographs.normals
    methods = dict.fromkeys((*study.methods, study.causes_method))
    results = [_result((name, lights, seed, AS_IT_IS), method, observation, normals) for method in methods]
    for cause, changed in _without_causes(mixed, observation).items():
        results.append(_result((name, lights, seed, cause), study.causes_method, changed, normals))
    return results


def _result(of: tuple[str, str, int, str], method: str, observation: Observation, normals: np.ndarray) -> _Result:
    estimate = METHODS[method](observation)
    mask = observation.mask
    error = metrics.angular_error_deg(estimate.normals, normals)[mask]
    given = np.isfinite(error)
    rgb, true = observation.rgb[mask].astype(float), normals[mask].astype(float)
    F = metrics.fit_colour_matrix(rgb, true)
    misfit = float(np.sqrt(np.mean((rgb - true @ F.T) ** 2) / np.mean(rgb**2)))
    floor = metrics.linear_floor(rgb, true)[1]
    median = float(np.median(error[given])) if given.any() else metrics.NAN
    stated = float(np.median(estimate.uncertainty_deg[mask][given])) / median if given.any() else metrics.NAN
    mean = float(error[given].mean()) if given.any() else metrics.NAN
    share, condition = float(given.mean()), metrics.colour_condition(F)
    return _Result(*of, method, estimate.verdict, median, mean, share, stated, condition, misfit, floor)


def _without_causes(mixed: Mixed, observation: Observation) -> dict[str, Observation]:
    """The picture with one cause of error removed each, by name; {} where the lights' directions are not known."""
    directions = mixed.photographs.directions
    if not np.isfinite(directions).all():
        return {}
    albedo = calibrated_albedo(mixed)
    numbers, mask = mixed.mixture.numbers, mixed.photographs.mask
    cosine = np.einsum("hwk,lk->lhw", np.nan_to_num(mixed.photographs.normals).astype(float), directions[numbers])
    shading = np.maximum(cosine, 0.0)
    fit = albedo[None] * shading[:, None]  # (L, 3, H, W), the diffuse light of each photograph
    even = np.where(mask, np.maximum(albedo.mean(axis=0) / np.median(albedo[:, mask]), LEAST_ALBEDO), 1.0)
    lit = mask & (mixed.images.mean(axis=1) > SHADE * fit.mean(axis=1)).all(axis=0) & (cosine > 0).all(axis=0)

    def picture(images: np.ndarray) -> np.ndarray:
        colour = np.einsum("lchw,lc->hwc", images, mixed.mixture.weights)
        bright = float(np.percentile(colour[mask], 99.9))
        return (0.9 * colour / bright if bright > 0 else colour).astype(np.float32)

    divided = picture(mixed.images / even)
    matte = np.broadcast_to(shading[:, None], mixed.images.shape)
    return {
        "divided by its albedo": replace(observation, rgb=divided),
        "shadows left out": replace(observation, mask=lit),
        "divided, shadows left out": replace(observation, rgb=divided, mask=lit),
        "highlights clipped": replace(observation, rgb=picture(np.minimum(mixed.images, SHINE * fit))),
        "shaded with its albedo": replace(observation, rgb=picture(matte * even)),
        "shaded, even": replace(observation, rgb=picture(matte)),
    }


def calibrated_albedo(mixed: Mixed) -> np.ndarray:
    """(3, H, W) albedo of each channel by calibrated least squares from all photographs of the set; 0 off the object.

    The normal is that of `eval.calibrated`, and the albedo of a channel its length along that normal.
    """
    photographs = mixed.photographs
    inverse = np.linalg.pinv(photographs.directions)  # (3, N)
    g = np.zeros((3, 3, *photographs.mask.shape))  # direction, channel
    for number in range(photographs.count):
        rgb = np.where(photographs.mask[..., None], photographs.picture(number)[0], 0.0)
        g += np.einsum("k,hwc->kchw", inverse[:, number], rgb)
    along = np.einsum("kchw,c->khw", g, BRIGHTNESS)
    length = np.linalg.norm(along, axis=0)
    n = along / np.where(length > 0, length, 1.0)
    return np.maximum(np.einsum("kchw,khw->chw", g, n), 0.0)


# ---- the page --------------------------------------------------------------------------------------------------------


def _rows(results: Sequence[_Result]) -> tuple[dict[str, Any], ...]:
    return tuple(vars(result) for result in results)


def _median(results: Sequence[_Result], key: str) -> float:
    """Median over pictures; NaN where no picture has a number."""
    values = [v for v in (float(getattr(r, key)) for r in results) if np.isfinite(v)]
    return float(np.median(values)) if values else metrics.NAN


def _answer(study: RealPhotographs, results: Sequence[_Result]) -> tuple[str, ...]:
    """The answer in short, with its numbers."""
    plain = [r for r in results if r.cause == AS_IT_IS]
    trusted = [r for r in plain if r.verdict == "trust"]
    wrong = [r for r in trusted if r.median_deg > 10]
    own = [r for r in results if r.method == study.causes_method]
    first = (
        f"Over {len({(r.object, r.lights, r.seed) for r in plain})} pictures "
        f"of {len({r.object for r in plain})} objects, "
        + "; ".join(
            f"{method}: {text(_median([r for r in plain if r.method == method], 'median_deg'))}°"
            for method in study.methods
        )
        + f" (median of the pictures' medians). {len(trusted)} results are trusted, "
        f"{len(wrong)} of them off by over 10°."
    )
    causes = {r.cause: None for r in own if r.cause != AS_IT_IS}
    before = _median([r for r in own if r.cause == AS_IT_IS], "median_deg")
    second = f"With one cause removed at a time, {study.causes_method} goes from {text(before)}° to " + ", ".join(
        f"{text(_median([r for r in own if r.cause == cause], 'median_deg'))}° ({cause})" for cause in causes
    )
    return (first, second + ".") if causes else (first,)


def _sections(study: RealPhotographs, results: Sequence[_Result]) -> tuple[Section, ...]:
    plain = [r for r in results if r.cause == AS_IT_IS]
    cases = list(dict.fromkeys((r.object, r.lights) for r in plain))
    return (
        Section(
            "Errors",
            (
                (
                    f"Medians over {study.mixes} mixtures of the median error over the pixels with a normal; in "
                    "brackets how many results are trusted, doubtful, failed. The floor is the best single 3 × 3 "
                    "matrix; misfit and cond F are those of the best F. "
                    f"Means over {study.reduce} × {study.reduce} pixels."
                ),
            ),
            tables=(_errors(study, plain, cases),),
        ),
        Section(
            "One cause removed at a time",
            (
                (
                    f"Method {study.causes_method}. The albedo is that of calibrated photometric stereo from all "
                    "photographs of the set. Sets without known directions are left out."
                ),
            ),
            tables=(_causes(study, results, cases),),
        ),
        Section(
            "The number that decides",
            ("Condition of F times misfit, and the error of the best matrix and of the method.",),
            figures=_figures(study, plain),
        ),
    )


def _errors(study: RealPhotographs, plain: Sequence[_Result], cases: Sequence[tuple[str, str]]) -> Table:
    rows = []
    for name, lights in cases:
        of = [r for r in plain if (r.object, r.lights) == (name, lights)]
        cells = [f"{name}, {lights}", text(_median(of, "condition")), f"{_median(of, 'misfit'):.1%}"]
        cells.append(text(_median(of, "floor_deg")))
        for method in study.methods:
            own = [r for r in of if r.method == method]
            counts = "/".join(str(sum(r.verdict == v for r in own)) for v in ("trust", "doubtful", "failed"))
            cells.append(f"{text(_median(own, 'median_deg'))} ({counts})")
        rows.append(tuple(cells))
    return Table(("object, lights", "cond F", "misfit", "floor", *study.methods), tuple(rows))


def _causes(study: RealPhotographs, results: Sequence[_Result], cases: Sequence[tuple[str, str]]) -> Table:
    own = [r for r in results if r.method == study.causes_method]
    causes = list(dict.fromkeys(r.cause for r in own))
    known = [case for case in cases if len({r.cause for r in own if (r.object, r.lights) == case}) > 1]
    rows = [
        (
            cause,
            *(
                text(_median([r for r in own if r.cause == cause and (r.object, r.lights) == case], "median_deg"))
                for case in known
            ),
        )
        for cause in causes
    ]
    return Table(("picture", *(f"{name}, {lights}" for name, lights in known)), tuple(rows))


def _figures(study: RealPhotographs, plain: Sequence[_Result]) -> tuple[Figure, ...]:
    own = [r for r in plain if r.method == study.causes_method]
    x = np.array([r.condition * r.misfit for r in own])
    lines: dict[str, tuple[np.ndarray, np.ndarray]] = {"best matrix": (x, np.array([r.floor_deg for r in own]))}
    for name in dict.fromkeys(r.object for r in own):
        chosen = [k for k, r in enumerate(own) if r.object == name]
        lines[f"{study.causes_method}, {name}"] = (x[chosen], np.array([own[k].median_deg for k in chosen]))
    return (
        plots.curves(
            "condition-misfit", "Error against cond F × misfit", lines, "cond F × misfit", "median error, degrees",
            log_x=True, log_y=True, joined=False,
        ),
    )  # fmt: skip
