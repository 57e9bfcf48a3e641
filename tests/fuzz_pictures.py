"""Picture files for the fuzzer: of every format, with odd words about themselves, and options that users may give."""

from pathlib import Path
from random import Random

import numpy as np
import OpenEXR
import tifffile
from fuzz import flipped, save_array
from picture_files import exr_part, gamma_curve, mosaic, png_with, profile, write_dng
from PIL import Image

from huesphere.recover.io.stored import ReadOptions

SAID_IN_PNG = (b"gAMA", b"cICP", b"sRGB", b"iCCP", b"eXIf", b"cHRM", b"sBIT", b"tRNS", b"acTL")
SAID_IN_TIFF = (254, 259, 262, 274, 281, 284, 301, 320, 338, 34665, 34675, 50717, 33421, 50706)


def picture_file(rng: Random, folder: Path, values: np.ndarray, name: str = "rgb") -> Path:
    """A picture of any format, with odd words about itself now and then, whole or damaged."""
    kinds = [".npy", ".npz", ".png", ".exr", ".tif", ".jpg", ".webp", ".avif", ".heic", ".dng"]
    path = folder / f"{name}{rng.choice(kinds)}"
    small = np.nan_to_num(np.abs(np.real(values)) if values.dtype.kind != "U" else np.zeros(values.shape))
    whole = np.clip(small, 0, 65535).astype(rng.choice([np.uint8, np.uint16]))
    try:
        if path.suffix == ".png" and rng.random() < 0.6:
            said = [(rng.choice(SAID_IN_PNG), rng.randbytes(rng.choice([1, 4, 4, 32, 90]))) for _ in range(2)]
            png_with(path, whole, *said)
        elif path.suffix == ".tif" and rng.random() < 0.6:
            tags = [(rng.choice(SAID_IN_TIFF), "H", 1, rng.choice([0, 1, 2, 3, 5, 6, 8, 99, 32803]), True)]
            tifffile.imwrite(path, whole, photometric=rng.choice(["rgb", "minisblack", "miniswhite"]), extratags=tags)
        elif path.suffix == ".exr" and rng.random() < 0.6:
            names = rng.choice(["RGB", "RGBA", "R", "RGY"])
            names = [rng.choice(["", "x.", "Combined."]) + n if rng.random() < 0.1 else n for n in names]
            images = {n: np.broadcast_to(small, (9, 8)) if small.ndim == 0 else small[..., 0] for n in names}
            corner = np.array([rng.randint(-9, 9), rng.randint(-9, 9)], np.int32)
            size = np.array(next(iter(images.values())).shape[::-1], np.int32)
            window = {"dataWindow": (corner, corner + size - 1), "displayWindow": (corner * 0, corner * 0 + 11)}
            OpenEXR.File([exr_part("a", images, **window), exr_part(rng.choice("bC"), images)]).write(str(path))
        elif path.suffix == ".dng":
            write_dng(path, mosaic(np.clip(small[: len(small) // 2 * 2, : small.shape[1] // 2 * 2], 0, 1)))
        elif path.suffix in (".jpg", ".webp", ".avif", ".heic"):
            exif = Image.Exif()
            exif[0x0112] = rng.choice([0, 1, 2, 6, 8, 9, 65535])
            icc = rng.choice([b"", profile([gamma_curve(1.8)] * 3), rng.randbytes(300)])
            picture = Image.fromarray(whole.astype(np.uint8))
            if path.suffix == ".heic":
                import pillow_heif  # of the extra "photo": without it the file holds no picture

                pillow_heif.from_pillow(picture).save(path, exif=exif.tobytes())
            else:
                picture.save(path, exif=exif, icc_profile=icc)
        else:
            save_array(path, values, name, rng)
    except Exception:  # the format has no place for such an array
        path.write_bytes(rng.randbytes(rng.randint(0, 200)))
    if rng.random() < 0.4:
        path.write_bytes(flipped(rng, path.read_bytes()))
    return path


def picture_options(rng: Random, path: Path) -> ReadOptions:
    """What a user may say of a picture file: mostly nothing."""
    if rng.random() < 0.7:
        return ReadOptions(
            white_level=rng.choice([None, None, 1e-30, 200.0, 1e30]), dark=rng.choice([None, None, path])
        )
    return ReadOptions(
        part=rng.choice([None, None, "0", "7", "C", ""]),
        layer=rng.choice([None, None, "x", "Combined", ""]),
        dark=rng.choice([None, None, path]),
        flat=rng.choice([None, None, path]),
        white_level=rng.choice([None, None, 1e-30, 200.0, 4095.0, 1e30]),
        half_size=rng.random() < 0.2,
        white_balance=rng.choice(["none", "none", "camera"]),
    )
