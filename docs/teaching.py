"""How the ellipsoid of colours follows a light: a figure with a slider, for docs/idea.md.

docs/conf.py writes the fragment when the site is built, and beside it ``plotly.min.js`` from the Python package plotly,
which is all that the fragment loads.
"""

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

COLOURS = np.array([[1.0, 0.25, 0.1], [0.2, 1.0, 0.3], [0.1, 0.3, 1.0]])  # of the three lights, a row each
OFF_AXIS = 45.0  # degrees of each light from the view axis
FIXED = (90.0, 210.0)  # degrees about the view axis: the lights that stay
GREY = "#8a8f98"  # of text and lines: seen on a light and on a dark page
MOVED = range(225, 436, 15)  # degrees about the view axis: the light that the slider turns


def normals() -> np.ndarray:
    """Unit normals (N, 3) that face the camera, evenly spread by a Fibonacci spiral."""
    count = np.arange(320) + 0.5
    z, turn = 1 - count / len(count), np.pi * (1 + 5**0.5) * count
    aside = np.sqrt(1 - z**2)
    return np.stack([aside * np.cos(turn), aside * np.sin(turn), z], axis=1)


def matrix(azimuth: float) -> np.ndarray:
    """F = sum of b_k a_k^T, Eq. (6), of the three lights with the moved one at ``azimuth`` degrees."""
    off, turns = np.radians(OFF_AXIS), np.radians([*FIXED, azimuth])
    directions = np.stack([np.sin(off) * np.cos(turns), np.sin(off) * np.sin(turns), np.full(3, np.cos(off))], axis=1)
    return COLOURS.T @ directions


def clouds(azimuth: float) -> list[go.Scatter3d]:
    """Normals on their sphere, and their colours rho = F n on the ellipsoid; each point drawn in its colour."""
    n = normals()
    rho = n @ matrix(azimuth).T
    paint = [f"rgb({r},{g},{b})" for r, g, b in np.round(255 * np.clip(rho / 1.5, 0, 1)).astype(int)]
    return [
        go.Scatter3d(
            x=np.round(points[:, 0], 2).tolist(),
            y=np.round(points[:, 1], 2).tolist(),
            z=np.round(points[:, 2], 2).tolist(),
            mode="markers",
            marker={"size": 3.5, "color": paint},
            showlegend=False,
            scene=scene,
        )
        for points, scene in ((n, "scene"), (rho, "scene2"))
    ]


def figure() -> go.Figure:
    """The two clouds, with a slider for the third light's direction."""
    drawn = make_subplots(
        rows=1,
        cols=2,
        specs=[[{"type": "scene"}, {"type": "scene"}]],
        subplot_titles=("normals n: a sphere", "colours F n: an ellipsoid"),
    )
    drawn.add_traces(clouds(330))
    drawn.frames = [go.Frame(data=clouds(turn), name=str(turn)) for turn in MOVED]
    steps = [
        {"label": f"{turn % 360}°", "method": "animate", "args": [[str(turn)], {"mode": "immediate"}]} for turn in MOVED
    ]
    slider = {"steps": steps, "active": list(MOVED).index(330), "currentvalue": {"prefix": "blue light at "}}
    drawn.update_layout(
        height=520,
        margin={"l": 20, "r": 20, "t": 40, "b": 40},
        paper_bgcolor="rgba(0,0,0,0)",  # the page may be light or dark
        font={"color": GREY},
        scene=space(("x", "y", "z"), 1.1, {"x": 1.5, "y": -1.5, "z": 1.5}),
        scene2=space(("red", "green", "blue"), 1.4, {"x": 1.5, "y": 1.5, "z": 1.5}),
        sliders=[slider | {"pad": {"t": 0, "b": 10}, "x": 0.02, "len": 0.96}],
    )
    return drawn


def space(names: tuple[str, str, str], reach: float, eye: dict[str, float]) -> dict[str, object]:
    """The layout of a scene: its axes from -reach to reach, with their names, seen from ``eye``."""
    look = {"range": [-reach, reach], "showbackground": False, "gridcolor": GREY, "zerolinecolor": GREY, "nticks": 4}
    axes = {f"{axis}axis": look | {"title": {"text": name}} for axis, name in zip("xyz", names, strict=True)}
    return axes | {"camera": {"eye": eye}, "aspectmode": "cube"}


def fragment() -> str:
    """The figure as HTML that stands alone but for the plotting library beside it."""
    text: str = figure().to_html(
        full_html=False, include_plotlyjs="_static/plotly.min.js", div_id="teaching", auto_play=False
    )
    # On a narrow screen the figure is moved to the side rather than cut: both clouds need their width.
    return f'<div style="overflow-x: auto"><div style="min-width: 40rem">\n{text}\n</div></div>\n'
