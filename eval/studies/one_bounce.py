"""Is one bounce enough? Full light transport against the one-bounce assumption, by albedo, concavity and lights."""

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
    "Share of the light by one bounce and by more; RMS residual of ρ = Fn, with one bounce and with all; median errors "
    "in degrees under direct light / with one bounce / with all"
)
WRONG_DEG = 20.0  # a result that says ok and errs by more is confident and wrong


@dataclass(frozen=True)
class _Scene:
    """One shape under one set of lights with one albedo."""

    shape: str
    lights: str
    albedo: float
    at: dict[str, Measured]  # by transport; `linear` and `direct` are the same for every albedo but for exposure

    @property
    def rest(self) -> float:
        """Share of the light that came by two bounces or more."""
        return self.at["full"].shares[2]

    def change(self, method: str, other: str) -> float:
        """|median error in full − in the transport ``other``|, degrees."""
        return abs(self.at["full"].median_deg(method, flip=True) - self.at[other].median_deg(method, flip=True))


def one_bounce(study: OneBounce, folder: Path, log: Log, jobs: int) -> Study:
    """Render every combination, recover, and say when one bounce is enough."""
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
    """A scene each; the transports that know no albedo only for the first."""
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
    return "".join(c if c.isalnum() and c.isascii() else "_" for c in name).strip("_")


def _scene(
    study: OneBounce,
    key: tuple[str, str, float],
    configs: dict[tuple[str, str, float], RunConfig],
    measured: dict[str, Measured],
) -> _Scene:
    shape, lights, albedo = key
    first = configs[(shape, lights, study.albedos[0])].name
    own = configs[key].name
    at = {t: measured[f"{first if t in TRANSPORTS[:2] else own}/{t}"] for t in TRANSPORTS}
    return _Scene(shape, lights, albedo, at)


# ---- what it says ----------------------------------------------------------------------------------------------------


def _answer(study: OneBounce, scenes: Sequence[_Scene]) -> tuple[str, ...]:
    limit = study.enough_deg
    concave = [s for s in scenes if s.rest > 1e-6 and np.isfinite(s.change(KNOWN_F, "one-bounce"))]
    enough = [s for s in concave if s.change(KNOWN_F, "one-bounce") <= limit]
    none = [s for s in concave if s.change(KNOWN_F, "direct") <= limit]
    border = _border(study, concave)
    worst = max(concave, key=lambda s: s.change(KNOWN_F, "one-bounce"))
    parts = [
        (
            f"One bounce is enough while light that came by two bounces or more is under {percent(border, 1)} of "
            f"the picture: up to there what it adds moves normals by no more than {text(limit)}° (median) in any "
            f"of {len(concave)} scenes that have interreflection. It is enough in {len(enough)} of them; no bounce "
            f"at all would do in {len(none)}. The worst is {worst.shape}, albedo {worst.albedo:g}, "
            f"{_lit(worst.lights)}: {percent(worst.rest)} of the light, {text(worst.change(KNOWN_F, 'one-bounce'))}°."
        ),
        (
            "This is judged with the lights known (n = F⁻¹ρ), which is blind to nothing but interreflection. "
            f"{_by_shape(study, scenes)}"
        ),
    ]
    parts.append(_what_methods_see(study, scenes))
    return tuple(parts)


def _border(study: OneBounce, scenes: Sequence[_Scene]) -> float:
    """The largest share of light by two bounces or more below which one bounce is enough everywhere."""
    bad = [s.rest for s in scenes if not s.change(KNOWN_F, "one-bounce") <= study.enough_deg]
    good = [s.rest for s in scenes if s.change(KNOWN_F, "one-bounce") <= study.enough_deg]
    below = [rest for rest in good if not bad or rest < min(bad)]
    return max(below) if below else 0.0


def _by_shape(study: OneBounce, scenes: Sequence[_Scene]) -> str:
    """Up to which albedo one bounce is enough, for each shape under every set of lights."""
    said = []
    for shape in study.shapes:
        of_shape = [s for s in scenes if s.shape == shape]
        if max(s.rest for s in of_shape) <= 1e-6:
            said.append(f"{shape} any, there is no bounce")
            continue
        if not any(np.isfinite(s.change(KNOWN_F, "one-bounce")) for s in of_shape):
            said.append(f"{shape} not told, no pixel sees every light")
            continue
        bad = [s.albedo for s in of_shape if s.change(KNOWN_F, "one-bounce") > study.enough_deg]
        good = [a for a in study.albedos if not bad or a < min(bad)]
        said.append(f"{shape} {'any' if not bad else f'{max(good):g}' if good else 'none'}")
    tried = ", ".join(f"{albedo:g}" for albedo in study.albedos)
    return f"Albedo up to which it is enough, whatever the lights: {'; '.join(said)} (of {tried})."


def _what_methods_see(study: OneBounce, scenes: Sequence[_Scene]) -> str:
    """How far methods that know no lights tell one bounce from all, and what taking interreflection out buys."""
    both = [s for s in scenes if s.rest > 1e-6 and np.isfinite(s.change(WEAK, "one-bounce"))]
    if not both:
        return "No method that finds its lights by itself gives normals in both transports."
    same = sum(s.change(WEAK, "one-bounce") <= study.enough_deg for s in both)
    moved = float(np.median([s.change(WEAK, "direct") for s in both if np.isfinite(s.change(WEAK, "direct"))]))
    said = (
        f"With the lights unknown, {WEAK} gives normals in both transports in {len(both)} scenes, and its "
        f"error is the same within {text(study.enough_deg)}° in {same} of them; from direct light to full it "
        f"changes by {text(moved)}° (median). "
    )
    for method in study.slow_methods:
        pairs = [(s.at["full"].median_deg(method, flip=True), s.at["full"].median_deg(WEAK, flip=True)) for s in scenes]
        finite = [(a, b) for a, b in pairs if np.isfinite(a) and np.isfinite(b)]
        if finite:
            ours, plain = np.median(finite, axis=0)
            said += (
                f"Under full transport {method} has {text(ours)}° where it has {text(plain)}° "
                f"(medians of {len(finite)} scenes)."
            )
    return said


# ---- sections --------------------------------------------------------------------------------------------------------


def _light_section(study: OneBounce, scenes: Sequence[_Scene]) -> Section:
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
        plots.curves("rest", "Light by two bounces or more", by_shape, "albedo", "per cent of the light", log_y=True)
    )
    return Section(
        "Where the light comes from",
        (
            (
                f"Shares of all light that the camera sees of the object, {_lit(lights)}. A share by k bounces "
                "grows as the k-th power of the albedo. In a room the light comes off the walls too, and one "
                "bounce of it already holds what they add."
            ),
        ),
        figures=tuple(figures),
    )


def _enough_section(study: OneBounce, scenes: Sequence[_Scene]) -> Section:
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
        "What light by two bounces or more changes",
        points,
        "its share, per cent of the light",
        "change of the median error, degrees",
        log_x=True,
        log_y=True,
        joined=False,
        level=study.enough_deg,
        caption="A point is a scene; the line is what counts as none.",
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
        caption="The best F, pixels that see every light. Grooves have two normals only: what is left there is "
        "unevenness along a wall.",
    )
    loud = {
        name: (
            [100 * (1 - s.at["full"].shares[0]) for s in concave],
            [max(getattr(s.at["full"], attribute), 1e-3) for s in concave],
        )
        for name, attribute in (("quarter with the least", "quiet_deg"), ("quarter with the most", "loud_deg"))
    }
    where = plots.curves(
        "where",
        "Error with known lights, by the indirect light of the pixel",
        loud,
        "indirect light of the picture, per cent",
        "median error, degrees",
        log_x=True,
        log_y=True,
        joined=False,
        caption="Full transport.",
    )
    return Section("When it is enough", (_residual_sentence(concave),), figures=(changed, linear, where))


def _residual_sentence(scenes: Sequence[_Scene]) -> str:
    """How much of the indirect light does not fit one matrix, with one bounce and with all."""
    per_light = {}
    for transport in ("one-bounce", "full"):
        pairs = [(s.at[transport].residual, 1 - s.at[transport].shares[0]) for s in scenes]
        per_light[transport] = float(np.median([r / share for r, share in pairs if np.isfinite(r) and share > 0]))
    one, every = per_light["one-bounce"], per_light["full"]
    return (
        "The report takes mutual illumination for a distant source in a one-bounce model only (2.5). What of "
        f"it does not fit one matrix ρ = Fn is {text(one)} times the share of indirect light with one bounce "
        f"and {text(every)} times with all bounces (medians): the linear model is broken by where the light "
        f"comes from, point by point, and {'hardly' if abs(every / one - 1) < 0.2 else 'also'} by how often it "
        "was reflected."
    )


def _error_section(study: OneBounce, scenes: Sequence[_Scene], lights: str) -> Section:
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
                "Median angular error in degrees over the pixels that a method gives, of the better of normals and "
                "twin; – where it declines or fails by its own account. Two walls have two normals, which fix no "
                "ellipsoid: in grooves only known lights can be right."
            ),
            _confident_and_wrong(chosen, methods),
        ),
        tables=(Table(tuple(head), tuple(rows), TABLE_CAPTION),),
        figures=tuple(figures),
    )


def _confident_and_wrong(scenes: Sequence[_Scene], methods: Sequence[str]) -> str:
    """Which methods say ok where they err by over WRONG_DEG, on which shapes."""
    said = []
    for method in methods:
        ok = [(s.shape, m.median_deg(method, flip=True)) for s in scenes for m in s.at.values()]
        wrong = [shape for shape, error in ok if error > WRONG_DEG]
        if wrong:
            given = sum(np.isfinite(error) for _, error in ok)
            said.append(f"{method} {len(wrong)} of {given} ({', '.join(dict.fromkeys(wrong))})")
    if not said:
        return f"No result with status ok is over {WRONG_DEG:g}° off."
    return f"Status ok and yet over {WRONG_DEG:g}° off: {'; '.join(said)}."


def _degrees(measured: Measured, method: str) -> str:
    """Two digits, three decimals at most: three of these share a cell."""
    value = measured.median_deg(method, flip=True)
    return "<0.001" if value < 0.0005 else f"{value:.3f}" if value < 0.0095 else text(value)


def _lit(lights: str) -> str:
    """The name of a set of lights, in words: natural lights, gels."""
    return lights if lights.endswith("s") else f"{lights} lights"


def _error_map(method: str, transport: str, error: np.ndarray) -> Figure:
    title = f"Error of {method}, {transport}" if method != KNOWN_F else f"Error with known lights, {transport}"
    key = f"map-{method.replace(' ', '-')}-{transport}"
    return plots.field(key, title, error, "error, degrees", limits=(0.03, 90.0), log=True)


def _maps_section(study: OneBounce, run: Path, configs: dict[tuple[str, str, float], RunConfig]) -> Section:
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
                    "least_indirect_quarter_deg": measured.quiet_deg,
                    "most_indirect_quarter_deg": measured.loud_deg,
                }
            )
    return rows
