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
    axes = {name: {"range": [-1.6, 1.6]} for name in ("xaxis", "yaxis", "zaxis")}
    for kind in ("xaxis", "yaxis", "zaxis"):
        axes[kind]["title"] = {"text": {"xaxis": "red", "yaxis": "green", "zaxis": "blue"}[kind]}
    drawn.update_layout(
        height=480,
        margin={"l": 0, "r": 0, "t": 40, "b": 0},
        scene={name: {"range": [-1.1, 1.1]} for name in ("xaxis", "yaxis", "zaxis")},
        scene2=axes,
        sliders=[{"steps": steps, "active": list(MOVED).index(330), "currentvalue": {"prefix": "blue light at "}}],
    )
    return drawn


def fragment() -> str:
    """The figure as HTML that stands alone but for the plotting library beside it."""
    text: str = figure().to_html(full_html=False, include_plotlyjs="_static/plotly.min.js", div_id="teaching")
    return text + "\n"
