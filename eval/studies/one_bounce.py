"""Study `one_bounce_study`: is it enough to model one bounce of light, for which albedos, shapes and lights?

The report treats mutual illumination by a model of one bounce. Scenes are rendered with one bounce and with all, and
the normals that methods recover from the two pictures are compared. *Indirect* light arrived after one or more
reflections; *rest* is the light after two or more.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from huesphere.configs.schema import RunConfig
from huesphere.configs.study import OneBounce
from huesphere.eval.metrics import error_image
from huesphere.eval.studies import plots
from huesphere.eval.studies.cases import KNOWN_F, Measured, estimate_of, known_lights_error, light_shares, measure_all
from huesphere.eval.studies.page import Figure, Section, Study, Table
from huesphere.eval.studies.pictures import Log, config_of, percent, read, read_image, render, text

TRANSPORTS = ("linear", "direct", "one-bounce", "full")
WEAK = "weak-integrability"
TABLE_CAPTION = (
    "Share of the light after one bounce and after more; RMS residual of ρ = Fn, with one bounce and with all; median "
    "errors in degrees under direct light / with one bounce / with all bounces"
)
WRONG_DEG = 20.0  # a result with status ok and a larger median error is listed as wrong without warning


@dataclass(frozen=True)
class _Scene:
    """One shape under one set of lights with one albedo."""

    shape: str
    lights: str
    albedo: float
    at: dict[str, Measured]  # by transport; `linear` and `direct` are measured once for all albedos, except exposure

    @property
    def rest(self) -> float:
        """Share of the light that arrived after two or more bounces."""
        return self.at["full"].shares[2]

    def change(self, method: str, other: str) -> float:
        """Absolute difference in degrees of a method's median errors in transport `full` and in ``other``."""
        return abs(self.at["full"].median_deg(method, flip=True) - self.at[other].median_deg(method, flip=True))


def one_bounce(study: OneBounce, folder: Path, log: Log, jobs: int) -> Study:
    """Render every combination of shape, lights and albedo, recover the pictures, and report when one bounce is enough.

    Pictures and estimates are kept in ``folder``/run. ``jobs``: processes.
    """
    run = folder / "run"
    configs = dict(_configs(study))
    render(list(configs.values()), run, log)
    wanted = [
        (f"{config.name}/{transport}", (*study.methods, *(study.slow_methods if transport == "full" else ())))
        for config in configs.values()
        for transport in config.render.transport
    ]
    measured = measure_all(run, wanted, jobs, log)
    scenes = [_scene(study, key, configs, measured) for key in configs]
    return Study(
        "one_bounce_study",
        "Is one bounce enough?",
        _answer(study, scenes),
        (
            _light_section(study, scenes),
            _enough_section(study, scenes),
            *(_error_section(study, scenes, lights) for lights in study.lights),
            _maps_section(study, run, configs),
        ),
        tuple(row for scene in scenes for row in _rows(scene)),
    )


def _configs(study: OneBounce) -> list[tuple[tuple[str, str, float], RunConfig]]:
    """((shape, lights, albedo), config) of each scene.

    `linear` and `direct`, which do not depend on the albedo, are rendered for the first albedo only.
    """
    found = []
    for shape, keys in study.shapes.items():
        for lights, sources in study.lights.items():
            for albedo in study.albedos:
                data = study.base | keys
                data["lights"] = sources
                data["surface"] = data.get("surface", {}) | {"reflectance": albedo}
                transports = TRANSPORTS if albedo == study.albedos[0] else TRANSPORTS[2:]
                data["render"] = data.get("render", {}) | {"transport": list(transports)}
                data["name"] = f"{_plain(shape)}-{_plain(lights)}-{albedo:g}"
                found.append(((shape, lights, albedo), config_of(data, f"shapes.{shape}")))
    return found


def _plain(name: str) -> str:
    """``name`` with ASCII letters and digits only, for file names."""
    return "".join(c if c.isalnum() and c.isascii() else "_" for c in name).strip("_")


def _scene(
    study: OneBounce,
    key: tuple[str, str, float],
    configs: dict[tuple[str, str, float], RunConfig],
    measured: dict[str, Measured],
) -> _Scene:
    """The scene with this (shape, lights, albedo), and what was measured of its pictures."""
    shape, lights, albedo = key
    first = configs[(shape, lights, study.albedos[0])].name
    own = configs[key].name
    at = {t: measured[f"{first if t in TRANSPORTS[:2] else own}/{t}"] for t in TRANSPORTS}
    return _Scene(shape, lights, albedo, at)


# ---- sentences -------------------------------------------------------------------------------------------------------


def _answer(study: OneBounce, scenes: Sequence[_Scene]) -> tuple[str, ...]:
    """The answer of the study in short, in paragraphs."""
    limit = study.enough_deg
    concave = [s for s in scenes if s.rest > 1e-6 and np.isfinite(s.change(KNOWN_F, "one-bounce"))]
    enough = [s for s in concave if s.change(KNOWN_F, "one-bounce") <= limit]
    none_needed = [s for s in concave if s.change(KNOWN_F, "direct") <= limit]
    border = _border(study, concave)
    worst = max(concave, key=lambda s: s.change(KNOWN_F, "one-bounce"))
    parts = [
        (
            f"One bounce is enough while light after two or more bounces is under {percent(border, 1)} of all light in "
            f"the picture: up to that share it changes the median error by no more than {text(limit)}° in any of "
            f"{len(concave)} scenes that have interreflection. One bounce is enough in {len(enough)} of them; in "
            f"{len(none_needed)} direct light alone would be. The largest change is that of {worst.shape}, albedo "
            f"{worst.albedo:g}, {_lit(worst.lights)}: {percent(worst.rest)} of the light and "
            f"{text(worst.change(KNOWN_F, 'one-bounce'))}°."
        ),
        (
            "These errors are those of n = F⁻¹ρ with the lights known, whose only error is interreflection. "
            f"{_by_shape(study, scenes)}"
        ),
    ]
    parts.append(_with_unknown_lights(study, scenes))
    return tuple(parts)


def _border(study: OneBounce, scenes: Sequence[_Scene]) -> float:
    """The largest share of light after two or more bounces up to which one bounce is enough in every scene."""
    bad = [s.rest for s in scenes if not s.change(KNOWN_F, "one-bounce") <= study.enough_deg]
    good = [s.rest for s in scenes if s.change(KNOWN_F, "one-bounce") <= study.enough_deg]
    below = [rest for rest in good if not bad or rest < min(bad)]
    return max(below) if below else 0.0


def _by_shape(study: OneBounce, scenes: Sequence[_Scene]) -> str:
    """A sentence that says up to which albedo one bounce is enough for each shape, under all sets of lights."""
    parts = []
    for shape in study.shapes:
        of_shape = [s for s in scenes if s.shape == shape]
        if max(s.rest for s in of_shape) <= 1e-6:
            parts.append(f"{shape} any (there is no interreflection)")
            continue
        if not any(np.isfinite(s.change(KNOWN_F, "one-bounce")) for s in of_shape):
            parts.append(f"{shape} unknown (no pixel sees every light)")
            continue
        bad = [s.albedo for s in of_shape if s.change(KNOWN_F, "one-bounce") > study.enough_deg]
        good = [a for a in study.albedos if not bad or a < min(bad)]
        parts.append(f"{shape} {'any' if not bad else f'{max(good):g}' if good else 'none'}")
    tried = ", ".join(f"{albedo:g}" for albedo in study.albedos)
    return f"Albedo up to which one bounce is enough under all lights: {'; '.join(parts)} (tried: {tried})."


def _with_unknown_lights(study: OneBounce, scenes: Sequence[_Scene]) -> str:
    """Sentences on methods that do not know the lights: how much bounces change, and what their removal improves."""
    both = [s for s in scenes if s.rest > 1e-6 and np.isfinite(s.change(WEAK, "one-bounce"))]
    if not both:
        return "No method that estimates the lights gives normals in both transports."
    same = sum(s.change(WEAK, "one-bounce") <= study.enough_deg for s in both)
    moved = float(np.median([s.change(WEAK, "direct") for s in both if np.isfinite(s.change(WEAK, "direct"))]))
    sentences = (
        f"With the lights unknown, {WEAK} gives normals in both transports in {len(both)} scenes, and its "
        f"error is the same within {text(study.enough_deg)}° in {same} of them; from direct to full transport it "
        f"changes by {text(moved)}° (median). "
    )
    for method in study.slow_methods:
        pairs = [(s.at["full"].median_deg(method, flip=True), s.at["full"].median_deg(WEAK, flip=True)) for s in scenes]
        finite = [(a, b) for a, b in pairs if np.isfinite(a) and np.isfinite(b)]
        if finite:
            slow, plain = np.median(finite, axis=0)
            sentences += (
                f"Under full transport the error of {method} is {text(slow)}° where that of {WEAK} is {text(plain)}° "
                f"(medians of {len(finite)} scenes)."
            )
    return sentences


# ---- sections --------------------------------------------------------------------------------------------------------


def _light_section(study: OneBounce, scenes: Sequence[_Scene]) -> Section:
    """The section on the shares of direct and indirect light, under the first set of lights."""
    lights = next(iter(study.lights))
    middle, most = study.albedos[len(study.albedos) // 2], study.albedos[-1]
    figures = []
    for albedo in dict.fromkeys((middle, most)):
        chosen = [s for s in scenes if s.lights == lights and s.albedo == albedo]
        parts = {
            "one bounce": [100 * s.at["full"].shares[1] for s in chosen],
            "two and more": [100 * s.at["full"].shares[2] for s in chosen],
        }
        names = [s.shape for s in chosen]
        title = f"Indirect light, albedo {albedo:g}"
        figures.append(plots.bars(f"shares-{albedo:g}", title, names, parts, "per cent of the light"))
    by_shape = {
        shape: (study.albedos, [100 * s.rest for s in scenes if s.shape == shape and s.lights == lights])
        for shape in study.shapes
        if max(s.rest for s in scenes if s.shape == shape) > 1e-6
    }
    figures.append(
        plots.curves("rest", "Light after two or more bounces", by_shape, "albedo", "per cent of the light", log_y=True)
    )
    return Section(
        "Where the light comes from",
        (
            (
                f"Shares of all light that the camera receives from the object, {_lit(lights)}. The share after k "
                "bounces grows as the k-th power of the albedo. In a room the first bounce includes light from the "
                "walls."
            ),
        ),
        figures=tuple(figures),
    )


# More than sixty lines: three figures, each with its data and labels.
def _enough_section(study: OneBounce, scenes: Sequence[_Scene]) -> Section:
    """The section on what light after two or more bounces changes, and on the residual of the linear model."""
    concave = [s for s in scenes if s.rest > 1e-6]
    points: dict[str, tuple[Any, Any]] = {}
    for method in (KNOWN_F, *study.methods[1:]):
        pairs = sorted(
            (100 * s.rest, max(s.change(method, "one-bounce"), 1e-3))
            for s in concave
            if np.isfinite(s.change(method, "one-bounce"))
        )
        if pairs:
            points[method] = tuple(np.array(pairs).T)  # type: ignore[assignment]
    changed = plots.curves(
        "enough",
        "Change of the error by light after two or more bounces",
        points,
        "share of that light, per cent",
        "change of the median error, degrees",
        log_x=True,
        log_y=True,
        joined=False,
        level=study.enough_deg,
        caption="Each point is a scene; below the line the change counts as none.",
    )
    residuals = {
        transport: (
            [100 * (1 - s.at["full"].shares[0]) for s in concave],
            [100 * max(s.at[transport].residual, 1e-6) for s in concave],
        )
        for transport in ("one-bounce", "full")
    }
    linear = plots.curves(
        "residual",
        "Residual of the linear model",
        residuals,
        "indirect light, per cent",
        "RMS of ρ − Fn, per cent",
        log_x=True,
        log_y=True,
        joined=False,
        caption="With the best F, over pixels that see every light. Grooves have only two normals: their residual is "
        "the variation along each wall.",
    )
    by_quarter = {
        name: (
            [100 * (1 - s.at["full"].shares[0]) for s in concave],
            [max(getattr(s.at["full"], attribute), 1e-3) for s in concave],
        )
        for name, attribute in (
            ("quarter with the least", "least_indirect_deg"),
            ("quarter with the most", "most_indirect_deg"),
        )
    }
    where = plots.curves(
        "where",
        "Error with known lights, by the indirect light of the pixel",
        by_quarter,
        "indirect light of the picture, per cent",
        "median error, degrees",
        log_x=True,
        log_y=True,
        joined=False,
        caption="Full transport.",
    )
    return Section("When it is enough", (_residual_sentence(concave),), figures=(changed, linear, where))


def _residual_sentence(scenes: Sequence[_Scene]) -> str:
    """Sentences on the part of the indirect light that no single matrix fits, with one bounce and with all."""
    per_light = {}
    for transport in ("one-bounce", "full"):
        pairs = [(s.at[transport].residual, 1 - s.at[transport].shares[0]) for s in scenes]
        per_light[transport] = float(np.median([r / share for r, share in pairs if np.isfinite(r) and share > 0]))
    one, every = per_light["one-bounce"], per_light["full"]
    return (
        "The report treats mutual illumination as a distant source in a model of one bounce only (2.5). The residual "
        f"of the best matrix in ρ = Fn is {text(one)} times the share of indirect light with one bounce and "
        f"{text(every)} times with all bounces (medians). So the linear model is violated because the indirect light "
        "comes from different places at different points, and "
        f"{'hardly' if abs(every / one - 1) < 0.2 else 'also'} because of the number of its reflections."
    )


def _error_section(study: OneBounce, scenes: Sequence[_Scene], lights: str) -> Section:
    """The section with the errors of all methods under one set of lights."""
    chosen = [s for s in scenes if s.lights == lights]
    methods = (*study.methods, *study.slow_methods, KNOWN_F)
    head = (
        "shape, albedo",
        "1 bounce",
        "2 and more",
        "residual, 1 bounce",
        "residual, all",
        *(f"{method}, {'direct / 1 / all' if method not in study.slow_methods else 'all'}" for method in methods),
    )
    rows = []
    for s in chosen:
        full = s.at["full"]
        cells = [
            f"{s.shape}, {s.albedo:g}".replace(" ", "\u00a0"),
            percent(full.shares[1], 1),
            percent(full.shares[2], 1),
        ]
        cells += [percent(s.at[t].residual, 2) for t in ("one-bounce", "full")]
        for method in methods:
            transports = TRANSPORTS[1:] if method not in study.slow_methods else TRANSPORTS[3:]
            cells.append(" / ".join(_degrees(s.at[t], method) for t in transports))
        rows.append(tuple(cells))
    shown = [
        s
        for s in study.shapes
        if sum(np.isfinite(c.at["full"].median_deg(WEAK, flip=True)) for c in chosen if c.shape == s) >= 2
    ]
    figures = [
        plots.curves(
            f"errors-{lights}-{_plain(shape)}",
            f"{shape[:1].upper()}{shape[1:]}, {_lit(lights)}",
            {
                f"{method}, {transport}": (
                    study.albedos,
                    [c.at[transport].median_deg(method, flip=True) for c in chosen if c.shape == shape],
                )
                for method in (WEAK, KNOWN_F)
                for transport in TRANSPORTS[1:]
            },
            "albedo",
            "median error, degrees",
        )
        for shape in shown
    ]
    return Section(
        f"Errors under {_lit(lights)}",
        (
            (
                "Median angular error in degrees over the pixels for which a method gives normals, of the normals or "
                "of their convex/concave twin if that is smaller; – where its status is not ok. The walls of a groove "
                "have only two normals, which do not determine an ellipsoid, so only known lights give its normals."
            ),
            _wrong_without_warning(chosen, methods),
        ),
        tables=(Table(tuple(head), tuple(rows), TABLE_CAPTION),),
        figures=tuple(figures),
    )


def _wrong_without_warning(scenes: Sequence[_Scene], methods: Sequence[str]) -> str:
    """A sentence on the results with status ok and an error over WRONG_DEG, by method and shape."""
    parts = []
    for method in methods:
        ok = [(s.shape, m.median_deg(method, flip=True)) for s in scenes for m in s.at.values()]
        wrong = [shape for shape, error in ok if error > WRONG_DEG]
        if wrong:
            given = sum(np.isfinite(error) for _, error in ok)
            parts.append(f"{method} {len(wrong)} of {given} ({', '.join(dict.fromkeys(wrong))})")
    if not parts:
        return f"No result with status ok is over {WRONG_DEG:g}° off."
    return f"Results with status ok that are over {WRONG_DEG:g}° off: {'; '.join(parts)}."


def _degrees(measured: Measured, method: str) -> str:
    """The median error of a method with two significant digits and at most three decimals: a cell holds three."""
    value = measured.median_deg(method, flip=True)
    return "<0.001" if value < 0.0005 else f"{value:.3f}" if value < 0.0095 else text(value)


def _lit(lights: str) -> str:
    """The name of a set of lights as words of a sentence: "natural lights", "gels"."""
    return lights if lights.endswith("s") else f"{lights} lights"


def _error_map(method: str, transport: str, error: np.ndarray) -> Figure:
    """The figure of an angular error (H, W) in degrees."""
    title = f"Error of {method}, {transport}" if method != KNOWN_F else f"Error with known lights, {transport}"
    key = f"map-{method.replace(' ', '-')}-{transport}"
    return plots.field(key, title, error, "error, degrees", limits=(0.03, 90.0), log=True)


def _maps_section(study: OneBounce, run: Path, configs: dict[tuple[str, str, float], RunConfig]) -> Section:
    """The section with images of one scene: its picture, its indirect light, and the errors of methods."""
    shape, lights, albedo = study.maps
    name = configs[(shape, lights, albedo)].name
    full = read(run, f"{name}/full")
    indirect = 100 * light_shares(full)[1]
    top = max(5.0, float(np.nanpercentile(indirect, 99)))
    figures = [
        plots.photo("map-picture", "The picture, full", read_image(full.folder / "preview.png")),
        plots.field("map-indirect", "Indirect light", indirect, "per cent", limits=(0, top)),
    ]
    for transport in ("one-bounce", "full"):
        picture = read(run, f"{name}/{transport}")
        figures.append(_error_map(KNOWN_F, transport, known_lights_error(picture)))
        for method in (WEAK, *(study.slow_methods if transport == "full" else ())):
            estimate = estimate_of(picture, method)
            error = error_image(estimate.normals, estimate.valid, picture.truth.normals, picture.mask)
            figures.append(_error_map(method, transport, error))
    return Section(f"Where in the picture: {shape}, {_lit(lights)}, albedo {albedo:g}", (), figures=tuple(figures))


def _rows(scene: _Scene) -> list[dict[str, Any]]:
    """The rows of results.csv for one scene, one for each transport and method."""
    rows = []
    for transport, measured in scene.at.items():
        for row in measured.rows:
            rows.append(
                {
                    "shape": scene.shape,
                    "lights": scene.lights,
                    "albedo": scene.albedo,
                    "transport": transport,
                    "method": row.method,
                    "status": row.status,
                    "coverage": row.coverage,
                    "median_deg": row.median_deg,
                    "median_deg_flip": row.median_deg_flip,
                    "mean_deg": row.mean_deg,
                    "p95_deg": row.p95_deg,
                    "median_deg_gauge": row.median_deg_gauge,
                    "share_direct": measured.shares[0],
                    "share_one_bounce": measured.shares[1],
                    "share_rest": measured.shares[2],
                    "linear_residual": measured.residual,
                    "least_indirect_quarter_deg": measured.least_indirect_deg,
                    "most_indirect_quarter_deg": measured.most_indirect_deg,
                }
            )
    return rows
