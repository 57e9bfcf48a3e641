"""The methods by name, each a function from one picture to an estimate of its normals.

All tell one story: usable pixels → ellipsoid → root → rotation → convex or concave → normals and their uncertainty.
They differ in which pixels the ellipsoid is fitted to and in what fixes the rotation.
"""

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from huesphere.recover.baselines.kontsevich1994 import grow_region, random_descent
from huesphere.recover.cues.convexity import choose_twin
from huesphere.recover.cues.linear_integrability import aside_deg, likely_rotations
from huesphere.recover.cues.silhouette import Outlined
from huesphere.recover.ellipsoid.distance import signed_distance
from huesphere.recover.ellipsoid.fit import (
    Fit,
    definiteness,
    fit_accepted,
    least_median_of_squares,
    least_squares,
    reweighted,
)
from huesphere.recover.ellipsoid.free_centre import fit_with_ambient
from huesphere.recover.ellipsoid.from_patches import choose_shell
from huesphere.recover.ellipsoid.refit import polish
from huesphere.recover.every_pixel.completion import bridged, completed
from huesphere.recover.geometry.rays import facing_camera, rays
from huesphere.recover.geometry.root import symmetric_root
from huesphere.recover.geometry.rotations import TWIN, turn_between
from huesphere.recover.geometry.tangent_uncertainty import normal_uncertainty_deg
from huesphere.recover.interreflection.removal import unbounce
from huesphere.recover.io.estimate import Estimate
from huesphere.recover.lights.search import whole_picture
from huesphere.recover.methods.auto import choose_steps, with_near_lights
from huesphere.recover.methods.near_lights import recover_near, tells_near
from huesphere.recover.pixels.noise import camera_noise
from huesphere.recover.pixels.usable import Pixels, colour_signal, usable_pixels
from huesphere.recover.robust_scale import mad_scale
from huesphere.recover.rotation.alternation import alternate
from huesphere.recover.rotation.closed_form import Attitude, closed_form
from huesphere.recover.rotation.tangents import TangentRotation, tangent_rotation, without_edge
from huesphere.recover.rotation.weak_form import WeakRotation, weak_rotation, without_specks
from huesphere.recover.status import RecoveryFailure
from huesphere.render.dataset import Observation

LEAST_SIGNAL = 1.5  # over noise, of the colours' variation, the weakest colour, the weakest direction of C; noise has 1
LEAST_R2 = 0.9  # robust R² below which no shell stands out
LEAST_R2_OUTLINED = 0.7  # the same where the outline was asked too: of 22 right ones under 0.9 all but one are above
MOST_NEGATIVE_N3 = 0.05  # "more than just a few negative values", report 3.3
LARGEST_TURN_DEG = 10.5  # standard error of the rotation, beyond which it is called undetermined
FINE_DETAIL = 1.3  # misfit of the tangents above which the weak form is asked too
NO_NOISE = 5.0  # misfit of the tangents above which their covariance says nothing
FEWEST_BUMPS = 60  # below, the scatter of its residuals says nothing of the error
LED_ASTRAY = 2.5  # how much farther than by noise pixels that miss a light turn the rotation, on dev scenes
CALM_STRAIN, MEDIUM_STRAIN = 0.3, 0.64  # strain of noise; of pixels that are led astray by that much
STRAINED, ASTRAY = 4.0, 12.0  # strain, and loss of the outline, from which rotations all over are looked at
CLEAR_RIVAL = 100.0  # gain of loss over the next rotation from which it is ruled out
LEAST_GRAIN = 2e-4  # radians, of normals: with less, what blocks blur counts as a misfit everywhere
ASKED_DEG = 5.0  # the same from which the whole picture is asked
ASIDE_DEG = 10.0  # of facing the camera: where no normal comes so near, the rotation is in doubt
STARTS = 3  # of each handedness, besides the closed forms
ALPHA_DEG = np.arange(0.0, 91.0)  # where the curves of the report's Fig. 1(f) are kept


def recover_least_squares(observation: Observation) -> Estimate:
    """Least squares over all the object's pixels, rotation in closed form: the baseline that outliers pull away."""
    return _attempt("least-squares", observation, _fit_everything, _rotate_in_closed_form)


def recover_drew_kontsevich(observation: Observation) -> Estimate:
    """The report: LMS, the cut at 2.5 s0, reweighted least squares, closed-form rotation; normals of accepted pixels.

    Beyond the report, both handednesses of the root are tried (``recover.geometry.root``) and the outline chooses the
    twin.
    """
    return _attempt("drew-kontsevich", observation, _fit_as_reported, _rotate_in_closed_form)


def recover_weak_integrability(observation: Observation) -> Estimate:
    """LMS, polished on its own pixels without the noise's bias; rotation by integrability in weak form.

    Where neighbours share more error than they have noise (interreflection: the model itself is off), there is no noise
    to average away and the means of ``recover.ellipsoid.refit`` mislead: the report's fit is kept then.
    """
    return _attempt("weak-integrability", observation, _fit_and_polish, _rotate_by_weak_form)


def recover_with_ambient(observation: Observation) -> Estimate:
    """The report's method with its ambient term (3.6): the ellipsoid's centre is fitted too, nine unknowns in all."""
    return _attempt("drew-kontsevich-ambient", observation, _fit_with_ambient, _rotate_in_closed_form)


def recover_by_alternation(observation: Observation) -> Estimate:
    """The report's ellipsoid; its closed form only to start the alternation r3 ↔ (r1, r2) that it did not try (3.5)."""
    return _attempt("alternation", observation, _fit_as_reported, _rotate_by_alternation)


def recover_kontsevich_1994(observation: Observation) -> Estimate:
    """The report's ellipsoid, the rotation by random steps down Eq. (13): what its closed form was to replace."""
    return _attempt("kontsevich-1994", observation, _fit_as_reported, _rotate_by_random_steps)


def recover_kontsevich_1994_growing(observation: Observation) -> Estimate:
    """The ellipsoid of the largest region grown to a tolerance, the rotation by random steps: no robust regression."""
    return _attempt("kontsevich-1994-growing", observation, _fit_grown, _rotate_by_random_steps)


def recover_robust(observation: Observation) -> Estimate:
    """The shell that sees every light, though a tenth of the object may be on it; rotation by tangents.

    Which shell: ``recover.ellipsoid.candidates``; which rotation: ``recover.rotation.tangents``. The noise is the
    camera's where it is known.
    """

    def fit(pixels: Pixels, diagnostics: dict[str, Any]) -> _Shell:
        chosen = choose_shell(pixels, observation.camera)
        diagnostics["shell"] = {
            "share": chosen.share,
            "margin": _finite(chosen.margin),
            "candidates": chosen.candidates,
            "faint_lights": chosen.own.faint,
        }
        own, outlined = chosen.own, chosen.outlined
        if outlined is not None:
            diagnostics["outline"] = {
                "rotation": outlined.rotation.tolist(),
                "stderr_deg": np.degrees(np.sqrt(np.diag(np.linalg.inv(outlined.precision)))).tolist(),
                "rim_misfit": None if outlined.rim is None else outlined.rim.misfit,
            }
        near = own.near if outlined is None else pixels.usable
        return _Shell(own.fit, own.core, own.noise, near=near, told=own.told, outlined=outlined)

    return _doubted(_attempt("robust", observation, fit, _rotate_by_tangents, _ask_every_pixel, window=5))


def recover_unbounced(observation: Observation) -> Estimate:
    """`weak-integrability` on the direct light alone: what parts of the surface sent each other is taken out first."""
    found, _, reflected = unbounce(observation, recover_weak_integrability, bridged)
    return replace(found if reflected is None else reflected.noted(found), method="unbounce")


def recover_knitted(observation: Observation) -> Estimate:
    """`weak-integrability`, then every pixel: lights from one picture, and each pixel by the lights that it sees."""
    found = recover_weak_integrability(observation)
    return replace(completed(found, observation) if found.status == "ok" else found, method="knit")


def recover_jointly(observation: Observation) -> Estimate:
    """`knit`, then depth and F fitted together to the picture, which is taken where it leaves noise over."""
    found = recover_weak_integrability(observation)
    return replace(completed(found, observation, joint=True) if found.status == "ok" else found, method="joint")


def recover_automatically(observation: Observation) -> Estimate:
    """The steps that the picture calls for; the diagnostics say which and why (``recover.methods.auto``)."""
    if tells_near(observation):
        return with_near_lights(recover_near(observation))
    return choose_steps(observation, recover_weak_integrability, recover_robust)


def _doubted(estimate: Estimate) -> Estimate:
    """The estimate, its status "rotation-undetermined" where the rotation's standard error or the normals tell so.

    Lights stand in front, so that a normal that faces the camera is on the shell of the pixels that see them all; it is
    asked for where no outline has told which way that is.
    """
    if estimate.status != "ok":
        return estimate
    turn = estimate.diagnostics["rotation_stderr_deg"]
    told = "outline" in estimate.diagnostics
    aside = 0.0 if told else aside_deg(estimate.normals[estimate.valid][:, 2], fewest=1)
    if turn <= LARGEST_TURN_DEG and aside <= ASIDE_DEG:
        return estimate
    known = f"the rotation is known to {turn:.2g}°"
    seen = (
        f"no normal faces the camera, the nearest is {aside:.0f}° off: these pixels miss a light or are turned wrongly"
    )
    failure = RecoveryFailure("rotation-undetermined", known if turn > LARGEST_TURN_DEG else seen)
    return replace(estimate, status=failure.status, message=failure.message)


METHODS: dict[str, Callable[[Observation], Estimate]] = {
    "least-squares": recover_least_squares,
    "drew-kontsevich": recover_drew_kontsevich,
    "weak-integrability": recover_weak_integrability,
    "drew-kontsevich-ambient": recover_with_ambient,
    "alternation": recover_by_alternation,
    "kontsevich-1994": recover_kontsevich_1994,
    "kontsevich-1994-growing": recover_kontsevich_1994_growing,
    "robust": recover_robust,
    "unbounce": recover_unbounced,
    "knit": recover_knitted,
    "joint": recover_jointly,
    "auto": recover_automatically,
}


@dataclass
class _Findings:
    """What is known so far; a failure keeps it."""

    diagnostics: dict[str, Any]
    normals: np.ndarray  # (H, W, 3)
    inlier: np.ndarray  # (H, W) bool
    uncertainty_deg: np.ndarray  # (H, W)


@dataclass(frozen=True)
class _Shell:
    """An ellipsoid and the pixels taken to lie on it."""

    fit: Fit
    inlier: np.ndarray  # (H, W) bool
    noise: float  # standard deviation of the distance to it, picture units
    ambient: np.ndarray = field(default_factory=lambda: np.zeros(3))  # (3,) its centre, picture units: report 3.6
    near: np.ndarray | None = None  # (H, W) bool, pixels whose normals it tells well enough to choose the twin; inlier
    told: bool = False  # there are no strangers along its edge
    ray: np.ndarray | None = None  # (H, W, 2) of a picture in perspective: ``recover.geometry.rays``
    outlined: Outlined | None = None  # how the object is turned, roughly


@dataclass(frozen=True)
class _Rotation:
    matrix: np.ndarray  # (3, 3) orthogonal, n = matrix · Ĝρ, Ĝ the root of positive determinant
    covariance: np.ndarray  # (3, 3) radians², of a small rotation of the camera frame
    converged: bool
    stretch: np.ndarray = field(default_factory=lambda: np.eye(3))  # (3, 3) symmetric: n ∝ matrix · stretch · Ĝρ
    other: "_Rotation | None" = None  # of the convex/concave twin; None: TWIN · matrix, and all else as here
    other_ratio: float = 1.0  # how many times more curl or misfit that has

    def twin(self) -> "_Rotation":
        turned = replace(self, matrix=TWIN @ self.matrix, covariance=TWIN @ self.covariance @ TWIN)
        return turned if self.other is None else self.other


@dataclass(frozen=True)
class _Turned:
    """A shell, its root Ĝ, and the rotation of Ĝρ, convex or concave decided."""

    shell: _Shell
    G: np.ndarray  # (3, 3)
    rotation: _Rotation


def _attempt(
    method: str,
    observation: Observation,
    fit_shell: Callable[[Pixels, dict[str, Any]], _Shell],
    rotate: Callable[[np.ndarray, _Shell, dict[str, Any]], _Rotation],
    review: Callable[[Pixels, "_Turned", dict[str, Any]], "_Turned | None"] = lambda pixels, found, diagnostics: None,
    *,
    window: int = 1,
) -> Estimate:
    """The story that all methods share, and its end as a value whichever way it ends.

    ``review``: what a method puts in the place of shell and rotation once both are there; None: nothing.

    ``window``: side of the squares of pixels whose mean colour must tell three dimensions; a method that lives on
    single pixels needs single pixels that do.
    """
    shape = observation.mask.shape
    found = _Findings({}, np.full((*shape, 3), np.nan), np.zeros(shape, bool), np.full(shape, np.nan))
    status, message = "ok", ""
    try:
        _recover(observation, fit_shell, rotate, review, found, window)
    except RecoveryFailure as failure:
        status, message = failure.status, failure.message
    except np.linalg.LinAlgError as error:  # colours of so odd a kind that none of the checks before has a name for it
        status, message = "singular", RecoveryFailure("singular", str(error)).message
    return Estimate(
        method=method,
        status=status,
        message=message,
        normals=found.normals.astype(np.float32),
        valid=np.isfinite(found.normals[..., 2]),
        inlier=found.inlier,
        uncertainty_deg=found.uncertainty_deg.astype(np.float32),
        diagnostics=found.diagnostics,
    )


def _recover(
    observation: Observation,
    fit_shell: Callable[[Pixels, dict[str, Any]], _Shell],
    rotate: Callable[[np.ndarray, _Shell, dict[str, Any]], _Rotation],
    review: Callable[[Pixels, "_Turned", dict[str, Any]], "_Turned | None"],
    found: _Findings,
    window: int,
) -> None:
    """Fill ``found``. Raises RecoveryFailure as soon as nothing can follow."""
    pixels = usable_pixels(observation)
    found.diagnostics["pixels"] = pixels.counts
    _require_colours(pixels.rgb, pixels.usable, found.diagnostics, window)

    ray = rays(observation.camera, observation.mask.shape)
    shell = replace(fit_shell(pixels, found.diagnostics), ray=ray)
    found.inlier = shell.inlier
    found.diagnostics |= _shell_diagnostics(shell.fit)
    _require_shell(shell, pixels, window)

    G = symmetric_root(shell.fit.C)
    N = (pixels.rgb - shell.ambient) @ G.T  # Eq. (11), N = Ĝρ
    found.diagnostics["s_eigen"] = None
    rotation = rotate(N, shell, found.diagnostics)
    near = shell.inlier if shell.near is None else shell.near
    twin = choose_twin(_turned(N, rotation, near), near, pixels.mask, ratio=rotation.other_ratio)
    rotation, other = (rotation.twin(), rotation) if twin.flipped else (rotation, rotation.twin())
    better = review(pixels, _Turned(shell, G, rotation), found.diagnostics)
    if better is not None:
        shell, G, rotation, other = better.shell, better.G, better.rotation, better.rotation.twin()
        found.inlier, N = shell.inlier, (pixels.rgb - shell.ambient) @ G.T
    n = _turned(N, rotation, shell.inlier)
    N, G = N @ rotation.stretch, rotation.stretch @ G
    length = np.linalg.norm(N, axis=-1)
    M = rotation.matrix @ G
    found.normals = n
    found.diagnostics |= {
        "C": (G.T @ G).tolist(),
        "F": np.linalg.inv(M).tolist(),
        "rotation": rotation.matrix.tolist(),
        "rotation_stderr_deg": float(np.degrees(np.sqrt(np.trace(rotation.covariance)))),
        "reflection": bool(np.linalg.det(rotation.matrix) < 0),
        "twin": {"flipped": twin.flipped, "margin": twin.margin, "evidence": twin.evidence},
    }
    if ray is not None:
        found.diagnostics["twin"]["turn"] = (other.matrix @ rotation.matrix.T).tolist()

    level = float(np.median(pixels.rgb[shell.inlier]))
    known = camera_noise(observation.camera, level) if observation.camera.known else 0.0
    # The larger of the two: a camera known to be clean does not make a poor fit a good one.
    sigma = max(shell.noise, known)
    found.diagnostics["noise"] = {"sigma": sigma, "from_fit": shell.noise, "from_camera": known}
    found.uncertainty_deg[shell.inlier] = normal_uncertainty_deg(
        n[shell.inlier], length[shell.inlier], M, sigma**2 * np.eye(3), rotation.covariance
    )

    negative = float((facing_camera(n, ray)[shell.inlier] < 0).mean())
    found.diagnostics["r3_negative_share"] = negative
    if negative > MOST_NEGATIVE_N3:
        raise RecoveryFailure("n3-signs", f"{negative:.0%} of the normals face away from the camera")
    if not rotation.converged:
        raise RecoveryFailure("no-convergence", "the rotation still moved when the search ended")


def _turned(N: np.ndarray, rotation: _Rotation, where: np.ndarray) -> np.ndarray:
    """Unit normals n = RᵀN (H, W, 3), Eq. (12), NaN off ``where`` (H, W)."""
    N = N @ rotation.stretch
    n = np.full(N.shape, np.nan)
    np.divide(N @ rotation.matrix.T, np.linalg.norm(N, axis=-1)[..., None], out=n, where=where[..., None])
    return n


# ---- the ellipsoid ---------------------------------------------------------------------------------------------------


def _fit_everything(pixels: Pixels, diagnostics: dict[str, Any]) -> _Shell:
    colours = pixels.rgb[pixels.usable]
    return _shell(pixels, reweighted(colours, least_squares(colours), cut=np.inf))


def _fit_as_reported(pixels: Pixels, diagnostics: dict[str, Any]) -> _Shell:
    colours = pixels.rgb[pixels.usable]
    return _shell(pixels, reweighted(colours, least_median_of_squares(colours)))


def _fit_and_polish(pixels: Pixels, diagnostics: dict[str, Any]) -> _Shell:
    colours = pixels.rgb[pixels.usable]
    C = least_median_of_squares(colours)
    polished = polish(pixels.rgb, pixels.usable, C)
    diagnostics["polish"] = {
        "noise": polished.noise,
        "misfit": polished.misfit,
        "unbiased": polished.unbiased,
        "rounds": polished.rounds,
        "used": polished.misfit <= polished.noise,
    }
    if polished.misfit > polished.noise:
        reported = _shell(pixels, reweighted(colours, C))
        return replace(reported, inlier=without_specks(reported.inlier) & pixels.usable)
    return _Shell(polished.fit, polished.region, float(np.hypot(polished.noise, polished.misfit)))


def _fit_with_ambient(pixels: Pixels, diagnostics: dict[str, Any]) -> _Shell:
    colours = pixels.rgb[pixels.usable]
    found = fit_with_ambient(colours)
    diagnostics["ambient"] = {"colour": found.ambient.tolist(), "stderr": found.stderr.tolist()}
    shell = _shell(pixels, reweighted(colours - found.ambient, found.C), found.ambient)
    return replace(shell, ambient=found.ambient)


def _fit_grown(pixels: Pixels, diagnostics: dict[str, Any]) -> _Shell:
    fit, _ = grow_region(pixels.rgb, pixels.usable)
    return _shell(pixels, fit)


def _shell(pixels: Pixels, fit: Fit, ambient: np.ndarray | float = 0.0) -> _Shell:
    inlier = np.zeros(pixels.usable.shape, bool)
    inlier[pixels.usable] = fit.accepted
    distance = signed_distance(pixels.rgb[inlier] - ambient, fit.C)
    return _Shell(fit, inlier, mad_scale(distance))


def _require_colours(rgb: np.ndarray, inside: np.ndarray, diagnostics: dict[str, Any], window: int) -> None:
    """Raise RecoveryFailure where the colours of the pixels ``inside`` (H, W) do not fill three dimensions."""
    variation, weakest = colour_signal(rgb, inside, window=window)
    diagnostics["signal"] = {"variation": _finite(variation), "weakest_colour": _finite(weakest)}
    if variation < LEAST_SIGNAL:
        raise RecoveryFailure("flat-surface", f"the colours vary by {variation:.2g} times their noise")
    if weakest < LEAST_SIGNAL:
        raise RecoveryFailure("rank-deficient-colours", f"the weakest colour is {weakest:.2g} times its noise")


def _require_shell(shell: _Shell, pixels: Pixels, window: int) -> None:
    """Raise RecoveryFailure where the ellipsoid is not one that the picture determines."""
    fit = shell.fit
    if fit.r2 < (LEAST_R2 if shell.outlined is None else LEAST_R2_OUTLINED):
        raise RecoveryFailure(
            "no-dominant-shell", f"robust R² is {fit.r2:.3f}, half the pixels are far from any ellipsoid"
        )
    _, weakest = colour_signal(pixels.rgb, shell.inlier, window=window)
    if weakest < LEAST_SIGNAL:
        raise RecoveryFailure("rank-deficient-colours", f"the weakest accepted colour is {weakest:.2g} times its noise")
    definite = definiteness(pixels.rgb[pixels.usable], shell.inlier[pixels.usable], shell.noise)
    if definite < LEAST_SIGNAL:
        raise RecoveryFailure(
            "ellipsoid-undetermined", f"C is fixed in one direction by {definite:.2g} times the noise"
        )


def _ask_every_pixel(pixels: Pixels, found: _Turned, diagnostics: dict[str, Any]) -> _Turned | None:
    """What the whole picture says of a shell whose rotation is in doubt; None where it is not, or says nothing."""
    shell, rotation = found.shell, found.rotation
    stderr = float(np.degrees(np.sqrt(np.trace(rotation.covariance))))
    if stderr < ASKED_DEG and rotation.converged:
        return None
    F = np.linalg.inv(rotation.matrix @ rotation.stretch @ found.G)
    seen = pixels.usable | pixels.dark
    by_all, told = whole_picture(
        pixels.rgb, pixels.mask, seen, shell.inlier, F, rotation.covariance, shell.noise, shell.ray
    )
    diagnostics["whole_picture"] = told | {"first_rotation_stderr_deg": stderr}
    if by_all is None:
        return None
    try:
        fit = fit_accepted(pixels.rgb[pixels.usable], by_all.all_lit[pixels.usable], noise=shell.noise)
    except RecoveryFailure:
        return None
    fit = replace(fit, C=np.linalg.inv(by_all.F @ by_all.F.T))
    diagnostics |= _shell_diagnostics(fit)
    G = symmetric_root(fit.C)
    turned = _Rotation(np.linalg.inv(G @ by_all.F), by_all.covariance, converged=True)
    return _Turned(replace(shell, fit=fit, inlier=by_all.all_lit), G, turned)


# ---- the rotation ----------------------------------------------------------------------------------------------------


def _rotate_in_closed_form(N: np.ndarray, shell: _Shell, diagnostics: dict[str, Any]) -> _Rotation:
    """The report's rotation. Its error is bias, so how far the weak form would turn it stands for its uncertainty."""
    _, matrix = _closed_forms(N, shell.inlier, diagnostics)[0]
    weak = weak_rotation(_unit(N), without_specks(shell.inlier), [matrix], shell.ray)
    turn = turn_between(weak.rotation, matrix)
    diagnostics["weak"] = {"turn_from_closed_form_deg": float(np.degrees(turn)), "scale": weak.scale}
    return _Rotation(matrix, turn**2 / 3 * np.eye(3) + weak.covariance, converged=True)


def _rotate_by_weak_form(N: np.ndarray, shell: _Shell, diagnostics: dict[str, Any]) -> _Rotation:
    starts = [matrix for _, matrix in _closed_forms(N, shell.inlier, diagnostics)]
    weak = weak_rotation(_unit(N), shell.inlier, starts, shell.ray)
    diagnostics["weak"] = _weak_diagnostics(weak) | {
        "turn_from_closed_form_deg": float(np.degrees(turn_between(weak.rotation, starts[0])))
    }
    return _of_weak(weak)


def _rotate_by_tangents(N: np.ndarray, shell: _Shell, diagnostics: dict[str, Any]) -> _Rotation:
    """From where the outline points; without one, from the closed form of either root and rotations all over.

    Where the surface has detail as fine as the blocks of pixels, more than noise is left over, and bumps, which lose no
    detail, may know the rotation better by their own account.
    """
    starts = [matrix for _, matrix in _closed_forms(N, shell.inlier, diagnostics)]
    G = symmetric_root(shell.fit.C)
    noise = shell.noise**2 * (G @ G.T) + LEAST_GRAIN**2 * np.eye(3)
    found = _by_tangents(N, shell, noise, starts)
    tangents = {
        "misfit": found.misfit,
        "freedom": found.freedom,
        "rival": _finite(found.rival),
        "strain": found.strain,
        "starts": found.starts,
        "converged": found.converged,
        "rotation_stderr_deg": np.degrees(np.sqrt(np.diag(found.covariance))).tolist(),
        "turn_from_closed_form_deg": float(np.degrees(turn_between(found.rotation, starts[0]))),
    }
    diagnostics["tangents"] = tangents
    if found.misfit > FINE_DETAIL or not found.converged:
        with contextlib.suppress(RecoveryFailure):
            told = shell.outlined is not None
            search = not told and not found.converged and found.rival < CLEAR_RIVAL  # else it is known where to look
            others = [] if told else starts[:2]
            weak = weak_rotation(_unit(N), shell.inlier, [found.rotation, *others], shell.ray, search=search)
            diagnostics["weak"] = _weak_diagnostics(weak)
            doubt = LED_ASTRAY**2 * np.trace(found.covariance)
            surer = np.trace(weak.covariance) < doubt or (
                weak.converged and not (found.converged and found.misfit < NO_NOISE)
            )
            if weak.functions >= FEWEST_BUMPS and surer:
                return _of_weak(weak)
    # Where neighbours misfit together there is less to learn from than single blocks say, though their misfit itself is
    # counted in the covariance already; and less where another rotation, far off, does nearly as well.
    strain = np.sqrt(MEDIUM_STRAIN * max(CALM_STRAIN, found.strain))
    doubt = LED_ASTRAY**2 * strain * (1 + CLEAR_RIVAL / max(found.rival, 1e-3))
    rotation = _Rotation(found.rotation, doubt * found.covariance, found.converged, found.stretch)
    if found.twin is None:
        return rotation
    other = replace(rotation, matrix=found.twin[0], stretch=found.twin[1])
    return replace(rotation, other=other, other_ratio=found.twin_ratio)


def _by_tangents(N: np.ndarray, shell: _Shell, noise: np.ndarray, starts: list[np.ndarray]) -> TangentRotation:
    """From where the outline points, if that leads to where little is left; else from ``starts`` and all over too."""
    inside = shell.inlier if shell.told else without_edge(shell.inlier)
    outlined = shell.outlined
    if outlined is not None:
        with contextlib.suppress(RecoveryFailure):
            found = tangent_rotation(N, inside, noise, [outlined.rotation], shell.ray, outlined)
            settled = found.converged and found.strain < STRAINED and outlined.loss(found.rotation) < ASTRAY
            if settled and found.misfit < NO_NOISE:
                return found
            if settled:  # without noise fine detail leaves as much as the wrong hand does
                return tangent_rotation(N, inside, noise, [outlined.rotation, *starts], shell.ray, outlined)
        starts = [outlined.rotation, *starts]
    grain = float(np.sqrt(np.trace(noise) / 3))
    starts = starts + likely_rotations(N, shell.inlier, np.eye(3), noise=grain, count=STARTS, ray=shell.ray)
    return tangent_rotation(N, inside, noise, starts, shell.ray, outlined)


def _of_weak(weak: WeakRotation) -> _Rotation:
    rotation = _Rotation(weak.rotation, weak.covariance, weak.converged)
    if weak.twin is None:
        return rotation
    return replace(rotation, other=replace(rotation, matrix=weak.twin), other_ratio=weak.twin_ratio)


def _rotate_by_alternation(N: np.ndarray, shell: _Shell, diagnostics: dict[str, Any]) -> _Rotation:
    """From the closed form of either root; the lesser numerator of the two is kept. Uncertainty as there."""
    ends = []
    for attitude, matrix in _closed_forms(N, shell.inlier, diagnostics):
        hand = float(np.sign(np.linalg.det(matrix)))
        end = alternate(hand * _unit(N), shell.inlier, attitude.rotation)
        ends.append((end, hand * end.rotation))
    end, matrix = min(ends, key=lambda entry: entry[0].numerator[1])
    diagnostics["alternation"] = {"rounds": end.rounds, "turned_deg": float(np.degrees(end.turned))}
    return _with_doubt(N, shell, matrix, end.settled, diagnostics)


def _rotate_by_random_steps(N: np.ndarray, shell: _Shell, diagnostics: dict[str, Any]) -> _Rotation:
    """Random steps for either root, Ĝ and −Ĝ, and the lesser integral. Uncertainty as for the closed form."""
    _closed_forms(N, shell.inlier, diagnostics)  # to compare with
    ends = [(random_descent(hand * _unit(N), shell.inlier), hand) for hand in (1.0, -1.0)]
    end, hand = min(ends, key=lambda entry: entry[0].integral)
    diagnostics["random_steps"] = {"integral": _finite(end.integral), "accepted": end.accepted}
    return _with_doubt(N, shell, hand * end.rotation, end.settled, diagnostics)


def _with_doubt(
    N: np.ndarray, shell: _Shell, matrix: np.ndarray, settled: bool, diagnostics: dict[str, Any]
) -> _Rotation:
    """The rotation with its uncertainty where its error may be bias: how far the weak form would turn it."""
    weak = weak_rotation(_unit(N), without_specks(shell.inlier), [matrix], shell.ray)
    turn = turn_between(weak.rotation, matrix)
    diagnostics["weak"] = {"turn_deg": float(np.degrees(turn)), "scale": weak.scale}
    return _Rotation(matrix, turn**2 / 3 * np.eye(3) + weak.covariance, settled)


def _closed_forms(N: np.ndarray, inlier: np.ndarray, diagnostics: dict[str, Any]) -> list[tuple[Attitude, np.ndarray]]:
    """The closed form on either root, Ĝ and −Ĝ, the more integrable first; each with its matrix for N = Ĝρ."""
    found = []
    for hand in (1.0, -1.0):
        attitude = closed_form(hand * N, inlier)
        found.append((attitude, hand * attitude.rotation))
    found.sort(key=lambda entry: entry[0].integral)
    best = found[0][0]
    diagnostics["s_eigen"] = {"values": best.eigenvalues.tolist(), "vectors": best.eigenvectors.tolist()}
    diagnostics["closed_form"] = {
        "r3_negative_share": best.negative_share,
        "integral": best.integral,
        "integral_other_hand": found[1][0].integral,
    }
    diagnostics["alpha_curve"] = _alpha_curve(best)
    return found


def _alpha_curve(attitude: Attitude) -> dict[str, Any]:
    """The report's Fig. 1(f): Eq. (18) and the left side of Eq. (19) over α, for both choices of u1."""
    alpha = np.radians(ALPHA_DEG)
    return {
        "alpha_deg": ALPHA_DEG.tolist(),
        "value": [angle.integral_at(alpha).tolist() for angle in attitude.angles],
        "condition": [angle.condition(alpha).tolist() for angle in attitude.angles],
        "candidate": attitude.chosen,
        "chosen": float(np.degrees(attitude.angles[attitude.chosen].alpha)),
    }


def _weak_diagnostics(weak: WeakRotation) -> dict[str, Any]:
    return {
        "scale": weak.scale,
        "stencil": weak.stencil,
        "functions": weak.functions,
        "radius": weak.radius,
        "starts": weak.starts,
        "other_hand": _finite(weak.other_hand),
        "converged": weak.converged,
        "rotation_stderr_deg": np.degrees(np.sqrt(np.diag(weak.covariance))).tolist(),
    }


def _shell_diagnostics(fit: Fit) -> dict[str, Any]:
    return {
        "C": fit.C.tolist(),
        "s0": fit.s0,
        "r2": fit.r2,
        "coefficients": [dict(c, t=_finite(float(c["t"]))) for c in fit.coefficients],
        "cond_F": float(np.sqrt(np.linalg.cond(fit.C))),
        "accepted": int(fit.accepted.sum()),
    }


def _unit(N: np.ndarray) -> np.ndarray:
    return N / np.maximum(np.linalg.norm(N, axis=-1, keepdims=True), 1e-300)


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
