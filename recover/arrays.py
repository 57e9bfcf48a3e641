"""Recovery of arrays, for programs: colours in, an estimate out; normals in, depth out."""

from dataclasses import replace
from typing import Any

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.configs.threads import one_blas_thread
from huesphere.recover.depth.integration import depth_from_normals
from huesphere.recover.geometry.rays import depth_of, of_relief, rays
from huesphere.recover.io.estimate import Estimate
from huesphere.recover.methods.table import check_methods
from huesphere.recover.run import recover_one, with_depth
from huesphere.render.dataset import CameraInfo, Observation, linear_light
from huesphere.scenes.encoding import ENCODINGS


def recover_normals(
    rgb: Any, mask: Any = None, method: str = "auto", encoding: str | None = None, focal_px: float | None = None
) -> Estimate:
    """Surface normals, lights and depth from one colour picture.

    ``rgb`` (H, W, 3): floats are linear light of any scale unless ``encoding`` says "srgb", for which full scale is 1;
    uint8 and uint16 need an ``encoding``, "srgb" or "linear", because either is common. ``mask`` (H, W): the object,
    everything where it is None; numbers count where they are over half of their largest. ``method``: a name of
    ``METHODS``. ``focal_px``: of a picture in perspective, the focal length in pixels; None: orthographic.

    Returns an Estimate: ``normals`` (H, W, 3) in the camera frame (x right, y up, z toward the camera), ``valid``,
    ``uncertainty_deg``, ``status``, ``depth`` in pixels, ``solution``, ``lights``. A method that fails says so in
    ``status``. Raises InputError for shapes, types and names that cannot be meant.

    >>> import numpy as np
    >>> y, x = (0.98 - 1.96 * np.mgrid[:64, :64] / 63) * np.array([1, -1])[:, None, None]
    >>> sphere = x**2 + y**2 < 0.94
    >>> n = np.dstack([x, y, np.sqrt(np.where(sphere, 1 - x**2 - y**2, 1))])
    >>> toward = np.array([[0.3, 0.0, 1.0], [-0.15, 0.26, 1.0], [-0.15, -0.26, 1.0]])
    >>> colours = np.array([[1.0, 0.2, 0.1], [0.2, 1.0, 0.2], [0.1, 0.2, 1.0]])
    >>> rgb = np.maximum(n @ toward.T, 0) @ colours * sphere[..., None]
    >>> estimate = recover_normals(rgb, sphere, "weak-integrability")
    >>> estimate.status
    'ok'
    >>> cosine = (estimate.normals * n).sum(axis=-1)[estimate.valid]
    >>> bool(np.median(np.degrees(np.arccos(np.clip(cosine, -1, 1)))) < 0.5)
    True
    """
    check_methods([method], where="recover_normals")
    observation = _observation(rgb, mask, encoding, focal_px)
    with one_blas_thread():
        return with_depth(recover_one(observation, method), observation)


def integrate(normals: Any, mask: Any = None, focal_px: float | None = None) -> np.ndarray:
    """Depth (H, W) in pixels toward the camera of ``normals`` (H, W, 3); NaN off the ``mask``.

    ``normals`` are unit vectors in the camera frame, NaN where there is none: such gaps are interpolated. ``mask``
    (H, W): the object; None: where there are normals. ``focal_px``: the focal length in pixels of a picture in
    perspective; None: orthographic. The depth has the mean 0 over each connected part of the mask; in perspective the
    relief −f log(t/f) has, t being the distance from the camera along its axis and f ``focal_px``, and a pixel is
    measured on the object where the depth is 0. Report 2.4. Raises InputError for wrong shapes, and where there is no
    normal.

    >>> import numpy as np
    >>> plane = np.broadcast_to(np.array([-0.6, 0.0, 0.8]), (8, 8, 3))
    >>> depth = integrate(plane)
    >>> bool(np.allclose(np.diff(depth, axis=1), 0.75))
    True
    """
    normals = _image(normals, "normals").astype(np.float64)
    valid = np.isfinite(normals).all(axis=-1)
    inside = valid if mask is None else _mask(mask, valid.shape)
    if not (valid & inside).any():
        raise InputError("normals", got="none that is finite on the object", where="integrate")
    camera = _camera(focal_px, "integrate")
    ray = rays(camera, valid.shape)
    with one_blas_thread():
        relief = depth_from_normals(of_relief(normals, ray), valid & inside, inside)
    return depth_of(relief, None if ray is None else camera.focal_px)


def _observation(rgb: Any, mask: Any, encoding: str | None, focal_px: float | None) -> Observation:
    """The picture as an observation in linear light. Raises InputError."""
    rgb, where = _image(rgb, "rgb"), "recover_normals"
    if encoding is not None and encoding not in ENCODINGS:
        raise InputError("encoding", got=encoding, expected=" or ".join(ENCODINGS), where=where)
    whole = rgb.dtype.kind in "ui"
    if whole and rgb.dtype not in (np.uint8, np.uint16):
        raise InputError("rgb", got=f"samples of {rgb.dtype}", expected="uint8, uint16 or floats", where=where)
    if whole and encoding is None:
        expected = 'encoding="srgb" for pictures to be looked at, encoding="linear" for raw data'
        raise InputError("encoding", got=f"none for samples of {rgb.dtype}", expected=expected, where=where)
    bits = 8 * rgb.dtype.itemsize if whole else None
    values = rgb.astype(np.float64) / (2**bits - 1) if bits else rgb.astype(np.float64)
    inside = np.ones(rgb.shape[:2], bool) if mask is None else _mask(mask, rgb.shape[:2])
    if not inside.any():
        raise InputError("mask", got="no pixel of the object", where=where)
    if not np.isfinite(values[inside]).any():
        raise InputError("rgb", got="no finite value on the object", where=where)
    saturation = 1.0 if bits else None
    camera = CameraInfo(encoding=encoding or "linear", bits=bits, saturation=saturation, known=False)
    if focal_px is not None:
        perspective = _camera(focal_px, where)
        camera = CameraInfo(
            "perspective", perspective.focal_px, saturation, bits=bits, encoding=camera.encoding, known=False
        )
    light = linear_light(Observation(values, inside, camera))  # decoded in double precision
    return replace(light, rgb=np.ascontiguousarray(light.rgb, np.float32))


def _image(values: Any, name: str) -> np.ndarray:
    """``values`` as an array (H, W, 3) of numbers. Raises InputError."""
    array = np.asarray(values)
    if array.ndim != 3 or array.shape[2] != 3 or 0 in array.shape:
        raise InputError(name, got=f"an array of shape {array.shape}", expected="(height, width, 3)")
    if array.dtype.kind not in "uif":
        raise InputError(name, got=f"an array of {array.dtype}", expected="numbers")
    return array


def _mask(values: Any, shape: tuple[int, ...]) -> np.ndarray:
    """``values`` as a mask (H, W): what is True, or over half of the largest. Raises InputError."""
    array = np.asarray(values)
    if array.shape != shape:
        raise InputError("mask", got=f"an array of shape {array.shape}", expected=f"{shape}, as the picture")
    if array.dtype == bool:
        return array
    if array.dtype.kind not in "uif":
        raise InputError("mask", got=f"an array of {array.dtype}", expected="booleans or numbers")
    return np.asarray(array > 0.5 * max(float(np.nanmax(array)), 1e-300))


def _camera(focal_px: float | None, where: str) -> CameraInfo:
    """The camera of that focal length. Raises InputError."""
    if focal_px is None:
        return CameraInfo()
    if isinstance(focal_px, bool) or not isinstance(focal_px, int | float | np.number) or not 0 < focal_px < np.inf:
        raise InputError("focal_px", got=focal_px, expected="a positive number of pixels", where=where)
    return CameraInfo("perspective", float(focal_px))
