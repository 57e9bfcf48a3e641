"""Tuned numbers of the grid of depths. Read at the place of use, as ``GEOMETRY.least_cell_share``."""

from dataclasses import dataclass

from huesphere.recover.parameters import tuned


@dataclass(frozen=True)
class GeometryParameters:
    """Everything else in ``recover.geometry`` is exact."""

    # depth_grid
    least_cell_share: float = tuned(
        0.6,
        unit="share of a cell",
        meaning="A cell of the grid is used if at least this share of its pixels is inside the region.",
        origin="chosen by hand",
    )


GEOMETRY = GeometryParameters()
