"""The verdict on an estimate as people read it: one word, what speaks against the result, what to do, where to read on.

The word and the doubts are the method's own (``recover.trust``); nothing here looks at the truth.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from huesphere.eval.metrics import Row
from huesphere.recover.io.estimate import Estimate
from huesphere.recover.reasons import by_colour
from huesphere.recover.status import REMEDIES
from huesphere.recover.trust.verdict import MOST_MEDIAN_DEG

DOUBTFUL_DEG = MOST_MEDIAN_DEG  # stated error from which a pixel is hatched: that at which a whole result is doubted
VERDICTS = ("trust", "doubtful", "failed")
SIGNS = {"trust": "✓", "doubtful": "?", "failed": "✗"}  # beside the word, so that no reader needs the colour
VERDICT_PAGE, FAILURE_PAGE = "docs/recover/verdict.md", "docs/recover/failures.md"
MEANINGS = {
    "trust": "The normals can be used, with the errors that are stated.",
    "doubtful": "Normals are given, and something speaks against them.",
    "failed": "There are no normals.",
}


@dataclass(frozen=True)
class Verdict:
    """A verdict in words."""

    word: str  # of VERDICTS; "" for what no method of ours has judged, such as normal maps from elsewhere
    why: tuple[str, ...] = ()  # what speaks against the result, the gravest first
    todo: tuple[str, ...] = ()  # what would help
    page: str = ""  # of the documentation

    @property
    def sign(self) -> str:
        """A sign for the word."""
        return SIGNS.get(self.word, "")

    @property
    def meaning(self) -> str:
        """What the word means, in a sentence."""
        return MEANINGS.get(self.word, "")


NO_VERDICT = Verdict("")


def verdict_of(row: Row, doubts: Sequence[str] = ()) -> Verdict:
    """The verdict of a result, from its ``row`` and the ``doubts`` of its estimate.

    A doubt ends in "; " and what would help if it has a remedy in ``REMEDIES``: the two are told apart here, and what
    would help is said once however many doubts call for it.
    """
    if row.status in ("missing", "failed") and not row.verdict:
        return Verdict("failed", (row.message,) if row.message else ())
    if not row.verdict:
        return NO_VERDICT
    why, todo = [], []
    for doubt in doubts or ((row.message,) if row.message and row.verdict != "trust" else ()):
        found, remedy = split_remedy(doubt)
        why.append(found)
        todo += [remedy] if remedy else []
    if row.verdict != "trust" and not todo and row.status in REMEDIES:
        todo.append(REMEDIES[row.status])
    page = {"trust": "", "doubtful": VERDICT_PAGE, "failed": FAILURE_PAGE}.get(row.verdict, "")
    return Verdict(row.verdict, tuple(dict.fromkeys(why)), tuple(dict.fromkeys(todo)), page)


def split_remedy(doubt: str) -> tuple[str, str]:
    """(what was found, what would help) of a doubt; "" for the second if it names no remedy.

    >>> split_remedy("noise of 4 %; give a larger region")
    ('noise of 4 %; give a larger region', '')
    """
    for remedy in REMEDIES.values():
        if doubt.endswith(f"; {remedy}"):
            return doubt.removesuffix(f"; {remedy}"), remedy
    return doubt, ""


def doubtful_pixels(estimate: Estimate, mask: np.ndarray) -> np.ndarray:
    """Pixels of the object whose normal is not to be relied on by what the estimate itself says, (H, W) bool.

    Those without a normal, those whose normal does not follow from their colour (it is interpolated), and those whose
    stated error is DOUBTFUL_DEG or more. All of the object where the whole result is not to be trusted for a reason
    that no pixel shows would hatch everything and say nothing, so that is left to the word.

    Args:
        estimate: of any method; one from elsewhere, without stated errors, is doubted only where it gives no normal.
        mask: (H, W) bool, the object.
    """
    doubtful = ~estimate.valid
    with np.errstate(invalid="ignore"):
        doubtful |= estimate.uncertainty_deg >= DOUBTFUL_DEG
    if estimate.reason is not None:
        doubtful |= ~by_colour(estimate.reason)
    return np.asarray(doubtful & mask)
