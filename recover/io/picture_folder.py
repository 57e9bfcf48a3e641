"""The folder of one picture's results, which never holds results of two pictures.

A second method of the same picture is added to those that are there. Results of another picture, or of the same one
read otherwise (another region, mask or encoding), are refused, or removed if they are to be overwritten.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.recover.io.estimate import Estimate, read_estimate
from huesphere.render.dataset import Observation, read_observation, write_observation
from huesphere.render.manifest import sha256_of

OBSERVATION = "observation.exr"
ESTIMATES = "estimates"
IMAGES = ("normals", "depth", "relit")  # of a method: <method>-normals.png …


def folder_name(path: Path, region: tuple[int, int, int, int] | None) -> str:
    """Name of the folder of a picture's results; that of a region has its corners, so that regions stay apart.

    >>> folder_name(Path("vase.png"), None), folder_name(Path("vase.png"), (10, 20, 110, 220))
    ('vase-huesphere', 'vase-10,20,110,220-huesphere')
    """
    corners = "" if region is None else f"-{','.join(map(str, region))}"
    return f"{path.stem}{corners}-huesphere"


def claim_folder(folder: Path, observation: Observation, *, overwrite: bool) -> tuple[Estimate, ...]:
    """Make ``folder`` the folder of this picture; returns the estimates of it that are there already.

    Writes observation.exr if it is not there. Raises InputError if the folder has results of another picture, unless
    ``overwrite``, which removes them.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError("--out", got="a file", expected="a folder", where=folder)
    if (folder / ESTIMATES).is_symlink():
        raise InputError("a link", expected="a folder of estimates", where=folder / ESTIMATES)
    methods = _methods(folder)
    if _is_of(folder / OBSERVATION, observation):
        digest = sha256_of(folder / OBSERVATION)
        found = [_estimate(folder, method) for method in methods]
        return tuple(estimate for estimate, of in found if estimate is not None and of == digest)
    if methods or (folder / OBSERVATION).exists():
        if not overwrite:
            raise InputError(
                "holds results of another picture, or of this one read otherwise",
                expected="another --out, or --overwrite, which removes them",
                where=folder,
            )
        for method in methods:
            remove_images(folder, method)
            for ending in ("exr", "json"):
                (folder / ESTIMATES / f"{method}.{ending}").unlink(missing_ok=True)
    folder.mkdir(parents=True, exist_ok=True)
    write_observation(folder / OBSERVATION, observation)
    return ()


def remove_images(folder: Path, method: str) -> None:
    """Remove the images of a method, which is to be run again and may give fewer of them."""
    for image in IMAGES:
        (folder / f"{method}-{image}.png").unlink(missing_ok=True)


def in_order(made: Sequence[Estimate], there: Sequence[Estimate]) -> list[Estimate]:
    """``made`` and then those that were ``there`` and were not made again."""
    again = {estimate.method for estimate in made}
    return [*made, *(estimate for estimate in there if estimate.method not in again)]


def _methods(folder: Path) -> tuple[str, ...]:
    return tuple(sorted(path.stem for path in (folder / ESTIMATES).glob("[!.]*.json")))


def _estimate(folder: Path, method: str) -> tuple[Estimate | None, str]:
    """(estimate on disk, sha256 of its picture); (None, "") if it is damaged, so that it is made again."""
    try:
        return read_estimate(folder / ESTIMATES, method)
    except InputError:
        return None, ""


def _is_of(path: Path, observation: Observation) -> bool:
    """Whether the picture at ``path`` is this observation, whatever version wrote it."""
    try:
        there = read_observation(path)
    except InputError:
        return False
    if there.camera != observation.camera or (there.lights is None) != (observation.lights is None):
        return False
    pairs = [(there.rgb, observation.rgb), (there.mask, observation.mask)]
    if there.lights is not None and observation.lights is not None:
        pairs += list(zip(there.lights, observation.lights, strict=True))
    return all(a.shape == b.shape and np.array_equal(a, b, equal_nan=a.dtype.kind == "f") for a, b in pairs)
