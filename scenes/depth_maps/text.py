"""Depth as text: one row of numbers a line, ESRI ASCII grids, and lists of x y z on a regular grid.

Numbers are separated by blanks, tabs, commas or semicolons; decimals are written with a point or, where a comma does
not separate the numbers, with a comma. A file that could be read in two ways is refused.
"""

import re
from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.scenes.depth_maps.points import LEAST_POINTS, grid_of_points
from huesphere.scenes.depth_maps.stored import StoredDepth

ESRI_KEYS = ("ncols", "nrows", "xllcorner", "yllcorner", "xllcenter", "yllcenter", "cellsize", "dx", "dy")
ESRI_NO_DATA = -9999.0  # of grids whose header does not name a value
LONGEST_SIDE = 1 << 15  # samples; more are refused before memory is reserved for them

_BLANKS_BETWEEN = re.compile(r"[\w.][ \t]+[-+.\w]")  # two numbers that only blanks separate
_COMMA_INSIDE = re.compile(r"\d,\d")
_TWO_COMMAS = re.compile(r"[^\s;]*,[^\s;]*,[^\s;]*")
_EMPTY_CELL = re.compile(r"(^|[,;])[ \t]*([,;]|$)", re.MULTILINE)


def read_text(path: Path) -> StoredDepth:
    """The depth map in a text file. Raises InputError for text that is no grid, or ValueError for what is no number."""
    lines = [line.split("#")[0].strip() for line in path.read_text(encoding="utf-8-sig").splitlines()]
    lines = [line for line in lines if line]
    if not lines:
        raise ValueError("an empty file")
    if lines[0].split()[0].lower() in ESRI_KEYS:
        return _read_esri(lines, path)
    said: tuple[str, ...] = ()
    if re.search("[a-z]", lines[0], re.IGNORECASE) and not re.search(r"\d|nan|inf", lines[0], re.IGNORECASE):
        said, lines = (f"the first line is taken as a heading: {lines[0][:40]}",), lines[1:]
    if not lines:
        raise ValueError("no numbers")
    table, remark = _numbers(lines, path)
    said += remark
    if table.shape[1] == 3 and len(table) >= LEAST_POINTS:
        return grid_of_points(table, path, said)
    return StoredDepth(table, said=said)


def _numbers(lines: list[str], path: Path) -> tuple[np.ndarray, tuple[str, ...]]:
    """(numbers (rows, columns), remarks for the log) of lines with one row each."""
    text = "\n".join(lines)
    blanks, commas = bool(_BLANKS_BETWEEN.search(text)), "," in text
    decimal_comma = commas and (blanks or ";" in text)
    if decimal_comma:
        if "." in text or _TWO_COMMAS.search(text) or (blanks and not _COMMA_INSIDE.search(text)):
            raise InputError(
                "numbers separated in two ways",
                got=f"commas and {'semicolons' if ';' in text else 'blanks'} in {lines[0][:40]!r}",
                expected="one separator, and decimals with a point or a comma throughout",
                where=path,
            )
        text = text.replace(",", ".")
    separator = ";" if ";" in text else "," if commas and not decimal_comma else None
    if separator is not None:
        unended = re.sub(rf"{separator}[ \t]*$", "", text, flags=re.MULTILINE)
        if all(line.endswith(separator) for line in lines) and not _EMPTY_CELL.search(unended):
            text = unended  # each line ends with a separator after which no cell is meant
        if _EMPTY_CELL.search(text):  # a gap
            cells = [[cell.strip() or "nan" for cell in line.split(separator)] for line in text.splitlines()]
            text = "\n".join(separator.join(row) for row in cells)
    remarks = ("commas are taken as decimal commas",) if decimal_comma else ()
    return np.loadtxt(text.splitlines(), delimiter=separator, ndmin=2), remarks


def _read_esri(lines: list[str], path: Path) -> StoredDepth:
    """An ESRI ASCII grid: a header of keys and values, then the rows from north to south."""
    header: dict[str, float] = {}
    at = 0
    while at < len(lines) and lines[at][0].isalpha() and lines[at].split()[0].lower() != "nan":
        key, *values = lines[at].replace(",", ".").split()
        if len(values) != 1:
            raise InputError("a line of the header of an ESRI ASCII grid", got=lines[at][:60], where=path)
        header[key.lower()] = float(values[0])
        at += 1
    sizes = [header.get(key, 0.0) for key in ("nrows", "ncols")]
    if not all(size == int(size) and 0 < size <= LONGEST_SIDE for size in sizes):
        raise InputError(
            "nrows and ncols of an ESRI ASCII grid",
            got=f"{sizes[0]:g} and {sizes[1]:g}",
            expected=f"whole numbers from 1 to {LONGEST_SIDE}",
            where=path,
        )
    rows, cols = (int(size) for size in sizes)
    samples = np.array(" ".join(lines[at:]).replace(",", ".").split(), dtype=float)
    if len(samples) != rows * cols:
        raise InputError(
            "an ESRI ASCII grid",
            got=f"{len(samples)} samples",
            expected=f"{rows} x {cols} as in its header",
            where=path,
        )
    dx, dy = (header.get(key, header.get("cellsize", 1.0)) for key in ("dx", "dy"))
    if not (0 < dx < np.inf and abs(dx - dy) <= 1e-3 * dx):
        raise InputError("cells that are not square", got=f"{dx:g} by {dy:g}", expected="one positive size", where=path)
    no_data = (header.get("nodata_value", header.get("nodata", ESRI_NO_DATA)),)
    return StoredDepth(samples.reshape(rows, cols), no_data=no_data, spacing=dx, said=("an ESRI ASCII grid",))
