"""The tests that a verdict is a product of: each turns some figures of the evidence into a credibility from 0 to 1.

A factor is a logistic function of a weighted sum of figures, each of which speaks against the estimate the more the
larger it is. Within a factor a good figure may make up for a bad one. The verdict takes the factor for convex or
concave by itself and multiplies the others; as none exceeds 1, no good factor makes up for a bad one. The factor that
is least, over what is asked of it, says what is wrong. The weights were fitted to random scenes
(``verdict_weights.json``, written by ``benchmarks/trust_fit.py``); their signs are fixed here.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from huesphere.recover.trust.evidence import Evidence

# Median angle between the surface's normals along the outline and the outline's own normals from which the outline is
# taken for a cut through the surface, where the mask or the picture ends it, and not for an occluding contour.
CUT_DEG = 20.0
# Such an angle of the twin from which the outline is not taken for an occluding contour of the twin. The larger of the
# two limits, since a surface that was turned inside out has larger errors along its outline.
TWIN_CONTOUR_DEG = 60.0
BEYOND_DEG = 3.0  # unit of ``moved_beyond``: distance to the most integrable rotation, less two standard errors
MOST_SHARE = 0.4  # a larger share of pixels that the lights do not explain counts as this
# Two limits of the ratio of curls, that of the best other rotation over that of the rotation taken. Below the first
# limit the other rotation speaks against the estimate, the more the nearer the ratio is to 1. From the second limit on
# the message does not mention it.
WORSE_RIVAL, TOLD_RIVAL = 1.3, 10.0
LEAST = 1e-3  # degrees, or a share: smaller figures count as this


def _log(value: float) -> float:
    """Decimal logarithm of a value that is limited to LEAST … 1000; one that is not finite counts as 1000."""
    return float(np.log10(np.clip(value if np.isfinite(value) else 1e3, LEAST, 1e3)))


def _cut(evidence: Evidence) -> float:
    """0 where the outline is an occluding contour of a convex surface … 1 where it is not, as of a bowl or a relief."""
    if evidence.outward <= 0:
        return 1.0
    return float(np.clip(evidence.rim_deg / CUT_DEG, 0.0, 1.0))


def _inside_out(evidence: Evidence) -> float:
    """1 where the normals lean inward and the outline would be an occluding contour of the twin … 0 where they do not.

    At an occluding contour the normal is the outline's own, so that the twin's is its opposite, at 180 degrees. Where
    both are far from this, as in a relief, the outline cuts the surface, and does not say which of the two is right.
    """
    off_contour = (180.0 - evidence.rim_deg) / TWIN_CONTOUR_DEG
    return max(-evidence.outward, 0.0) * float(np.clip(1 - off_contour, 0.0, 1.0))


def _planar(evidence: Evidence) -> float:
    """0 where the normals' spread about a plane stands out of the misfit; else by how much it does not, in decades."""
    return max(_log(evidence.white_deg + evidence.correlated_deg) - _log(evidence.spread_deg), 0.0)


def _rivalled(evidence: Evidence) -> float:
    """0 where every other rotation leaves far more curl … 1 where one leaves no more than the rotation taken."""
    return float(np.clip((WORSE_RIVAL - evidence.rival) / (WORSE_RIVAL - 1), 0.0, 1.0))


def _rotation_told(evidence: Evidence) -> str:
    if _rivalled(evidence) > 0:
        return (
            "another surface explains the picture as well: turned or mirrored, the normals leave "
            f"{_two_digits(evidence.rival)} times the curl"
        )
    moved, spread = _two_digits(evidence.turn_moved_deg), _two_digits(evidence.turn_spread_deg)
    told = f"the normals are most integrable when turned by {moved}° (parts of the object disagree by {spread}°)"
    if evidence.rival < TOLD_RIVAL:
        told += f", and another rotation leaves {_two_digits(evidence.rival)} times the curl"
    return told


def _two_digits(value: float) -> str:
    """A number rounded to two digits, never with an exponent below a million: 4.2, 150, 1500."""
    return f"{float(f'{value:.2g}'):g}"


@dataclass(frozen=True)
class Factor:
    """One test: its figures, each larger where it speaks against the estimate, and what it means when it fails."""

    status: str  # of an estimate that it refuses, a key of ``recover.status.REMEDIES``
    figures: Callable[[Evidence], dict[str, float]]
    told: Callable[[Evidence, float], str]  # what was measured, for people; the float is the stated error, degrees


FACTORS: dict[str, Factor] = {
    "uncertain": Factor(
        "uncertain",
        lambda e: {"stated": _log(e.stated_deg), "rotation": _log(e.rotation_deg), "noise": _log(e.white_deg)},
        lambda e, stated: (
            f"the normals are uncertain (±{_two_digits(stated)}° at the median pixel, the rotation "
            f"±{_two_digits(e.rotation_deg)}°, cond F {_two_digits(e.condition)})"
        ),
    ),
    "model": Factor(
        "model-misfit",
        lambda e: {
            "correlated": _log(e.correlated_deg),
            "outside": min(e.outside, 0.5),
            "parts": _log(e.halves_deg),
            "offset": min(max(_log(e.offset_gain), 0.0), 1.0),
            "planar": _planar(e),
        },
        lambda e, stated: (
            f"the normals lie nearly on a cone or a plane ({_two_digits(e.spread_deg)}° about it, with a misfit of "
            f"{_two_digits(e.white_deg + e.correlated_deg)}°), and many ellipsoids fit their colours"
            if _planar(e) > 0
            else f"colours do not lie on one ellipsoid (misfit {_two_digits(e.correlated_deg)}° of a normal, "
            f"{e.outside:.0%} brighter than it allows, parts of the object disagree by {_two_digits(e.halves_deg)}°)"
        ),
    ),
    "surface": Factor(
        "not-integrable",
        lambda e: {"curl": _log(e.not_integrable_deg)},
        lambda e, stated: f"the normals are {_two_digits(e.not_integrable_deg)}° (median) from those of any surface",
    ),
    "rotation": Factor(
        "rotation-undetermined",
        lambda e: {
            "spread": _log(e.turn_spread_deg),
            "moved": _log(e.turn_moved_deg),
            "moved_beyond": min(e.turn_beyond_deg / BEYOND_DEG, 3.0),
            "rival": -_log(e.rival),
            "rivalled": _rivalled(e),
        },
        lambda e, stated: _rotation_told(e),
    ),
    "view": Factor(
        "facing-away",
        lambda e: {"off_axis": e.off_axis_deg / 10, "away": min(e.facing_away, 0.5)},
        lambda e, stated: (
            f"the normal nearest to the camera is {e.off_axis_deg:.0f}° off axis, {e.facing_away:.0%} face away"
        ),
    ),
    # Convex or concave, the choice between an estimate and its twin; not chirality, the sign of det F, which
    # ``other_hand`` of ``recover.rotation.weak_form`` is about. Estimates and weights are stored with this name.
    "hand": Factor(
        "convex-or-concave",
        lambda e: {
            "inside_out": _inside_out(e),
            "not_by_light": -e.by_light * (1 - e.twin_possible),  # a constant may be mistaken for light of a hollow
            "twin": _log(e.twin_possible),
            "cut": _cut(e),
            # A twin that interreflection leaves possible speaks louder where the outline tells nothing. The logarithm
            # counts from its least value, so that the product is never negative.
            "twin_of_cut": _cut(e) * (_log(e.twin_possible) - _log(LEAST)),
        },
        lambda e, stated: (
            f"a hill and a hollow explain the picture nearly as well (outline {e.outward:+.2f}, the light "
            f"of a hollow would need an albedo of at most {_two_digits(e.twin_possible)})"
        ),
    ),
    "coverage": Factor(
        "little-explained",
        lambda e: {
            "core": -_log(e.core),
            "interpolated": min(e.interpolated, MOST_SHARE),
            "mapped": min(e.mapped, MOST_SHARE),
            "apart": min(e.apart, MOST_SHARE),
        },
        lambda e, stated: (
            f"{e.core:.0%} of the object is taken to see every light, {e.interpolated:.0%} is interpolated, "
            f"{e.mapped:.0%} comes from a smooth map, {e.apart:.0%} does not join the rest of the surface"
        ),
    ),
}
