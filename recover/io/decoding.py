"""Stored samples become linear light of full scale 1, as the user says, else as the file says, else as is usual."""

from dataclasses import dataclass, replace

import numpy as np

from huesphere.recover.io.levels import Levels, levels
from huesphere.recover.io.stored import Stored, Transfer
from huesphere.recover.io.transfer import linear, srgb

OPTION = "--encoding"
UNDER_FULL = 1 - 1e-6  # curves of files end at 1 only within rounding


@dataclass(frozen=True)
class Decoded:
    """Linear light, in the orientation of the stored samples."""

    light: np.ndarray  # (H, W, 3) float64
    clipped: np.ndarray | None  # (H, W) bool, a channel is clipped; None: nothing clips
    saturation: float | None  # light at or above this is clipped; None: nothing clips
    levels: Levels | None  # of whole numbers; None: floating point
    name: str  # of the transfer function: "linear", "sRGB", "gamma 2.2" …
    guessed: bool  # neither the file nor the user says how they were encoded, and either is common
    words: tuple[str, ...]  # how, for the log


def decode(stored: Stored, *, encoding: str, white_level: float | None, like: Levels | None = None) -> Decoded:
    """Linear light of ``stored``.

    ``encoding``: "auto", "srgb" or "linear"; ``white_level``: as the user says; ``like``: levels of another picture of
    the same camera, which hold for this one if it is stored alike.
    """
    found = _levels(stored, white_level, like)
    transfer, words, guessed = _transfer(stored, encoding, found)
    scale = white_level if found is None else found.full_scale
    values = stored.values.astype(np.float64) if scale is None else stored.values / scale
    with np.errstate(invalid="ignore"):
        clipped = None if scale is None or stored.inks else _clipped(stored, found, scale)
        if stored.premultiplied and stored.alpha is not None:
            values = np.where(stored.alpha[..., None] > 0, values / np.maximum(stored.alpha[..., None], 1e-6), values)
        if stored.inks and stored.transfer is None:
            values = (1 - values[..., :3]) * (1 - values[..., 3:])
        light = values if transfer.linear else np.asarray(transfer.decode(values), np.float64)
    return Decoded(
        light=light,
        clipped=clipped,
        saturation=None if clipped is None else _saturation(transfer, found),
        levels=found,
        name=transfer.name,
        guessed=guessed,
        words=words if found is None or found.remark is None else (*words, found.remark),
    )


def _levels(stored: Stored, white_level: float | None, like: Levels | None) -> Levels | None:
    """Levels of whole-numbered samples; those of ``like`` where both are stored alike."""
    if stored.full_scale is None or stored.bits is None:
        return None
    as_told = Levels(stored.full_scale, stored.full_scale, stored.bits, False, None)
    if stored.certain or stored.inks:  # of raw files, the reader has applied the white level
        return as_told
    curved = stored.bits <= 8 or (stored.transfer is not None and not stored.transfer.linear)
    if curved and white_level is None:
        return as_told  # curves end at the full scale of their files
    if curved:
        return replace(
            as_told, clip=float(white_level or 0), remark=f"clipped at {white_level:g}, as --white-level says"
        )
    if like is not None and stored.values.dtype.itemsize == 2:
        return like
    return levels(stored.values, stored.full_scale, stored.bits, white_level)


def _transfer(stored: Stored, encoding: str, found: Levels | None) -> tuple[Transfer, tuple[str, ...], bool]:
    """(the transfer function, words on it, whether it is a guess between two that are both common)."""
    kind = "floating point" if stored.bits is None else f"{stored.bits}-bit"
    usual = {"srgb": srgb(""), "linear": linear("")}
    if stored.inks:
        if stored.transfer is not None:
            return stored.transfer, (f"{kind} inks (CMYK), as {stored.transfer.source} says",), False
        return usual["srgb"], (f"{kind} inks (CMYK) without a colour profile, taken as paper less ink: a guess",), False
    if encoding != "auto":
        return usual[encoding], (f"taken as {encoding}, as {OPTION} says",), False
    if stored.transfer is not None:
        return stored.transfer, (f"{kind}, {stored.transfer.name}, as {stored.transfer.source} says",), False
    if found is None:
        return usual["linear"], ("floating point, taken as linear",), False
    if found.of_sensor:
        text = f"{kind} without a word on its transfer function: GUESSED to be linear, as samples of sensors are"
        return usual["linear"], (f"{text} ({OPTION} linear or srgb says which)",), True
    if stored.ambiguous:
        text = f"{kind} without a word on its transfer function: GUESSED to be sRGB and decoded"
        return usual["srgb"], (f"{text} ({OPTION} linear or srgb says which)",), True
    return usual["srgb"], (f"{kind}, taken as sRGB and decoded",), False


def _clipped(stored: Stored, found: Levels | None, scale: float) -> np.ndarray:
    """Pixels with a channel at its clip level."""
    values = stored.values
    return np.asarray((values >= (scale if found is None else found.clip)).any(axis=-1))


def _saturation(transfer: Transfer, found: Levels | None) -> float:
    """Linear light at and above which samples are clipped."""
    if found is not None and found.clip < found.full_scale:
        at = (found.clip - 0.5) / found.full_scale
        return float(np.min(transfer.decode(np.full((1, 1, 3), at))))
    if transfer.name in ("linear", "sRGB"):
        return 1.0
    return float(np.min(transfer.decode(np.ones((1, 1, 3))))) * UNDER_FULL
