"""What the colours of a picture show, in sentences, for the pages of results that failed or are doubtful.

Every method rests on colours that fill an ellipsoid, so what is said is how far they do: how many pixels can be used,
how far the colours spread in their three principal directions, and how the brightness is spread.
"""

import numpy as np

from huesphere.eval.score import Scene
from huesphere.recover.methods.table import METHODS

FLAT = 0.02  # spread in the least direction, relative to the largest, below which the colours are called nearly flat


def picture_facts(scene: Scene) -> tuple[str, ...]:
    """Sentences on the colours of the object; the picture alone decides them, not the truth."""
    mask = scene.observation.mask
    rgb = scene.observation.rgb[mask].astype(np.float64)
    finite = np.isfinite(rgb).all(axis=1)
    rho = rgb[finite]
    if len(rho) < 3:
        return (f"{len(rho)} pixels of the object have colours that are finite: nothing can be fitted to them.",)
    facts = [f"The object has {mask.sum():,} pixels"]
    lost = int((~finite).sum())
    dark, full = float(np.mean((rho <= 0).all(axis=1))), float(np.mean((rho >= 1).any(axis=1)))
    parts = [f"{lost:,} are not finite"] * (lost > 0)
    parts += [f"{dark:.0%} are black"] * (dark >= 0.005) + [f"{full:.0%} are at full scale or above"] * (full >= 0.005)
    facts[0] += f", of which {', '.join(parts)}." if parts else "; none is black, clipped or not finite."
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov(rho.T)), 0.0))[::-1]
    if spread[0] > 0:
        relative = spread / spread[0]
        words = f"Their colours spread by 1 : {relative[1]:.2g} : {relative[2]:.2g} in their principal directions"
        facts.append(
            f"{words}: they nearly lie in a plane, as under grey lights, under fewer than three colours of light, or "
            "under lights in one plane."
            if relative[2] < FLAT
            else f"{words}: they fill space, as an ellipsoid needs."
        )
    level = np.linalg.norm(rho, axis=1)
    low, high = np.quantile(level, [0.05, 0.95])
    if high > 0:
        facts.append(f"Between the 5th and the 95th percentile their brightness rises from {low:.2g} to {high:.2g}.")
    return tuple(facts)


def what_was_tried(method: str, steps: tuple[str, ...]) -> tuple[str, ...]:
    """What a method did: the ``steps`` that it reports, else what it does always."""
    if steps or method not in METHODS:
        return steps
    return (METHODS[method].does,)
