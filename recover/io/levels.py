"""What stored value is full scale, and at what value samples are clipped, where a file does not say.

Sensors give 10, 12 or 14 bits, which programs write into 16 as they are (no sample over 4095) or moved up (all samples
multiples of 16, none over 65520). Clipped samples then lie far below 65535, and unless their level is known they pass
for colours of the surface.
"""

from dataclasses import dataclass, replace

import numpy as np

SENSOR_BITS = (10, 12, 14)
NEAR_FULL = 0.97  # of full scale: a brightest sample above it shows that the range of so many bits is used
FEWEST_CLIPPED, PILE = 16, 4.0  # samples at the brightest value, and times as many as at values next below it
NEXT_BELOW = 8  # values below the brightest with which their number is compared


@dataclass(frozen=True)
class Levels:
    """Full scale and clip level in stored units."""

    full_scale: float
    clip: float  # samples at or above it are clipped
    bits: int
    of_sensor: bool  # fewer bits than the file has room for, as only samples of sensors are stored
    remark: str | None  # what was found, for the log


def levels(samples: np.ndarray, full_scale: float, bits: int, white_level: float | None) -> Levels:
    """Levels of whole-numbered ``samples`` by their file's ``full_scale`` and ``bits``, or the user's ``white_level``.

    Without the user's word, only samples of 16 bits that a file declares to use all of 65535 are looked at.
    """
    if white_level is not None:
        remark = f"full scale {white_level:g}, as --white-level says"
        used_bits = max(1, int(np.ceil(np.log2(white_level + 1))))
        return Levels(white_level, white_level, used_bits, white_level < full_scale, remark)
    as_told = Levels(full_scale, full_scale, bits, False, None)
    if 8 < bits < 16 or full_scale < 2.0**bits - 1:
        return replace(as_told, of_sensor=True)
    if bits != 16 or samples.dtype != np.uint16 or samples.size == 0:
        return as_told
    used = int(np.bitwise_or.reduce(samples, axis=None))
    if used == 0:
        return as_told
    shift = (used & -used).bit_length() - 1
    top = int(samples.max())
    if 2 <= shift <= 6 and top > NEAR_FULL * 65535 / 2:
        full = 65535 >> shift << shift
        text = f"{16 - shift} bits moved up to 16: full scale {full}"
        return Levels(float(full), float(full), 16 - shift, True, text)
    piled = _piled_up(samples, top)
    for sensor in SENSOR_BITS:
        full = (1 << sensor) - 1
        if top <= full and (top >= NEAR_FULL * full or (piled and top > full // 2)):
            clip = float(top if piled else full)
            text = f"no sample over {top}: {sensor} bits in 16, full scale {full}"
            return Levels(float(full), clip, sensor, True, text + (f", clipped at {top}" if clip < full else ""))
    if piled and top < 65535:
        return Levels(full_scale, float(top), bits, False, f"clipped at {top}, where many samples end")
    return as_told


def _piled_up(samples: np.ndarray, top: int) -> bool:
    """Whether the brightest value is that of many more samples than the values next below it, in two channels or more.

    One channel alone may have its largest value on a flat part of the surface.
    """
    channels = samples.reshape(-1, samples.shape[-1]).T if samples.ndim == 3 else samples.reshape(1, -1)
    piles = 0
    for channel in channels:
        below = channel[channel >= max(0, top - NEXT_BELOW)]
        count = int((below == top).sum())
        piles += count >= FEWEST_CLIPPED and count > PILE * (len(below) - count) / NEXT_BELOW
    return piles >= 2
