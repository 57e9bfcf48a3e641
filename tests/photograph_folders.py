"""Writes folders of photographs in the layouts of published sets, from pictures under single lights."""

from pathlib import Path

import imagecodecs
import numpy as np
from PIL import Image


def write_luces(folder: Path, pictures: np.ndarray, toward: np.ndarray, mask: np.ndarray, normals: np.ndarray) -> Path:
    """A LUCES folder: lights at 1 m along ``toward`` from an object at 300 mm; x right, y down, z away."""
    folder.mkdir()
    height, width = mask.shape
    positions = (toward * 1000.0) * [1, -1, -1] + [0, 0, 300.0]
    lines = ["N_img nrows ncols f x0 y0 mean_distance sfull:[Lpos Ldir Phi mu 0]"]
    lines.append(f"{len(pictures)} {height} {width} 200.0 {width / 2} {height / 2} 300.0")
    lines += [" ".join(f"{v:.6f}" for v in (*p, 0, 0, 1, 0.5, 0.5, 0.5, 0, 0)) for p in positions]
    (folder / "led_params.txt").write_text("\n".join(lines) + "\n")
    for number, picture in enumerate(pictures):
        _png16(folder / f"{number + 1:02d}.png", 0.5 * picture)
    _png16(folder / "normals.png", np.where(mask[..., None], (np.nan_to_num(normals) + 1) / 2, 0))
    Image.fromarray(np.where(mask, 255, 0).astype(np.uint8)).save(folder / "mask.png")
    return folder


def write_psm_images(folder: Path, name: str, pictures: np.ndarray, toward: np.ndarray, mask: np.ndarray) -> Path:
    """A psmImages folder: 8-bit TGA files."""
    folder.mkdir()
    for number, picture in enumerate(pictures):
        Image.fromarray(np.rint(255 * picture).astype(np.uint8)).save(folder / f"{name}.{number}.tga")
    Image.fromarray(np.repeat(np.where(mask, 255, 0).astype(np.uint8)[..., None], 3, axis=2)).save(
        folder / f"{name}.mask.tga"
    )
    lines = [str(len(toward)), *(" ".join(f"{v:.9f}" for v in direction) for direction in toward)]
    (folder / "lights.txt").write_text("\n".join(lines) + "\n")
    return folder


def write_stack(path: Path, pictures: np.ndarray, toward: np.ndarray, mask: np.ndarray, normals: np.ndarray) -> Path:
    """An npz of 16-bit samples."""
    samples = np.rint(pictures * 65535).astype(np.uint16)
    np.savez(path, pictures=samples, scale=1 / 65535, light_directions=toward, mask=mask, normals=normals)
    return path


def _png16(path: Path, image: np.ndarray) -> None:
    path.write_bytes(imagecodecs.png_encode(np.rint(np.clip(image, 0, 1) * 65535).astype(np.uint16)))
