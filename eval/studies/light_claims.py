"""Claims of the report on light and regression: mutual illumination (2.5), ambient term (3.6), rank (2, 5), LMS (1).

Each function measures what one or a few statements of the report say, and returns them as claims.
"""

from pathlib import Path
from typing import Any

import numpy as np

from huesphere.configs.load import find_config, load_config, read_yaml
from huesphere.configs.study import Report1994
from huesphere.eval import metrics
from huesphere.eval.studies import plots
from huesphere.eval.studies.form_factor import Patch, above_horizon, dot_product_vector, form_factor
from huesphere.eval.studies.page import Claim, Figure, Section, verdict
from huesphere.eval.studies.pictures import (
    Log,
    Rendered,
    ball,
    config_of,
    ellipsoid_error_deg,
    lights_around,
    median_error_deg,
    percent,
    read,
    render,
    shaded,
    text,
)
from huesphere.recover.ellipsoid.fit import least_median_of_squares, least_squares, reweighted
from huesphere.recover.ellipsoid.free_centre import fit_with_ambient
from huesphere.recover.geometry.quadratic import elements_of
from huesphere.recover.methods.table import METHODS
from huesphere.recover.status import RecoveryFailure

FIVE = (15, 160, 270, 60, 115)  # azimuths of five lights, degrees
CONFIDENT = 0.95  # of the confidence limits
FOUND_DEG = 0.5  # an ellipsoid with a smaller error counts as found
OVER_HALF = 0.52  # shares of the data above this are over half also in a random sample of some thousand colours


def mutual_illumination_section(study: Report1994, run: Path, log: Log) -> Section:
    """The section on mutual illumination: report 2.5, the closed room of its abstract, and coplanar lights (5).

    Pictures are rendered into the run folder ``run``.
    """
    dot, figure = _dot_product()
    room = _closed_room(study, run, log)
    coplanar = _coplanar_lights(study, run, log)
    return Section("Mutual illumination", (), (*dot, room, coplanar), figures=(figure,))


def _dot_product() -> tuple[tuple[Claim, ...], Figure]:
    """Claims on f = n·l, compared with numerical integration for many normals: value, printed constant, horizon."""
    rng = np.random.default_rng(0)
    patch = Patch(np.array([-0.8, -0.5, 1.0]), np.array([0.0, 1.2, 0.3]), np.array([1.5, 0.1, 0.2]))
    l = dot_product_vector(patch)
    off: list[float] = []
    ratio: list[float] = []
    while len(off) < 100:
        normal = rng.normal(size=3)
        normal /= np.linalg.norm(normal)
        if above_horizon(patch, normal):
            f = form_factor(patch, normal)
            off.append(abs(f - normal @ l) / f)
            ratio.append(f / (normal @ l / np.pi))
    worst, constant = max(off), float(np.median(ratio))
    tilts = np.arange(0, 181, 5)
    turned = [np.array([np.sin(np.radians(t)), 0, np.cos(np.radians(t))]) for t in tilts]
    integrated = np.array([form_factor(patch, n) for n in turned])
    linear = np.array([n @ l for n in turned])
    lost = [t for t, n in zip(tilts, turned, strict=True) if not above_horizon(patch, n)]
    claims = (
        Claim(
            "form-factor",
            "2.5",
            "The form factor of a small area is a dot product, f = n · l: a patch acts as a distant source.",
            f"The largest relative difference to numerical integration is {text(worst)}, over 100 normals that have "
            "the whole patch above their horizon. l is computed by Lambert's closed form, so the two share no code.",
            verdict(worst < 1e-4),
            {"largest relative difference": worst},
        ),
        Claim(
            "form-factor-constant",
            "2.5",
            "l = (1/π) ∫ d̂ cos θ / π d² dA, as printed.",
            f"Integration gives {text(constant, 5)} times that: the formula has one factor 1/π too many.",
            verdict(abs(constant - 1) < 1e-3),
            {"integrated over printed": constant},
        ),
        Claim(
            "form-factor-horizon",
            "2.5",
            "(The report does not mention the horizon: it replaces cosθ₁ by a dot product everywhere.)",
            f"From a tilt of {lost[0]}° on, part of this patch is below the surface's horizon. Then n · l is less than "
            "f, and negative where f is zero, as in the attached shadow of an extended source.",
            "measured",
            {"first tilt below horizon deg": float(lost[0])},
        ),
    )
    figure = plots.curves(
        "form-factor",
        "Light from a patch on a small area that is tilted",
        {"integrated": (tilts, integrated), "n · l": (tilts, linear)},
        "tilt of the area, degrees",
        "form factor",
        at={"patch meets the horizon": float(lost[0])},
        level=0.0,
        marked=False,
    )
    return claims, figure


def _closed_room(study: Report1994, run: Path, log: Log) -> Claim:
    side = study.traced_resolution
    overrides = [f"camera.resolution=[{side}, {side}]", f"render.target_rms={study.target_rms}"]
    config = load_config(study.room, overrides=overrides)
    render([config], run, log)
    picture = read(run, f"{config.name}/full")
    return _room_claim(picture)


def _room_claim(picture: Rendered) -> Claim:
    estimate = METHODS["weak-integrability"](picture.observation)
    rgb, n = picture.observation.rgb[picture.mask], picture.truth.normals[picture.mask]
    F = metrics.fit_colour_matrix(rgb, n)
    floor = metrics.linear_floor(rgb, n)[1]
    error = median_error_deg(estimate.normals, estimate.valid, picture.truth.normals, picture.mask)
    r2 = np.nan if estimate.ellipsoid is None else estimate.ellipsoid.r2
    return Claim(
        "room",
        "Abstract, 1",
        "In a closed environment interreflected, coloured light alone makes an environment in which colour is "
        "linear in the normal.",
        f"In a room whose coloured walls are the only lights cond(F) is {text(np.linalg.cond(F))} and the robust R² "
        f"{text(r2, 5)}. The best single matrix, fitted to the true normals, is {text(floor)}° off; recovery without "
        f"the truth is {text(error)}° off (status {estimate.status}). Every wall has a horizon, so the linear model is "
        "an approximation.",
        verdict(floor < 5 and error < 10, floor < 15),
        {"cond F": float(np.linalg.cond(F)), "r2": r2, "floor deg": floor, "recovered deg": error},
    )


def _coplanar_lights(study: Report1994, run: Path, log: Log) -> Claim:
    """Three lights in one plane, whose F has rank 2: does interreflection make the picture's matrix one of rank 3?"""
    data, _ = read_yaml(find_config(study.scene))
    bands = ((610, 25), (540, 25), (460, 20))
    data |= {
        "name": "coplanar_lights",
        "surface": {"reflectance": 0.8},
        "lights": [
            {"direction": [x, 0.0, 1.0], "spectrum": {"gaussian": {"centre": centre, "sigma": sigma}}}
            for x, (centre, sigma) in zip((-0.6, 0.1, 0.6), bands, strict=True)
        ],
        "camera": {"resolution": [study.traced_resolution] * 2},
        "render": {"transport": ["direct", "full"], "target_rms": study.target_rms},
    }
    render([config_of(data, "coplanar lights")], run, log)
    weakest, status = {}, {}
    for transport in ("direct", "full"):
        picture = read(run, f"coplanar_lights/{transport}")
        seen = picture.sees_all
        # Least squares over all of these pixels; a robust fit would choose those that interreflection hardly reaches.
        F = np.linalg.lstsq(picture.truth.normals[seen].astype(float), picture.observation.rgb[seen].astype(float))[0]
        singular = np.linalg.svd(F, compute_uv=False)
        weakest[transport] = float(singular[2] / singular[0])
        status[transport] = METHODS["drew-kontsevich"](picture.observation).status
    return Claim(
        "coplanar",
        "5",
        "A is unlikely to be rank-reduced if interreflections are present.",
        "For three lights in one plane on a bust of albedo 0.8 the least over the largest singular value of F is "
        f"{text(weakest['direct'])} without interreflection and {text(weakest['full'])} with it. It is no longer zero, "
        f"but noise is multiplied by {text(1 / weakest['full'])}. The method's status is {status['direct']} and "
        f"{status['full']}.",
        verdict(weakest["full"] > 0.05, weakest["full"] > 0.005),
        {"direct": weakest["direct"], "full": weakest["full"]},
    )


# ---- ambient, rank, robustness ---------------------------------------------------------------------------------------


def regression_section(study: Report1994, natural: np.ndarray, bust: Rendered) -> Section:
    """The section on the regression: the ambient term (3.6), LMS, confidence limits and desaturated colours (1, 2, 5).

    ``natural`` (5, 3): what the camera measures of each of the report's five lights after reflection by a surface that
    faces the light, the b of Eq. (3). ``bust``: the rendered bust.
    """
    spread, spread_figure = _light_spread(natural, bust)
    half, half_figure = _half_the_data(natural)
    grey, grey_figure = _desaturated(natural)
    claims = (half, spread, _confidence(natural, study.trials), *_ambient(natural, bust), _rank_of_B(natural), grey)
    return Section("The regression", (), claims, figures=(half_figure, spread_figure, grey_figure))


def _half_the_data(natural: np.ndarray) -> tuple[Claim, Figure]:
    """Claim on colours of two ellipsoids, as where part of the object misses a light: which of them is found?

    ``natural`` (5, 3): colours b of the five lights, in rows. The colours of a random share of the pixels lie on the
    ellipsoid of all lights, ρ = F n; the others on that of the last four lights, ρ = F_of_four n. Both matrices (3, 3).
    """
    normals, mask = ball(120, radius_deg=40)
    n = normals[mask]
    A = lights_around(30, FIVE)
    F = natural.T @ A
    F_of_four = natural[1:].T @ A[1:]
    shares = np.arange(0.2, 0.96, 0.05)
    errors: dict[str, list[float]] = {"LMS": [], "least squares": []}
    for share in shares:
        own = np.random.default_rng(1).random(len(n)) < share
        rgb = np.where(own[:, None], n @ F.T, n @ F_of_four.T)
        for name, fit in (("LMS", least_median_of_squares), ("least squares", least_squares)):
            errors[name].append(_error_or_nan(fit, rgb, F, n))
    found = np.array(errors["LMS"]) < FOUND_DEG
    least = float(shares[found].min()) if found.any() else float("nan")
    above = bool(found[shares > OVER_HALF].all())
    claim = Claim(
        "half",
        "1",
        "Where at least half the data lie on one ellipsoid LMS reliably chooses it.",
        "Some colours lie on the ellipsoid of five lights, the others on that of four of them. LMS finds the first "
        f"where its share of the colours is at least {percent(least)}; least squares is "
        f"{text(float(np.interp(0.7, shares, errors['least squares'])))}° off at a share of 70 %. At smaller shares "
        "the ellipsoid that LMS returns, if any, is another one.",
        verdict(above),
        {"least share found": least},
    )
    figure = plots.curves(
        "half",
        "Error of the ellipsoid over the share of the data that lies on it",
        {name: (shares, np.maximum(values, 1e-4)) for name, values in errors.items()},
        "share on the ellipsoid of all lights",
        "error of the ellipsoid, degrees",
        log_y=True,
        at={"half": 0.5},
    )
    return claim, figure


def _error_or_nan(fit: Any, rgb: np.ndarray, F: np.ndarray, n: np.ndarray) -> float:
    """``ellipsoid_error_deg`` of the ellipsoid that ``fit`` finds in colours (N, 3), NaN where it finds none."""
    try:
        return ellipsoid_error_deg(fit(rgb), F, n)
    except RecoveryFailure:
        return float("nan")


def _light_spread(natural: np.ndarray, bust: Rendered) -> tuple[Claim, Figure]:
    """Claim on lights at larger and larger off-axis angles."""
    tilts = np.arange(15, 71, 5)
    normals, mask = bust.truth.normals.astype(float), bust.mask
    every, errors = [], []
    for tilt in tilts:
        A = lights_around(float(tilt), FIVE)
        observation, F = shaded(normals, mask, A, natural)
        sees = (normals[mask] @ A.T).min(axis=1) > 0
        every.append(float(sees.mean()))
        rgb = observation.rgb[mask].astype(float)
        rgb = rgb[rgb.max(axis=1) > 0.02]
        errors.append(_error_or_nan(least_median_of_squares, rgb, F, normals[mask][sees]))
    near, far = float(np.mean(np.array(errors)[tilts <= 30])), errors[-1]
    claim = Claim(
        "spread",
        "2.2",
        "The method works best when most points see most lights: lights away from the horizon, a fairly flat surface.",
        f"Under lights 15° to 30° off the axis the ellipsoid of the bust is {text(near)}° off; at {tilts[-1]}°, where "
        f"{percent(every[-1])} of the pixels see every light, {text(far)}°.",
        verdict(bool(near < 0.1 * far or np.isnan(far)), near < far),
        {"near deg": near, "far deg": far, "share at the farthest": every[-1]},
    )
    figure = plots.curves(
        "spread",
        "Lights toward the horizon: what LMS finds",
        {
            "error of the ellipsoid, degrees": (tilts, np.maximum(errors, 1e-4)),
            "share that sees every light": (tilts, np.array(every)),
        },
        "lights off the camera's axis, degrees",
        "degrees; share",
        log_y=True,
        level=0.5,
    )
    return claim, figure


def _confidence(natural: np.ndarray, trials: int) -> Claim:
    """Claim on confidence limits: how often do 95 % limits contain the true coefficient in noisy pictures?"""
    normals, mask = ball(70, radius_deg=40)
    A = lights_around(30, FIVE)
    gels = _saturated(natural)
    covered = {}
    for noise in (1e-3, 1e-2):
        inside = []
        for seed in range(trials):
            observation, F = shaded(normals, mask, A, gels, noise=noise, seed=seed)
            rgb = observation.rgb[mask].astype(float)
            fit = reweighted(rgb, least_median_of_squares(rgb), confidence=CONFIDENT)
            G = np.linalg.inv(F)
            true = elements_of(G.T @ G)
            limits = np.array([(c["low"], c["high"]) for c in fit.coefficients], float)
            inside.append((limits[:, 0] <= true) & (true <= limits[:, 1]))
        covered[noise] = float(np.mean(inside))
    low, high = covered[1e-3], covered[1e-2]  # at the low and at the high noise
    return Claim(
        "confidence",
        "2.2",
        "Reweighted least squares allows confidence limits to be established on coefficients using standard "
        "techniques.",
        f"95 % limits contain the true value in {percent(low)} of {trials} × 6 cases at a noise of 0.1 % of full "
        f"scale, and in {percent(high)} at 1 %. Noise enters the design matrix squared and biases the fit, which the "
        "standard limits do not include.",
        verdict(low > 0.9 and high > 0.9, low > 0.8),
        {"covered at 0.1 %": low, "covered at 1 %": high},
    )


def _saturated(colours: np.ndarray) -> np.ndarray:
    """Colours (L, 3) moved away from their mean, which makes them as saturated as lights behind gels."""
    grey = colours.mean(axis=0)
    return np.maximum(grey + 6 * (colours - grey), 0.02 * grey)


def _ambient(natural: np.ndarray, bust: Rendered) -> tuple[Claim, ...]:
    """Claims on the ambient term: does the regression find ellipsoid and ambient colour, and is the formula right?"""
    normals, mask = bust.truth.normals.astype(float), bust.mask
    A = lights_around(28, FIVE)
    s = 0.12 * natural[3] / natural[3].max()
    observation, F = shaded(normals, mask, A, natural, ambient=s)
    sees = (normals @ A.T).min(axis=-1) > 0
    rgb = observation.rgb[mask].astype(float)
    with_term = fit_with_ambient(rgb)
    plain = _error_or_nan(least_median_of_squares, rgb, F, normals[mask & sees])
    with_it = ellipsoid_error_deg(with_term.C, F, normals[mask & sees])
    off = float(np.linalg.norm(with_term.ambient - s) / np.linalg.norm(s))
    # The printed relation, on exact colours: D = C / (1 − αᵀα), β = D α, and ρᵀDρ − 2ρᵀβ = 1.
    G = np.linalg.inv(F)
    C = G.T @ G
    rho = normals[mask & sees] @ F.T + s
    residual = {}
    for name, square in (("printed", s @ s), ("corrected", s @ C @ s)):
        D = C / (1 - square)
        residual[name] = float(np.abs(np.einsum("ni,ij,nj->n", rho, D, rho) - 2 * rho @ D @ s - 1).max())
    return (
        Claim(
            "ambient",
            "3.6",
            "An ambient term is straightforward to include: a regression in nine unknowns.",
            f"With natural lights and ambient light of 12 % of full scale on the bust the ellipsoid is {text(plain)}° "
            f"off without the term and {text(with_it)}° with it; the error of the ambient colour is {percent(off, 2)}.",
            verdict(with_it < 0.1 * plain and off < 0.02, with_it < plain),
            {"without deg": plain, "with deg": with_it, "colour off": off},
        ),
        Claim(
            "ambient-formula",
            "3.6",
            "D = C / (1 − αᵀα), β = D α, and ρᵀDρ − 2ρᵀβ = 1.",
            f"On exact colours the left side differs from 1 by up to {text(residual['printed'])} as printed, and by "
            f"{text(residual['corrected'])} with αᵀCα in place of αᵀα.",
            verdict(residual["printed"] < 1e-6),
            residual,
        ),
    )


def _rank_of_B(natural: np.ndarray) -> Claim:
    singular = np.linalg.svd(natural, compute_uv=False)
    condition = float(singular[0] / singular[2])
    return Claim(
        "rank",
        "5",
        "Ordinary lights gave a B of full rank.",
        f"cond(B) = {text(condition, 3)}: the rank is full, but the colours lie in a plane to within "
        f"{percent(1 / condition, 1)}. Noise of the picture enters the normals multiplied by about cond(B) or more.",
        verdict(condition < 1e6),
        {"cond B": condition},
    )


def _desaturated(natural: np.ndarray) -> tuple[Claim, Figure]:
    """Claim on lights whose colours approach each other at a fixed noise: does the method report its failure?"""
    normals, mask = ball(128, radius_deg=60)
    A = lights_around(25, FIVE)
    gels = _saturated(natural)
    grey = gels.mean(axis=0)
    shares = np.array([1, 0.5, 0.25, 0.12, 0.06, 0.03, 0.015, 0.007, 0.0])
    conditions, errors, silent, failed = [], [], 0, 0
    for share in shares:
        colours = grey + share * (gels - grey)
        observation, F = shaded(normals, mask, A, colours, noise=1e-3, seed=3)
        estimate = METHODS["drew-kontsevich"](observation)
        error = median_error_deg(estimate.normals, estimate.valid, normals, mask)
        conditions.append(min(float(np.linalg.cond(F)), 1e6))
        errors.append(error)
        wrong = not error < 20
        failed += wrong
        silent += wrong and estimate.status == "ok"
    claim = Claim(
        "desaturated",
        "5",
        "If colours were even more desaturated the method would fail; the failure would be easily detected and "
        "signalled.",
        f"The lights' colours approach grey at a noise of 0.1 %: {failed} of {len(shares)} pictures have a median "
        f"error over 20° or no normals, {silent} of these with status ok. (The report does not test this; the statuses "
        "are this project's.)",
        verdict(failed > 0 and silent == 0, silent < failed),
        {"failed": float(failed), "silent": float(silent)},
    )
    kept = np.isfinite(errors)
    figure = plots.curves(
        "desaturated",
        "Lights of more and more similar colours, noise 0.1 %",
        {"median error of the closed form": (np.array(conditions)[kept], np.array(errors)[kept])},
        "cond(F)",
        "degrees",
        log_x=True,
        caption="Pictures that the method refuses are left out.",
    )
    return claim, figure
