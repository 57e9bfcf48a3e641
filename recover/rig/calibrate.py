"""A rig's F(x) from pictures of balls of known place: which pixels show the sphere, and how F depends on position.

A ball is in full view, or it is pressed into the sheet of gel (an elastomer) of a tactile sensor. Within the contact
circle, where it touches the ball, the sheet has the sphere's normals; beyond that it becomes flat over a distance that
depends on the gel, and its normals are not known. The sheet is steepest where it leaves the ball: F is fitted within a
small circle, the contact circle is that on which the mean tilt by this F is largest, and so on in turn. This needs no
scale: an F whose tilts are all too small has the same circle. A ball in full view is steepest at its silhouette.
"""

import datetime
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.optimize import nnls

from huesphere.configs.errors import InputError
from huesphere.recover.pixels.noise import channel_noise
from huesphere.recover.rig.ball import Ball
from huesphere.recover.rig.fit import Samples, angles_deg, fit_matrices, joined, normals_of
from huesphere.recover.rig.model import TERMS, RigModel, matrices_at, positions

FIRST_CIRCLE = 0.4  # of the ball's radius: where the search for the contact circle begins
LEAST_CIRCLE, LARGEST_CIRCLE = 0.2, 0.96  # of the ball's radius; nearer to the silhouette pixels are mixed
RING = 0.04  # of the ball's radius: steps of the radius; the mean tilt is taken over rings twice as wide
ROUNDS = 4  # of fit and circle
MOST_SAMPLES = 500  # pixels of a ball that F is fitted to
FLAT_FROM, FLAT_WEIGHT, FLAT_SAMPLES = 2.0, 0.05, 100  # of the sheet: from how many radii, its weight, its pixels
SECTORS = 8  # of a single ball, each left out once
FEWEST = 60  # pixels of a ball within its circle
FEWEST_BALLS = {0: 1, 1: 3, 2: 6}  # by the order of F(x)
LEAST_ERROR = 0.05  # degrees: no rig is stated to be better
BETTER = 0.97  # of the error of the lower order: from which a higher one is taken


@dataclass(frozen=True)
class CalibrationPicture:
    """A picture of a ball, as the rig will see its pictures."""

    rho: np.ndarray  # (H, W, 3) linear light, or its quotient by the reference
    usable: np.ndarray  # (H, W) bool: not clipped, no marker, finite
    ball: Ball


@dataclass(frozen=True)
class Calibration:
    """A rig, and what was found on the way to it."""

    rig: RigModel
    circles: tuple[float, ...]  # of each ball, over its radius
    by_order: dict[int, float]  # leave-one-out error in degrees of each order that was tried


def calibrate(
    pictures: Sequence[CalibrationPicture], *, divided: bool, markers: bool = False, encoding: str = "linear"
) -> Calibration:
    """The rig of calibration pictures of one size. Raises InputError where they do not determine it.

    ``divided``: ρ is the quotient by a reference picture, in which the surface is flat and faces the camera.
    """
    height, width = pictures[0].usable.shape
    position = positions((width, height))
    try:
        shown = [shown_by(picture, number, position, divided) for number, picture in enumerate(pictures)]
        circles = contact_circles(shown)
        samples = _samples(shown, circles)
        left_out = {
            order: _leave_one_out(samples, TERMS[order])
            for order, fewest in FEWEST_BALLS.items()
            if len(pictures) >= fewest
        }
        order, error = _chosen(left_out, samples.group)
        coefficients = fit_matrices(samples, TERMS[order])
    except np.linalg.LinAlgError as found:
        expected = "balls whose visible part turns to all sides, under lights of three colours"
        raise InputError(
            "the balls do not determine F", got=str(found), expected=expected, where="--calibrate"
        ) from None
    tilt = np.degrees(np.arccos(np.clip(samples.normals[:, 2], -1, 1)))
    length = np.linalg.norm(
        np.linalg.solve(matrices_at(coefficients, samples.position), samples.rho[..., None]), axis=1
    )
    scales = [picture.ball.mm_per_px for picture in pictures if picture.ball.mm_per_px is not None]
    rig = RigModel(
        coefficients=coefficients,
        size=(width, height),
        divided=divided,
        leave_one_out_deg=float(np.median(error[samples.group >= 0])),
        error_deg=_error_by_tilt(tilt, error),
        noise=float(np.median([channel_noise(picture.rho, picture.usable) for picture in pictures])),
        spread=float(np.quantile(np.abs(np.log(length)), 0.95)),
        markers=markers,
        encoding=encoding,
        date=datetime.date.today().isoformat(),
        mm_per_px=float(np.mean(scales)) if scales else None,
        balls=len(pictures),
        places=tuple(_place(picture.ball, (width, height)) for picture in pictures),
    )
    medians = {k: float(np.median(e[samples.group >= 0])) for k, e in left_out.items()}
    return Calibration(rig, circles, medians)


@dataclass(frozen=True)
class _Shown:
    """Pixels of a picture that show its sphere, if the contact circle reaches them, and those of the flat sheet."""

    samples: Samples
    distance: np.ndarray  # (N,) from the ball's centre over its radius; 0 for the flat sheet, which always counts

    def within(self, circle: float) -> Samples:
        return self.samples.only(self.distance < circle)


def contact_circles(shown: Sequence[_Shown]) -> tuple[float, ...]:
    """Radius of the circle within which each picture shows the sphere, over that of its ball."""
    circles = (FIRST_CIRCLE,) * len(shown)
    # F(x) linear in position, or constant for fewer balls, is accurate enough to find the circles.
    terms = TERMS[1 if len(shown) >= FEWEST_BALLS[1] else 0]
    for _ in range(ROUNDS):
        coefficients = fit_matrices(_samples(shown, circles), terms)
        grown = tuple(_circle(one, coefficients) for one in shown)
        if np.allclose(grown, circles):
            break
        circles = grown
    return circles


def _circle(shown: _Shown, coefficients: np.ndarray) -> float:
    """The radius (over the ball's) at which the mean tilt by F on a ring, away from the centre, is largest."""
    on_sphere = shown.samples.group >= 0
    sphere, r = shown.samples.only(on_sphere), shown.distance[on_sphere]
    found = normals_of(coefficients, sphere)
    outward = sphere.normals[:, :2] / np.maximum(r, 1e-9)[:, None]
    radial = np.arctan2((found[:, :2] * outward).sum(axis=1), found[:, 2])
    edges = np.arange(LEAST_CIRCLE, LARGEST_CIRCLE, RING)
    rings = [(r >= inner - RING / 2) & (r < inner + 3 * RING / 2) for inner in edges]
    tilts = [radial[ring].mean() if ring.any() else -np.inf for ring in rings]
    return float(min(edges[int(np.argmax(tilts))] + RING, LARGEST_CIRCLE))


def shown_by(picture: CalibrationPicture, number: int, position: np.ndarray, divided: bool) -> _Shown:
    """The pixels of the picture ``number`` that may show its sphere, and where a reference is divided out, the sheet.

    ``position`` (H, W, 2) as of ``recover.rig.model.positions``. Raises InputError where there are too few.
    """
    normals, distance = picture.ball.normals(picture.usable.shape)
    inside = picture.usable & (distance < LARGEST_CIRCLE)
    if (count := int(inside.sum())) < FEWEST:
        ball = picture.ball
        where = f"--ball {ball.x:g},{ball.y:g},{ball.radius:g}"
        raise InputError(
            "a ball that shows too little", got=f"{count} usable pixels", expected=f"{FEWEST} or more", where=where
        )
    inside = _thinned(inside, MOST_SAMPLES)
    parts = [_part(picture.rho[inside], normals[inside], position[inside], number, 1.0)]
    distances = [distance[inside]]
    if divided:
        flat = _thinned(picture.usable & (distance > FLAT_FROM), FLAT_SAMPLES)
        facing = np.tile([0.0, 0.0, 1.0], (int(flat.sum()), 1))
        parts.append(_part(picture.rho[flat], facing, position[flat], -1, FLAT_WEIGHT))
        distances.append(np.zeros(len(facing)))
    return _Shown(joined(parts), np.concatenate(distances))


def _part(rho: np.ndarray, normals: np.ndarray, place: np.ndarray, group: int, weight: float) -> Samples:
    """Samples of one group, whose weights have the sum ``weight``."""
    count = len(rho)
    return Samples(
        rho.astype(np.float64), normals, place, np.full(count, group), np.full(count, weight / max(1, count))
    )


def _place(ball: Ball, size: tuple[int, int]) -> tuple[float, float, float]:
    """x, y and radius of a ball, as of ``recover.rig.model.positions``."""
    (width, height), half = size, size[0] / 2
    return (ball.x - (width - 1) / 2) / half, ((height - 1) / 2 - ball.y) / half, ball.radius / half


def _samples(shown: Sequence[_Shown], circles: Sequence[float]) -> Samples:
    """All pixels within the circles; the groups of a single ball are its sectors."""
    samples = joined([one.within(circle) for one, circle in zip(shown, circles)])
    if len(shown) > 1:
        return samples
    angle = np.arctan2(samples.normals[:, 1], samples.normals[:, 0])
    sector = np.minimum(((angle + np.pi) / (2 * np.pi) * SECTORS).astype(int), SECTORS - 1)
    return replace(samples, group=np.where(samples.group >= 0, sector, -1))


def _thinned(inside: np.ndarray, most: int) -> np.ndarray:
    """At most ``most`` of the pixels that are ``inside`` (H, W), evenly chosen in raster order."""
    chosen = np.flatnonzero(inside)
    out = np.zeros(inside.shape, bool)
    if len(chosen):
        out.ravel()[chosen[np.linspace(0, len(chosen) - 1, min(most, len(chosen))).astype(int)]] = True
    return out


def _leave_one_out(samples: Samples, count: int) -> np.ndarray:
    """(N,) degrees: errors of the normals of each group by the F fitted to all others; of the flat sheet by all."""
    error = np.zeros(len(samples.rho))
    for group in np.unique(samples.group):
        out = samples.group == group
        coefficients = fit_matrices(samples if group < 0 else samples.only(~out), count)
        error[out] = angles_deg(normals_of(coefficients, samples.only(out)), samples.normals[out])
    return error


def _chosen(left_out: dict[int, np.ndarray], group: np.ndarray) -> tuple[int, np.ndarray]:
    """(order, errors): an order is taken if its leave-one-out error is below BETTER times that of all lower ones.

    The error is the mean over the balls of the median of each, so that one ball at the border decides little.
    """
    best, least = 0, np.inf
    for order, error in left_out.items():
        own = float(np.mean([np.median(error[group == one]) for one in np.unique(group[group >= 0])]))
        if own < BETTER * least:
            best, least = order, own
    return best, left_out[best]


def _error_by_tilt(tilt: np.ndarray, error: np.ndarray) -> tuple[float, float]:
    """(a, b) with RMS error √(a² + (b · tilt)²), degrees, from leave-one-out errors.

    Mean squares over the flat sheet and over thirds of the other pixels, by tilt, are fitted with a², b² ≥ 0, each to
    the same relative accuracy.
    """
    sloped = tilt > 0
    edges = np.quantile(tilt[sloped], [0, 1 / 3, 2 / 3, 1])
    parts = [~sloped, *(sloped & (tilt >= low) & (tilt <= high) for low, high in pairwise(edges))]
    rows = [((tilt[part] ** 2).mean(), max((error[part] ** 2).mean(), LEAST_ERROR**2)) for part in parts if part.any()]
    x, y = np.array(rows).T
    squares, _ = nnls(np.stack([1 / y, x / y], axis=1), np.ones(len(y)))
    return float(max(np.sqrt(squares[0]), LEAST_ERROR)), float(np.sqrt(squares[1]))
