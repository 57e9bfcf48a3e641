"""The figure of stated against true error: for each method its median, and for a single one the quartiles too."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon

from huesphere.eval.calibration import CalibrationCurve, calibration_curve
from huesphere.eval.figures import Panel, plot_panel
from huesphere.eval.plot import LINES, Plot, Ruler, style_of
from huesphere.eval.score import Score

TICKS = (0.01, 0.1, 1.0, 10.0, 100.0)
STATED = Ruler("stated error, degrees", 0.008, 125.0, TICKS, log=True)
TRUE = Ruler("true error, degrees", 0.008, 125.0, TICKS, log=True)


def calibration_panels(curves: Mapping[str, Score], lines: Sequence[int], key: str, what: str) -> list[Panel]:
    """Return the figure of the scores that have stated errors, as a list; an empty one if none has.

    Args:
        curves: score of each curve by label, of one picture or pooled.
        lines: style of each curve, an index in LINES.
        key: file name of the panel.
        what: ending of its title.
    """
    found = {
        label: (calibration_curve([one.stated]), line)
        for (label, one), line in zip(curves.items(), lines, strict=True)
        if one.stated is not None
    }
    found = {label: drawn for label, drawn in found.items() if drawn[0].stated_deg.size}
    if not found:
        return []

    def artists() -> list[Artist]:
        made: list[Artist] = [Line2D([0.008, 125.0], [0.008, 125.0], color="#888888", lw=1.0, ls=(0, (4, 3)))]
        for curve, line in found.values():
            if len(found) == 1:
                made.append(_band(curve, LINES[line % len(LINES)][0]))
            made.append(Line2D(curve.stated_deg, curve.median_deg, marker="o", ms=3.5, **style_of(line)))
        return made

    band = " Band: its quartiles." if len(found) == 1 else ""
    caption = (
        f"Curve: median of the true error of the pixels with a stated error of x.{band} On the dashed diagonal both "
        "are the same; above it the method is too sure of itself."
    )
    legend = tuple((label, line) for label, (_, line) in found.items()) if len(found) > 1 else ()
    return [plot_panel(key, f"Stated against true error{what}", caption, Plot(STATED, TRUE, artists), legend)]


def _band(curve: CalibrationCurve, colour: str) -> Polygon:
    """The area between the quartiles."""
    forth = np.column_stack([curve.stated_deg, curve.low_deg])
    back = np.column_stack([curve.stated_deg, curve.high_deg])[::-1]
    return Polygon(np.concatenate([forth, back]), closed=True, facecolor=colour, alpha=0.2, lw=0)
