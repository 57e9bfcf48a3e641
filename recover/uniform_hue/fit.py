"""G of an object of one hue, from integrability and from what fixes the bas-relief ambiguity, each with its own scale.

G maps whitened colours to normals up to their length, G ρ = a n. Unknowns are the nine elements of G; log κ, κ being
the depth factor of the silhouette's template; and the shading s, the part of brightness that depends on the normal
although it is not albedo (``albedo.log_albedo``). Minimised is

    Σ_i n_i log s_i² + (log κ / σ_κ)² + (s / σ_s)²,

where s_i is the robust scale of the residuals of cue i (within a round, s_i² is their mean square with fixed Cauchy
weights, plus the square of the cue's least scale). So a cue that does not hold for this object, whose scale is large
whatever G is, has little influence. The number n_i says how many independent residuals cue i is worth. That is far
fewer than the cue has, because errors of the model are smooth. The n_i, σ_κ and σ_s over the scale of the curls were
chosen by experiment (``cue_weights.json``). The cues:

- *curl*: the normals are those of a surface (``curl``), up to a bas-relief transformation.
- *spread*: log a varies little, and *steps*: log a is mostly the same at places a few pixels apart (``albedo``).
- *template*: normals are about those of the inflated silhouette, with κ times its depth (``recover.cues``).

Source: this project (research log, "Brightness that varies from place to place").
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from huesphere.recover.cues.silhouette_matrix import matrix_to_template
from huesphere.recover.geometry.least_squares import Schedule, descend
from huesphere.recover.parameters import learned
from huesphere.recover.robust_scale import mad_scale
from huesphere.recover.uniform_hue.albedo import log_albedo
from huesphere.recover.uniform_hue.picture import Picture

LOG_DEPTHS = (-0.7, 0.0, 0.4)  # log κ of the starts
ROUNDS = 4  # of reweighting, from the best of the first fits on
FIRST_ROUNDS = 10  # of the regression that each start begins with
CAUCHY = 2.385  # width of Cauchy's loss in standard deviations: 95 % efficient for Gaussian residuals
DESCENT = Schedule(first_damping=1e-3, most_steps=6, trials=6, relative_gain=1e-4)

Residual = Callable[[np.ndarray], np.ndarray]
Linearised = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Cue:
    """One kind of residuals, functions of the unknowns (11,): G in rows, log κ, shading."""

    name: str
    count: float  # n_i, how many independent residuals it is worth
    least: float  # least scale: a smaller one does not lower the loss
    residual: Residual  # (11,) to (R,)
    linearised: Linearised  # (11,) to (R,), (R, 11)


@dataclass(frozen=True)
class Fitted:
    """The unknowns, and how they were found."""

    x: np.ndarray  # (11,) G in rows, |det G| = 1; log κ; the shading that is left in the albedo
    scales: dict[str, float]  # s_i of each cue
    loss: float
    cues: tuple[Cue, ...]
    weights: tuple[np.ndarray, ...]  # of the residuals of each cue: Cauchy's
    precision: np.ndarray  # (2,) of log κ and of the shading: inverse variances that are known beforehand

    @property
    def G(self) -> np.ndarray:
        """(3, 3) of whitened colours."""
        return self.x[:9].reshape(3, 3)

    @property
    def log_depth(self) -> float:
        """log κ."""
        return float(self.x[9])


def cue_weights() -> dict[str, Any]:
    """Counts and least scales of the cues, σ_κ ("depth"), and σ_s over the scale of the curls ("shading per curl")."""
    return learned("uniform_hue/cue_weights.json")


def cues_of(picture: Picture) -> tuple[Cue, ...]:
    """The cues that a ``picture`` gives."""
    d = picture.colours / np.linalg.norm(picture.colours, axis=1, keepdims=True)

    wanted = unit_normals(picture.heights)
    spread = float(np.sqrt((wanted[:, :2] ** 2).sum(axis=1).mean()))

    def curl(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        residual, slope = picture.curl.jacobian(x[:9].reshape(3, 3))
        return residual, np.column_stack([slope, np.zeros((len(slope), 2))])

    def albedo(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        value, slope = log_albedo(picture.colours, x[:9].reshape(3, 3), x[10])
        return value - value.mean(), without_depth(slope - slope.mean(axis=0))

    def steps(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        (one, by_one), (other, by_other) = (log_albedo(c, x[:9].reshape(3, 3), x[10]) for c in picture.pairs)
        return other - one, without_depth(by_other - by_one)

    def template(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        shallower = np.array([1.0, 1.0, np.exp(x[9])])  # the normals of the surface at 1/κ times its depth
        found = (d @ x[:9].reshape(3, 3).T @ picture.frame) * shallower
        length = np.maximum(np.linalg.norm(found, axis=1), 1e-12)
        n = found / length[:, None]
        across = (np.eye(3) - n[:, :, None] * n[:, None, :]) / length[:, None, None]  # (P, 3, 3) dn by found
        by_G = np.einsum("pkm,pe->pkme", (across * shallower) @ picture.frame.T, d).reshape(-1, 9)
        by_depth = across[:, :, 2] * found[:, 2:]
        return (n - wanted).ravel() / spread, np.column_stack(
            [by_G, by_depth.ravel(), np.zeros(by_G.shape[0])]
        ) / spread

    def without_depth(slope: np.ndarray) -> np.ndarray:
        return np.insert(slope, 9, 0.0, axis=1)

    def only(function: Linearised) -> Residual:
        return lambda x: function(x)[0]

    known = cue_weights()["cues"]
    functions: dict[str, Linearised] = {"curl": curl, "spread": albedo, "template": template, "steps": steps}
    residuals = {name: only(function) for name, function in functions.items()}
    residuals["curl"] = lambda x: picture.curl.residual(x[:9].reshape(3, 3))
    return tuple(
        Cue(name, known[name]["count"], known[name]["least"], residuals[name], function)
        for name, function in functions.items()
        if known[name]["count"] > 0
    )


def fit(picture: Picture) -> Fitted:
    """Fit from each depth of LOG_DEPTHS with one round of reweighting, then refine the best fit by ROUNDS more rounds.

    The best fit is that of least loss. Raises LinAlgError where the colours span fewer than three dimensions.
    """
    cues = cues_of(picture)
    d = picture.colours / np.linalg.norm(picture.colours, axis=1, keepdims=True)
    starts = []
    for log_depth in LOG_DEPTHS:
        G = picture.frame @ matrix_to_template(d, unit_normals(picture.heights, log_depth), FIRST_ROUNDS)
        starts.append(_refined(cues, np.append(G.ravel(), [log_depth, 0.0]), rounds=1))
    best = min(starts, key=lambda one: one.loss)
    return _refined(cues, best.x, rounds=ROUNDS)


def _refined(cues: tuple[Cue, ...], start: np.ndarray, rounds: int) -> Fitted:
    """The minimum near ``start`` (11,), by so many ``rounds`` of reweighting and descent."""
    x = start
    for _ in range(rounds):
        weights = tuple(_cauchy(cue.residual(x), cue.least) for cue in cues)
        precision = _precision(cues, x)
        x = descend(
            x,
            loss=partial(_loss, cues, weights, precision),
            linearise=partial(_normal_equations, cues, weights, precision),
            step=_step,
            schedule=DESCENT,
        ).state
    residuals = [cue.residual(x) for cue in cues]
    scales = {cue.name: max(mad_scale(r), cue.least) for cue, r in zip(cues, residuals, strict=True)}
    precision = _precision(cues, x)
    total = sum(2 * cue.count * np.log(scales[cue.name]) for cue in cues) + precision @ x[9:] ** 2
    weights = tuple(_cauchy(r, cue.least) for cue, r in zip(cues, residuals, strict=True))
    return Fitted(x, scales, float(total), cues, weights, precision)


def _cauchy(residual: np.ndarray, least: float) -> np.ndarray:
    return 1 / (1 + (residual / (CAUCHY * max(mad_scale(residual), least))) ** 2)  # type: ignore[no-any-return]


def _precision(cues: tuple[Cue, ...], x: np.ndarray) -> np.ndarray:
    """(2,) inverse variances of log κ and of the shading.

    How far from matte the surface is shows in the curls, as an angle of the directions of colours; brightness is off by
    a multiple of that.
    """
    curl = next(cue for cue in cues if cue.name == "curl")
    shading = cue_weights()["shading per curl"] * max(mad_scale(curl.residual(x)), curl.least)
    return np.array([cue_weights()["depth"], max(shading, 1e-6)]) ** -2.0


def _loss(cues: tuple[Cue, ...], weights: tuple[np.ndarray, ...], precision: np.ndarray, x: np.ndarray) -> float:
    """Σ n_i log s_i² + (log κ / σ_κ)² + (s / σ_s)², s the shading, plus a constant that keeps the loss positive.

    s_i² is the weighted mean square of the residuals of cue i, plus the square of the cue's least scale.
    """
    total = float(precision @ x[9:] ** 2) + 1e4
    for cue, weight in zip(cues, weights, strict=True):
        residual = cue.residual(x)
        total += cue.count * np.log((weight * residual**2).sum() / weight.sum() + cue.least**2)
    return float(total)


def _normal_equations(
    cues: tuple[Cue, ...], weights: tuple[np.ndarray, ...], precision: np.ndarray, x: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(gradient (11,), Gauss–Newton matrix (11, 11)) of half the loss."""
    gradient, matrix = np.zeros(11), np.zeros((11, 11))
    gradient[9:], matrix[[9, 10], [9, 10]] = x[9:] * precision, precision
    for cue, weight in zip(cues, weights, strict=True):
        g, M = cue_equations(cue, weight, x)
        gradient, matrix = gradient + g, matrix + M
    return gradient, matrix


def cue_equations(cue: Cue, weight: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The part of one cue in ``_normal_equations``."""
    residual, J = cue.linearised(x)
    scale = cue.count / ((weight * residual**2).sum() + weight.sum() * cue.least**2)
    weighted = J * (weight * scale)[:, None]
    return weighted.T @ residual, weighted.T @ J


def _step(x: np.ndarray, equations: tuple[np.ndarray, np.ndarray], damping: float) -> np.ndarray:
    """The damped step, with G scaled to |det G| = 1."""
    gradient, matrix = equations
    step = np.linalg.solve(
        matrix + damping * np.diag(np.diag(matrix)) + 1e-9 * np.trace(matrix[:9, :9]) * np.eye(11), gradient
    )
    x = x - step
    x[:9] /= np.cbrt(max(abs(float(np.linalg.det(x[:9].reshape(3, 3)))), 1e-12))
    return x


def unit_normals(heights: np.ndarray, log_depth: float = 0.0) -> np.ndarray:
    """Unit normals (P, 3) of the template of depth κ from its ``heights`` (P, 3)."""
    n = heights * np.array([1.0, 1.0, np.exp(-log_depth)])
    return n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-12)  # type: ignore[no-any-return]
