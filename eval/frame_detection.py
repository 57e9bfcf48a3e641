"""Finds by the truth in which frame the normal maps of another program agree best with it, so that it can be said.

A frame is never applied because the truth favours it, unless the user asks for that (``--frame auto``): a map in
another frame is wrong as it stands, and only its maker knows what was meant. Where (−x, −y, z) agrees best, no frame is
applied even then: a surface that is taken for concave instead of convex looks the same.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.eval.align import best_orthogonal
from huesphere.eval.frames import FRAMES, OURS, Frame, twin_of
from huesphere.eval.metrics import angular_error_deg, median
from huesphere.eval.normal_map import read_map
from huesphere.eval.score import Item
from huesphere.render.dataset import read_truth

MOST_PICTURES = 8  # of each method, spread evenly over the run
MOST_PIXELS = 20_000  # of each picture
BETTER_BY_DEG = 5.0  # a frame is proposed if its median error is smaller by this and by the next factor
BETTER_TIMES = 0.6


@dataclass(frozen=True)
class FrameFinding:
    """How a method's maps agree with the truth in the frame that was given and in the best one."""

    method: str
    given: Frame
    given_deg: float  # median error, averaged over the pictures
    best: Frame
    best_deg: float
    pictures: int
    mirrored: bool  # whether only a reflection, in no frame of ours, brings the maps near the truth
    away: Path | None  # the first map most of whose normals face away from the camera in the given frame

    @property
    def differs(self) -> bool:
        """Whether the best frame is clearly better than the given one, and no other solution of the same picture."""
        return self._better and self.best != twin_of(self.given)

    @property
    def _better(self) -> bool:
        return self.best_deg < min(BETTER_TIMES * self.given_deg, self.given_deg - BETTER_BY_DEG)

    @property
    def hint(self) -> str:
        """A line for the user; "" if there is nothing to say."""
        if self.differs:
            y_only = self.given.axes == "RUB" and self.best.axes == "RDB"
            turned = "with y turned over" if y_only else f"in the frame {self.best.name} ({self.best.description})"
            asked = "is its y downward? " if y_only else ""
            named = f" ({self.best.description})" if y_only else ""
            return (
                f"{self.method}: {turned}{named} it would be {self.best_deg:.1f}° instead of {self.given_deg:.1f}°: "
                f"{asked}--frame {self.best.name} scores it so"
            )
        if self._better:
            return (
                f"{self.method}: with x and y turned over it would be {self.best_deg:.1f}° instead of "
                f"{self.given_deg:.1f}°: is it hollow instead of bulging, or its frame {self.best.axes}?"
            )
        if self.mirrored:
            return f"{self.method}: only a reflection brings the map near the truth: its frame is left-handed"
        return ""

    @property
    def applied(self) -> str:
        """A line that says which frame was found for ``auto`` and is applied."""
        if self._better and not self.differs:
            return f"{self.hint} --frame {self.best.axes} says the latter"
        if not self.differs:
            return (
                f"{self.method}: frame {self.given.name} ({self.given.description}): no other agrees clearly better "
                f"with the truth ({self.given_deg:.1f}°)"
            )
        return (
            f"{self.method}: frame {self.best.name} ({self.best.description}), found by its agreement with the truth "
            f"of {self.pictures} picture{'s' * (self.pictures > 1)}: {self.best_deg:.1f}° in it"
            + (f", {self.given_deg:.1f}° in {self.given.name}" if self.best.axes != self.given.axes else "")
        )


def settle_frames(
    items: Sequence[Item], maps: Mapping[str, Mapping[str, Path]], asked: Mapping[str, Frame | None]
) -> tuple[dict[str, Frame], list[str], list[str]]:
    """(frame of each method, lines on frames that were found, hints that another frame would be better).

    ``maps``: paths by item id and method; ``asked``: the frame of each method, None for the one that agrees best with
    the truth. Raises InputError for a map or truth that cannot be read, and for maps in a frame that was given most of
    whose normals face away from the camera.
    """
    frames: dict[str, Frame] = {}
    found: list[str] = []
    hints: list[str] = []
    for method, frame in asked.items():
        frames[method] = frame or OURS
        finding = compare_frames(items, maps, method, frames[method])
        if finding is None:
            continue
        if frame is None:
            frames[method] = finding.best if finding.differs else OURS
            found.append(finding.applied)
        elif finding.away is not None:
            expected = f"{frame.description} (n_z > 0)"
            raise InputError(
                "most normals face away from the camera",
                expected=f"{expected}; {finding.hint}" if finding.hint else f"{expected}, or another --frame",
                where=finding.away,
            )
        if frame is not None or finding.mirrored:
            hints += [finding.hint] if finding.hint else []
    return frames, found, hints


def compare_frames(
    items: Sequence[Item], maps: Mapping[str, Mapping[str, Path]], method: str, given: Frame
) -> FrameFinding | None:
    """Compare the maps of a method with the truth in every frame; None if there is nothing to compare."""
    with_map = [item for item in items if item.status == "done" and method in maps.get(item.id, {})]
    pairs, away = [], None
    for item in (with_map[n] for n in _evenly(len(with_map), MOST_PICTURES)):
        path = maps[item.id][method]
        pair = _pair(item, path)
        if pair is not None:
            pairs.append(pair)
            if away is None and np.median(given.to_camera(pair[0])[:, 2]) < 0:
                away = path
    if not pairs:
        return None
    errors = {frame.axes: float(np.mean([_median_error(frame, *pair) for pair in pairs])) for frame in FRAMES}
    best = min(FRAMES, key=lambda frame: errors[frame.axes])
    by_turn, by_any = (np.mean([_aligned_error(*pair, proper=proper) for pair in pairs]) for proper in (True, False))
    mirrored = by_any < BETTER_TIMES * by_turn and by_any < by_turn - BETTER_BY_DEG
    return FrameFinding(
        method,
        given,
        errors[given.axes],
        best,
        errors[best.axes],
        len(pairs),
        bool(mirrored) and not given.left_handed,
        away,
    )


def _pair(item: Item, path: Path) -> tuple[np.ndarray, np.ndarray] | None:
    """(normals of the map in its own frame, true normals), (N, 3) each, at some pixels that have both."""
    truth = read_truth(item.folder / "truth.exr")
    mask = truth.mask & np.isfinite(truth.normals).all(axis=-1)
    height, width = mask.shape
    found = read_map(path, (height, width), mask)
    both = np.flatnonzero(found.valid & mask)
    if both.size == 0:
        return None
    at = both[_evenly(both.size, MOST_PIXELS)]
    return found.vectors.reshape(-1, 3)[at], truth.normals.reshape(-1, 3)[at].astype(np.float64)


def _median_error(frame: Frame, normals: np.ndarray, truth: np.ndarray) -> float:
    return median(angular_error_deg(frame.to_camera(normals), truth))


def _aligned_error(normals: np.ndarray, truth: np.ndarray, *, proper: bool) -> float:
    """Median error in degrees after the best rotation, or the best orthogonal matrix."""
    return median(angular_error_deg(normals @ best_orthogonal(normals, truth, proper=proper).T, truth))


def _evenly(count: int, most: int) -> np.ndarray:
    """At most ``most`` of the indices below ``count``, evenly spaced."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(int)) if count else np.array([], dtype=int)
