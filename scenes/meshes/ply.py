"""PLY, in text and binary: vertices, polygons of any number of corners, and triangle strips.

Texture coordinates are those of vertices (s, t; u, v; texture_u, texture_v) or of the corners of faces (texcoord);
colours of vertices (red, green, blue) are encoded as sRGB.

A file is a header that names elements with their properties, and then the values of one element after the other. A
property is a number or a list, which begins with its length.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.scenes.encoding import decode_srgb
from huesphere.scenes.meshes.polygons import Polygons

TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4"}
TYPES |= {"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4"}
TYPES |= {"double": "f8", "float64": "f8"}
FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
UV_NAMES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"), ("texture_s", "texture_t"))
FACE_LISTS = ("vertex_indices", "vertex_index")
LONGEST_HEADER = 1 << 16  # bytes


@dataclass(frozen=True)
class _Property:
    name: str
    type: np.dtype  # of the number, or of those in the list
    length: np.dtype | None  # type of the list's length; None: a single number


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: list[_Property]


def read_ply(path: Path) -> Polygons:
    """The polygons of a PLY file. Raises InputError if it is damaged, or has no vertices with x, y and z."""
    data = path.read_bytes()
    try:
        elements, order, body = _header(data)
        values = _Text(data[body:]) if order == "" else _Binary(data, body)
        numbers: dict[str, np.ndarray] = {}
        lists: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        for element in elements:
            found = _read_element(element, values)
            for name, column in found.items():
                if isinstance(column, tuple):
                    lists[f"{element.name}.{name}"] = column
                else:
                    numbers[f"{element.name}.{name}"] = column
        vertices = np.stack([numbers[f"vertex.{axis}"] for axis in "xyz"], axis=1).astype(float)
    except (ValueError, IndexError, KeyError, UnicodeDecodeError, OverflowError) as error:
        raise InputError("not a readable mesh", got=f"{type(error).__name__}: {str(error)[:80]}", where=path) from None
    faces = next((lists[f"face.{name}"] for name in FACE_LISTS if f"face.{name}" in lists), None)
    strips = next((lists[f"tristrips.{name}"] for name in FACE_LISTS if f"tristrips.{name}" in lists), None)
    corners, counts = faces if faces is not None else (np.zeros(0, np.int64), np.zeros(0, np.int64))
    # Texture coordinates are read for the corners of faces: those of a file with triangle strips are dropped.
    uv = _uv(numbers, lists, corners, counts) if strips is None else None
    if strips is not None:
        triangles = strip_triangles(*strips)
        corners = np.concatenate([corners, triangles.ravel()])
        counts = np.concatenate([counts, np.full(len(triangles), 3)])
    return Polygons(vertices, corners.astype(np.int64), counts.astype(np.int64), uv, _colour(numbers))


def _uv(
    numbers: dict[str, np.ndarray],
    lists: dict[str, tuple[np.ndarray, np.ndarray]],
    corners: np.ndarray,
    counts: np.ndarray,
) -> np.ndarray | None:
    """Texture coordinates (N, 2) of the corners of all faces, None if the file has none."""
    if "face.texcoord" in lists:
        values, lengths = lists["face.texcoord"]
        return values.reshape(-1, 2).astype(float) if np.array_equal(lengths, 2 * counts) else None
    for pair in UV_NAMES:
        columns = [numbers.get(f"vertex.{name}") for name in pair]
        if all(column is not None for column in columns):
            at_vertices = np.stack([np.asarray(column, float) for column in columns], axis=1)
            at = corners.astype(np.int64)
            return at_vertices[at] if len(at) and at.min() >= 0 and at.max() < len(at_vertices) else None
    return None


def _colour(numbers: dict[str, np.ndarray]) -> np.ndarray | None:
    """Linear colours (V, 3) of the vertices, None if the file has none. Whole numbers have full scale 255 or 65535."""
    columns = [numbers.get(f"vertex.{name}") for name in ("red", "green", "blue")]
    if any(column is None for column in columns):
        return None
    values = np.stack([np.asarray(column, float) for column in columns], axis=1)
    kind = np.asarray(columns[0]).dtype
    full = np.iinfo(kind).max if kind.kind in "iu" else 255 if values.size and values.max() > 1 else 1
    return decode_srgb(values / full)


def strip_triangles(strip: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Triangles (T, 3) of strips, joined in ``strip``, each of ``counts`` vertices; −1 in a strip begins a new one.

    Each vertex from the third on makes a triangle with the two before it, every other one in reverse order.
    """
    breaks = np.concatenate([np.cumsum(counts), np.flatnonzero(strip < 0)])
    run = np.zeros(len(strip) + 1, dtype=np.int64)
    np.add.at(run, breaks, 1)
    run = np.cumsum(run)[:-1]  # number of the strip to which each vertex belongs
    if len(strip) < 3:
        return np.zeros((0, 3), np.int64)
    valid = strip >= 0
    first = np.zeros(len(strip), dtype=np.int64)  # position of the strip's first vertex
    begins = np.flatnonzero(valid & np.concatenate([[True], (run[1:] != run[:-1]) | ~valid[:-1]]))
    first[begins] = begins
    first = np.maximum.accumulate(first)
    at = np.arange(len(strip) - 2)
    whole = valid[:-2] & valid[1:-1] & valid[2:] & (run[:-2] == run[2:]) & (first[:-2] == first[2:])
    odd = (at - first[:-2]) % 2 == 1
    triangles = np.stack([strip[:-2], strip[1:-1], strip[2:]], axis=1).astype(np.int64)
    triangles[odd] = triangles[odd][:, [1, 0, 2]]
    return triangles[whole]


# ---- header and values ---------------------------------------------------------------------------------------------


def _header(data: bytes) -> tuple[list[_Element], str, int]:
    """(elements, byte order or "" for text, where the values begin). Raises ValueError or KeyError."""
    end = data.find(b"end_header", 0, LONGEST_HEADER)
    if not data.startswith(b"ply") or end < 0:
        raise ValueError("no header of a PLY file")
    newline = data.find(b"\n", end)
    body = len(data) if newline < 0 else newline + 1
    order, elements = None, []
    for line in data[:end].decode("ascii", errors="replace").splitlines()[1:]:
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words[0] == "format":
            order = FORMATS[words[1]]
        elif words[0] == "element":
            elements.append(_Element(words[1], int(words[2]), []))
            if elements[-1].count < 0:
                raise ValueError("a negative number of elements")
        elif words[0] == "property" and words[1] == "list":
            elements[-1].properties.append(_Property(words[4], _type(words[3], order), _type(words[2], order)))
        elif words[0] == "property":
            elements[-1].properties.append(_Property(words[2], _type(words[1], order), None))
        else:
            raise ValueError(f"an unknown line of the header: {line[:40]}")
    if order is None:
        raise ValueError("a header without a format")
    return elements, order, body


def _type(name: str, order: str | None) -> np.dtype:
    return np.dtype((order or "<") + TYPES[name])


class _Text:
    """The values of a PLY file in text, from the first on."""

    def __init__(self, body: bytes) -> None:
        self.values = np.array(body.split(), dtype=float)
        self.at = 0

    def holds(self, row: np.dtype, rows: int) -> bool:
        """Whether there are as many values left as ``table`` would read."""
        return self.at + rows * _width(row) <= len(self.values)

    def numbers(self, kind: np.dtype, count: int) -> np.ndarray:
        """The next ``count`` numbers, as floats: in text the type ``kind`` of the header does not matter."""
        if self.at + count > len(self.values):
            raise ValueError("fewer values than its header says")
        self.at += count
        return self.values[self.at - count : self.at]

    def table(self, row: np.dtype, rows: int) -> np.ndarray:
        """The next ``rows`` rows of a structured type ``row``, whose fields are numbers or subarrays of numbers."""
        if not self.holds(row, rows):
            raise ValueError("fewer values than its header says")
        width = _width(row)
        block = self.values[self.at : self.at + rows * width].reshape(rows, width)
        self.at += rows * width
        out, column = np.zeros(rows, dtype=row), 0
        for name in row.names or ():
            size = int(np.prod(row[name].shape))
            with np.errstate(invalid="ignore"):  # a NaN where a whole number is expected
                out[name] = block[:, column : column + size].reshape(rows, *row[name].shape)
            column += size
        return out


def _width(row: np.dtype) -> int:
    """Number of single numbers in a structured type."""
    return sum(int(np.prod(row[name].shape)) for name in row.names or ())


class _Binary:
    """The values of a binary PLY file, from the byte ``at`` on."""

    def __init__(self, data: bytes, at: int) -> None:
        self.data, self.at = data, at

    def holds(self, row: np.dtype, rows: int) -> bool:
        """As ``_Text.holds``."""
        return self.at + rows * row.itemsize <= len(self.data)

    def numbers(self, kind: np.dtype, count: int) -> np.ndarray:
        """As ``_Text.numbers``."""
        if self.at + count * kind.itemsize > len(self.data):
            raise ValueError("fewer bytes than its header says")
        self.at += count * kind.itemsize
        return np.frombuffer(self.data, dtype=kind, count=count, offset=self.at - count * kind.itemsize)

    def table(self, row: np.dtype, rows: int) -> np.ndarray:
        """As ``_Text.table``."""
        if not self.holds(row, rows):
            raise ValueError("fewer bytes than its header says")
        out = np.frombuffer(self.data, dtype=row, count=rows, offset=self.at)
        self.at += rows * row.itemsize
        return out


Column = np.ndarray | tuple[np.ndarray, np.ndarray]  # numbers; or lists, as (their values joined, their lengths)


def _read_element(element: _Element, values: _Text | _Binary) -> dict[str, Column]:
    """Columns of an element by property: numbers (count,), or of a list its (values of all rows, their lengths)."""
    if element.count == 0:
        return {}
    lists = [p for p in element.properties if p.length is not None]
    if not lists:
        table = values.table(_row(element.properties, {}), element.count)
        return {p.name: table[p.name] for p in element.properties}
    start = values.at
    first = _one_row(element.properties, values)
    values.at = start
    # Mostly all lists are as long as those of the first row: then the element is one table.
    lengths = {p.name: len(first[p.name]) for p in lists}
    row = _row(element.properties, lengths)
    if values.holds(row, element.count):
        table = values.table(row, element.count)
        if all((table[f"{name} length"] == length).all() for name, length in lengths.items()):
            columns: dict[str, Column] = {p.name: table[p.name] for p in element.properties if p.length is None}
            return columns | {n: (table[n].reshape(-1), np.full(element.count, k)) for n, k in lengths.items()}
    values.at = start
    rows = [_one_row(element.properties, values) for _ in range(element.count)]
    joined = {p.name: np.concatenate([row[p.name] for row in rows]) for p in element.properties}
    sizes = {p.name: np.array([len(row[p.name]) for row in rows]) for p in lists}
    return {name: (column, sizes[name]) if name in sizes else column for name, column in joined.items()}


def _row(properties: list[_Property], lengths: dict[str, int]) -> np.dtype:
    """The type of one row whose lists have these ``lengths``."""
    fields: list[tuple] = []
    for p in properties:
        if p.length is None:
            fields.append((p.name, p.type))
        else:
            fields += [(f"{p.name} length", p.length), (p.name, p.type, (lengths[p.name],))]
    return np.dtype(fields)


def _one_row(properties: list[_Property], values: _Text | _Binary) -> dict[str, np.ndarray]:
    """The next row of an element, by property; a single number is an array of one."""
    row = {}
    for p in properties:
        length = 1 if p.length is None else int(values.numbers(p.length, 1)[0])
        if length < 0:
            raise ValueError("a list of negative length")
        row[p.name] = values.numbers(p.type, length)
    return row
