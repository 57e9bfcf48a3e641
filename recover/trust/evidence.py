"""What a picture says for or against an estimate of its normals, whichever method made it.

Each figure of ``Evidence`` tests one consequence of the model: colours lie on the ellipsoid, in every part of the
object the same one; the normals are those of a surface; no other rotation makes them so; they lean outward along the
silhouette; some of them face the camera. None of them uses anything but the picture and the estimate.
``recover.trust.verdict`` weighs them.
"""

from dataclasses import dataclass, fields

import numpy as np
from scipy import ndimage

from huesphere.recover.cues.linear_integrability import integrability_terms, off_axis_deg
from huesphere.recover.depth.integration import depth_from_normals
from huesphere.recover.ellipsoid.distance import residual_scales, signed_distance
from huesphere.recover.ellipsoid.fit import least_squares
from huesphere.recover.geometry.rays import facing_camera, of_relief, rays
from huesphere.recover.geometry.tangent_uncertainty import DEG
from huesphere.recover.io.estimate import Estimate
from huesphere.recover.pixels.usable import usable_pixels
from huesphere.recover.reasons import Reason, by_colour
from huesphere.recover.solution import Solution
from huesphere.recover.status import RecoveryFailure
from huesphere.recover.trust.alternatives import Turns, turns
from huesphere.recover.trust.hollow import hollowness
from huesphere.recover.trust.joined import joined_to
from huesphere.recover.trust.outline import outline
from huesphere.recover.trust.without_result import FEWEST, LARGEST_DEG
from huesphere.render.dataset import Observation
from huesphere.scenes.surfaces import depth_normals

# A colour lies outside the ellipsoid if its distance exceeds both so many standard deviations of the noise, and such a
# share of the colour's own length.
BEYOND, LEAST_BEYOND = 5.0, 0.01
LEAST_ALBEDO = 1e-6  # guards a division; the median albedo is 1


@dataclass(frozen=True)
class Evidence:
    """Figures for and against an estimate; angles in degrees, shares from 0 to 1."""

    stated_deg: float  # median of the errors that the method states
    rotation_deg: float  # standard error of the rotation that the method states
    condition: float  # cond F
    coverage: float  # share of the object that has normals
    core: float  # share of the object that is taken to see every light
    interpolated: float  # share of the normals that no colour explains
    mapped: float  # share of the normals that come from a smooth map of the normal
    apart: float  # share of the normals that a colour explains, and that do not join those of the all-lit pixels
    noise: float  # standard deviation of a channel over the brightest channel
    white_deg: float  # error of normals that the independent part of the residual causes
    correlated_deg: float  # error of normals that its spatially correlated part causes
    # Standard deviation of the core's normals along the direction in which they vary least: 0 where they lie in a
    # plane, as those of a cone or of a flat surface do
    spread_deg: float
    outside: float  # share of the usable pixels whose colour lies outside the ellipsoid, where no shadow can put it
    halves_deg: float  # how far the ellipsoids of opposite halves of the object disagree
    not_integrable_deg: float  # median angle of the normals from those of the surface nearest to them
    turn_spread_deg: float  # standard error of the rotation, from how far parts of the object disagree
    turn_moved_deg: float  # how far the rotation is from the one at which the normals are most integrable
    rival: float  # curl of the best other rotation over that of this one
    off_axis_deg: float  # angle of the most frontal normals to the camera's direction
    facing_away: float  # share of the normals that face away from the camera
    outward: float  # −1 … 1: how far all normals lean outward from the object's middle; 0 where there is no silhouette
    rim_deg: float  # median angle between the normals along the silhouette and the silhouette's own
    template_deg: float  # angle of the normals from those that one matrix makes of the inflated silhouette
    template_other_deg: float  # the same of the convex/concave twin
    removed: float  # share of the light that was subtracted as indirect
    twin_possible: float  # 0 (interreflection rules the convex/concave twin out) … 1 (it does not)
    # Factor by which the misfit falls if a constant is subtracted from all colours, over that by which it falls if the
    # estimate's indirect light is, which is at least 1
    offset_gain: float
    hollow: float  # light that the surface's parts would send each other at albedo 1, over the picture's light
    hollow_twin: float  # the same of the twin's parts
    by_light: float  # margin with which interreflection decided between convex and concave; 0 where it did not

    @property
    def turn_beyond_deg(self) -> float:
        """Distance of the rotation from the most integrable one, less two standard errors: its error at least."""
        beyond = self.turn_moved_deg - 2 * self.turn_spread_deg
        return max(beyond, 0.0) if np.isfinite(beyond) else LARGEST_DEG

    def record(self) -> dict[str, float | None]:
        """As JSON: null where a figure is not finite."""
        values = {one.name: float(getattr(self, one.name)) for one in fields(self)}
        return {name: value if np.isfinite(value) else None for name, value in values.items()}


def evidence_of(estimate: Estimate, observation: Observation) -> Evidence | None:
    """The evidence for an ``estimate`` of the ``observation``, in linear light; None where it has no normals.

    Raises LinAlgError where the estimate's F has no inverse.
    """
    solution, given = estimate.solution, estimate.valid & observation.mask
    if solution is None or given.sum() < FEWEST:
        return None
    try:
        pixels = usable_pixels(observation)
    except RecoveryFailure:
        return None
    removed = np.zeros_like(pixels.rgb) if estimate.removed is None else estimate.removed
    light = _of_albedo_one(pixels.rgb, estimate)
    rgb = np.where(pixels.usable[..., None], light - removed - solution.ambient, 0.0)
    core = solution.inlier & pixels.usable
    reason = np.where(given, int(Reason.ALL_LIT), 0) if estimate.reason is None else estimate.reason
    explained = given & by_colour(reason)
    normals = np.where(given[..., None], estimate.normals, 0.0).astype(np.float64)
    ray = rays(observation.camera, observation.mask.shape)
    view = facing_camera(normals, ray)
    white, correlated, outside = _residual(rgb, pixels.usable, core, solution)
    turned = _turned(rgb, core, solution, ray)
    rim = outline(normals, given, observation.mask, rgb, pixels.usable)
    whole = np.where(pixels.usable[..., None], light - solution.ambient, 0.0)
    hollow = hollowness(normals, given, core, observation, whole)  # the light between parts is tested where it is
    object_pixels = int(observation.mask.sum())
    return Evidence(
        stated_deg=float(np.nanmedian(estimate.uncertainty_deg[given])),
        rotation_deg=solution.rotation_stderr_deg,
        condition=solution.condition,
        coverage=float(given.sum() / object_pixels),
        core=float(core.sum() / object_pixels),
        interpolated=float((given & ~explained).sum() / given.sum()),
        mapped=float((given & (reason == Reason.IRRADIANCE_MAP)).sum() / given.sum()),
        apart=float((explained & ~joined_to(reason == Reason.ALL_LIT, normals, explained)).sum() / given.sum()),
        noise=solution.noise / max(float(rgb.max()), 1e-300),
        white_deg=white,
        correlated_deg=correlated,
        spread_deg=_spread_deg(rgb, core, solution),
        outside=outside,
        halves_deg=_halves_deg(rgb, core),
        not_integrable_deg=_not_integrable_deg(of_relief(normals, ray), explained, observation.mask),
        turn_spread_deg=turned.spread_deg,
        turn_moved_deg=turned.moved_deg,
        rival=turned.rival,
        off_axis_deg=off_axis_deg(view[given], fewest=1),
        facing_away=float((view[given] < 0).mean()),
        outward=rim.outward,
        rim_deg=rim.rim_deg,
        template_deg=rim.template_deg,
        template_other_deg=rim.template_other_deg,
        twin_possible=hollow.twin_possible,
        offset_gain=hollow.offset_gain / max(hollow.own_gain, 1.0),
        hollow=hollow.own,
        hollow_twin=hollow.twin,
        by_light=solution.convexity.margin if solution.convexity.evidence == "interreflection" else 0.0,
        removed=float(np.sum(removed[observation.mask]) / max(float(pixels.rgb[pixels.usable].sum()), 1e-300)),
    )


def evidence_or_none(estimate: Estimate, observation: Observation) -> Evidence | None:
    """As ``evidence_of``; None also where F has no inverse, which ``recover.trust.verdict.judged`` puts in a status."""
    try:
        return evidence_of(estimate, observation)
    except np.linalg.LinAlgError:
        return None


def _of_albedo_one(rgb: np.ndarray, estimate: Estimate) -> np.ndarray:
    """The colours (H, W, 3) divided by the albedo of the ``estimate``, if it has one: no misfit remains then."""
    if estimate.albedo is None:
        return rgb
    return rgb / np.maximum(np.nan_to_num(estimate.albedo, nan=1.0), LEAST_ALBEDO)[..., None]  # type: ignore[no-any-return]


def _residual(rgb: np.ndarray, usable: np.ndarray, core: np.ndarray, solution: Solution) -> tuple[float, float, float]:
    """(independent, spatially correlated residual of the core in degrees of a normal, share of colours outside)."""
    if core.sum() < FEWEST:
        return LARGEST_DEG, LARGEST_DEG, 1.0
    distance = signed_distance(rgb[core], solution.C)
    # Degrees by which an error of one picture unit turns a normal where F is weakest.
    per_unit = DEG * float(np.linalg.norm(np.linalg.inv(solution.F), 2))
    white, correlated = (min(scale * per_unit, LARGEST_DEG) for scale in residual_scales(distance, core))
    colours = rgb[usable]
    far = signed_distance(colours, solution.C)
    beyond = np.maximum(BEYOND * solution.noise, LEAST_BEYOND * np.linalg.norm(colours, axis=1))
    return white, correlated, float((far > beyond).mean())


def _spread_deg(rgb: np.ndarray, core: np.ndarray, solution: Solution) -> float:
    """Least standard deviation of the core's normals about their mean, degrees, over all directions of space.

    Normals in a plane n·a = c, as those of a cone, have colours in a plane, through which many ellipsoids pass: if
    ρᵀCρ = 1 and w·ρ = 1, then ρᵀ(C + t (w wᵀ − C))ρ = 1 for all t.
    """
    if core.sum() < FEWEST:
        return 0.0
    n = rgb[core] @ np.linalg.inv(solution.F).T
    n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-12)
    return float(DEG * np.sqrt(max(np.linalg.eigvalsh(np.cov(n.T))[0], 0.0)))


def _halves_deg(rgb: np.ndarray, core: np.ndarray) -> float:
    """How far ellipsoids fitted to opposite halves of the ``core`` (H, W) disagree, degrees.

    The halves are left and right, upper and lower, and the two of a chessboard of large squares, which hold the same
    normals more nearly. Of each pair it is half the largest logarithm of the ratio of their radii; the mean over the
    pairs is returned, since one half may lack the normals that determine its ellipsoid.
    """
    row, column = np.nonzero(core)
    if len(row) < 2 * FEWEST:
        return LARGEST_DEG
    side = max(2.0, np.sqrt(len(row)) / 4)
    chess = ((row // side).astype(int) + (column // side).astype(int)) % 2 == 0
    found = []
    for one in (column < np.median(column), row < np.median(row), chess):
        try:
            matrices = [least_squares(rgb[core][half]) for half in (one, ~one)]
            ratios = np.linalg.eigvals(np.linalg.solve(*matrices)).real
        except (RecoveryFailure, np.linalg.LinAlgError):  # a half lacks the normals, or no ellipsoid fits it
            found.append(LARGEST_DEG)
            continue
        # The eigenvalues are squared ratios of radii: a quarter of their logarithm is half of that of the radii.
        found.append(min(DEG * 0.25 * float(np.abs(np.log(np.maximum(ratios, 1e-9))).max()), LARGEST_DEG))
    return float(np.mean(found))


def _not_integrable_deg(normals: np.ndarray, known: np.ndarray, mask: np.ndarray) -> float:
    """Median angle between ``normals`` (H, W, 3) and those of the depth that is integrated from them, degrees."""
    if known.sum() < FEWEST:
        return LARGEST_DEG
    depth = depth_from_normals(normals, known, mask)
    of_depth = depth_normals(np.where(mask, depth, 0.0), mask)
    inner = ndimage.binary_erosion(known, np.ones((3, 3)))
    inner = known if inner.sum() < FEWEST else inner
    unit = normals[inner] / np.maximum(np.linalg.norm(normals[inner], axis=1, keepdims=True), 1e-9)
    cosine = np.clip((unit * of_depth[inner]).sum(axis=1), -1, 1)
    return float(np.degrees(np.median(np.arccos(cosine))))


def _turned(rgb: np.ndarray, core: np.ndarray, solution: Solution, ray: np.ndarray | None) -> Turns:
    """How firmly integrability holds the rotation; as bad as can be where it has too few pixels."""
    if core.sum() < FEWEST:
        return Turns(LARGEST_DEG, LARGEST_DEG, 1.0)
    AB, row, column = integrability_terms(rgb, core, np.linalg.inv(solution.F), ray, most=4000)
    return turns(AB, row, column)
