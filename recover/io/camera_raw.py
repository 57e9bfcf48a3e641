"""Cameras' own files (DNG, CR2, CR3, NEF, ARW, RAF …): linear light of the sensor's own colours, by LibRaw.

No white balance, no colour matrix, no tone curve, no brightening: after the black level is subtracted, samples are
proportional to light, and the white level is full scale. The mosaic is interpolated by LibRaw, or with ``half_size``
each of its cells becomes one pixel.
"""

from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.configs.quiet import silence
from huesphere.recover.io.axes import check_size
from huesphere.recover.io.stored import ReadOptions, Stored
from huesphere.recover.io.transfer import linear

SUFFIXES = (
    *(".dng", ".cr2", ".cr3", ".nef", ".nrw", ".arw", ".raf", ".orf", ".rw2", ".pef", ".srw", ".3fr", ".iiq", ".erf"),
)
ORIENTATION = {0: 1, 3: 3, 5: 8, 6: 6}  # of LibRaw's flip, as Exif numbers them
INSTALL = "pip install 'huesphere[photo]'"


def read_camera_raw(path: Path, options: ReadOptions) -> Stored:
    """The picture in a camera's own file. Raises InputError if rawpy is missing, or for a file that LibRaw refuses."""
    try:
        import rawpy
    except ImportError:
        expected = f"the package rawpy, which reads it: {INSTALL}"
        raise InputError("a camera's own file", got=path.suffix, expected=expected, where=path) from None
    try:
        with silence(), rawpy.imread(str(path)) as raw:
            check_size(6 * raw.sizes.iwidth * raw.sizes.iheight, path)
            if raw.num_colors != 3:
                got = f"{raw.num_colors} colours"
                raise InputError("a sensor of other than three colours", got=got, expected="3", where=path)
            black = float(np.mean(raw.black_level_per_channel))
            white = float(options.white_level or raw.white_level)
            if not white > black:
                raise InputError("a white level below the black level", got=f"{white:g} and {black:g}", where=path)
            orientation = ORIENTATION.get(int(raw.sizes.flip), 1)  # before it is overruled below
            balance = options.white_balance == "camera"
            values = raw.postprocess(
                gamma=(1, 1),
                no_auto_bright=True,
                adjust_maximum_thr=0.0,  # LibRaw would else lower the white level to the brightest sample
                output_bps=16,
                output_color=rawpy.ColorSpace.raw,
                use_camera_wb=balance,
                user_wb=None if balance else [1.0, 1.0, 1.0, 1.0],
                user_sat=None if options.white_level is None else max(1, round(white - black)),
                half_size=options.half_size,
                user_flip=0,  # turned upright after dark and flat frames, which are as the sensor lies
            )
    except rawpy.LibRawError as error:
        text = error.args[0] if error.args else type(error).__name__
        text = text.decode(errors="replace") if isinstance(text, bytes) else str(text)
        raise InputError("not a readable raw file", got=text[:80], where=path) from None
    remarks = (
        f"black level {black:g} subtracted, white level {white:g}",
        "white balance of the camera" if balance else "no white balance",
        "one pixel for each cell of the mosaic" if options.half_size else "mosaic interpolated",
    )
    return Stored(
        values,
        65535.0,
        max(1, int(np.ceil(np.log2(white - black)))),
        orientation=orientation,
        transfer=linear("its kind of file"),
        certain=True,
        remarks=remarks,
    )
