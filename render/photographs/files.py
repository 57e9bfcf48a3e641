"""Reads single files of a set: tables of numbers, pictures at the full precision of their samples, maps of normals.

Each is refused in one line where it is missing, too large, damaged, or not what its name says.
"""

import re
from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.configs.picture_size import require_size
from huesphere.configs.regular_file import TABLE_BYTES, check_regular, read_bytes, read_text
from huesphere.scenes.encoding import decode_srgb

PNG, TIFF = b"\x89PNG", (b"II*\0", b"MM\0*")
TGA_BYTES = 256 * 2**20


def table(path: Path, columns: int, *, skip: int = 0) -> np.ndarray:
    """The numbers (n, columns) in a text file, without its first ``skip`` lines. Raises InputError."""
    rows = []
    for number, line in enumerate(text(path).splitlines(), start=1):
        words = line.replace(",", " ").split()
        if number <= skip or not words:
            continue
        try:
            row = [float(word) for word in words]
        except ValueError:
            row = []
        if len(row) != columns or not np.isfinite(row).all():
            raise InputError(f"line {number}", got=line[:60], expected=f"{columns} numbers", where=path)
        rows.append(row)
    if not rows:
        raise InputError("a table without numbers", where=path)
    return np.array(rows)


def names(path: Path) -> list[str]:
    """The file names in a text file, one a line, each a name in the same folder. Raises InputError."""
    found = [line.strip() for line in text(path).splitlines() if line.strip()]
    for name in found:
        if Path(name).name != name or name in (".", ".."):
            raise InputError("a name that leads out of the folder", got=name, where=path)
    if not found:
        raise InputError("a list without names", where=path)
    return found


def text(path: Path) -> str:
    try:
        return read_text(path, most=TABLE_BYTES)
    except FileNotFoundError:
        raise InputError("no such file", where=path) from None
    except UnicodeDecodeError:
        raise InputError("not a text file in UTF-8", where=path) from None


def picture(path: Path) -> tuple[np.ndarray, float]:
    """(samples (H, W) or (H, W, C) as they are stored, the value of full scale) of a PNG, TIFF or TGA.

    Raises InputError.
    """
    try:
        require_size(path)
        check_regular(path, most=TGA_BYTES)
        samples = np.asarray(_decoded(path))
    except FileNotFoundError:
        raise InputError("no such photograph", where=path) from None
    except InputError:
        raise
    except Exception as error:  # each library has errors of its own
        raise InputError("not a readable picture", got=f"{type(error).__name__}: {error}"[:90], where=path) from None
    if samples.dtype == bool:
        samples = samples.astype(np.uint8) * 255
    if samples.dtype not in (np.uint8, np.uint16) or samples.ndim not in (2, 3):
        raise InputError("a picture", got=f"{samples.dtype} {samples.shape}", expected="8 or 16 bits", where=path)
    if samples.ndim == 3 and samples.shape[2] in (2, 4):  # alpha
        samples = samples[..., :-1]
    if samples.ndim == 3 and samples.shape[2] == 1:
        samples = samples[..., 0]
    return samples, float(np.iinfo(samples.dtype).max)


def _decoded(path: Path) -> np.ndarray:
    """The samples of a picture; Pillow would reduce 16-bit RGB to 8 bits without a word."""
    import imagecodecs
    from PIL import Image

    with path.open("rb") as file:
        start = file.read(8)
    if start.startswith(PNG):
        return np.asarray(imagecodecs.png_decode(read_bytes(path, most=TGA_BYTES)))
    if start.startswith(TIFF):
        import tifffile

        return np.asarray(tifffile.imread(path))
    with Image.open(path, formats=("TGA", "BMP", "JPEG")) as image:
        if image.width * image.height > 2**26:
            raise ValueError(f"{image.width} × {image.height} pixels")
        return np.asarray(image.convert("RGB") if image.mode not in ("L", "RGB") else image)


def photograph(path: Path, intensity: np.ndarray, encoding: str) -> tuple[np.ndarray, np.ndarray]:
    """(linear RGB (H, W, 3) float32 divided by the light's ``intensity`` (3,), clipped (H, W)) of a photograph.

    Full scale of the file is 1 before the division. A picture of one channel is grey.
    """
    samples, full = picture(path)
    clipped = samples >= full
    values = samples.astype(np.float32) / full
    if encoding == "srgb":
        values = decode_srgb(values)
    if values.ndim == 2:
        values, clipped = np.repeat(values[..., None], 3, axis=2), clipped[..., None]
    if values.shape[2] != 3:
        raise InputError("a photograph", got=f"{values.shape[2]} channels", expected="three, or one", where=path)
    light: np.ndarray = values / intensity.astype(np.float32)
    return light, np.asarray(clipped.any(axis=-1))


def mask(path: Path) -> np.ndarray:
    """(H, W) bool, where the picture ``path`` is at least half as bright as it can be. Raises InputError."""
    samples, full = picture(path)
    bright = samples if samples.ndim == 2 else samples.max(axis=-1)
    inside = np.asarray(bright >= full / 2)
    if not inside.any():
        raise InputError("an empty mask", where=path)
    return inside


def normals_of_mat(path: Path, shape: tuple[int, int]) -> np.ndarray:
    """The map of normals (H, W, 3) in a MATLAB file, whatever its name in there. Raises InputError."""
    import scipy.io

    try:
        check_regular(path, most=512 * 2**20)
        held = scipy.io.loadmat(path)
    except FileNotFoundError:
        raise InputError("no such file", where=path) from None
    except InputError:
        raise
    except Exception as error:  # the library has errors of many classes
        raise InputError(
            "not a readable MATLAB file", got=f"{type(error).__name__}: {error}"[:90], where=path
        ) from None
    maps = [v for k, v in held.items() if not k.startswith("__") and getattr(v, "shape", None) == (*shape, 3)]
    if len(maps) != 1 or maps[0].dtype.kind != "f":
        found = {k: getattr(v, "shape", "?") for k, v in held.items() if not k.startswith("__")}
        raise InputError("normals", got=str(found)[:90], expected=f"one array of shape {(*shape, 3)}", where=path)
    return np.asarray(maps[0], dtype=np.float64)


def normals_of_picture(path: Path) -> np.ndarray:
    """The map of normals (H, W, 3) that a picture encodes as (n + 1) / 2 of full scale."""
    samples, full = picture(path)
    if samples.ndim != 3 or samples.shape[2] != 3:
        raise InputError("a map of normals", got=str(samples.shape), expected="three channels", where=path)
    return 2.0 * samples / full - 1.0


def numbered(folder: Path, pattern: str) -> list[Path]:
    """Files of ``folder`` whose names match, in the order of the one number in the pattern. Raises InputError."""
    found = {}
    for entry in folder.iterdir():
        match = re.fullmatch(pattern, entry.name, re.IGNORECASE)
        if match and entry.is_file():
            found[int(match[1])] = entry
    return [found[number] for number in sorted(found)]
