"""What `render --list` prints: the packaged configs and what each shows, and the names that a config may use."""

import textwrap
from collections.abc import Iterable

from huesphere.configs.errors import InputError

WIDTH = 80  # characters
KINDS = ("configs", "spectra", "cameras", "reflectances", "methods")


def listed(kind: str) -> list[str]:
    """The lines for one of KINDS. Raises InputError for `methods`, which are recovery's and not known here."""
    if kind == "configs":
        return _configs()
    if kind == "spectra":
        from huesphere.scenes.spectra import illuminant_names

        also = "also: a number, {gaussian: {centre: 610, sigma: 25}}, {blackbody: 3000}, {daylight: 6500}, {csv: PATH}"
        return _names("lights.N.spectrum", illuminant_names(), also)
    if kind == "cameras":
        from huesphere.scenes.cameras import NAMES

        return _names("camera.sensitivity", NAMES, "also: {csv: PATH} with columns wavelength, R, G, B")
    if kind == "reflectances":
        from huesphere.scenes.spectra import patch_names

        return _names("surface.reflectance", patch_names(), "also: a number from 0 to 1, {gaussian: …}, {csv: PATH}")
    raise InputError("methods belong to recover", got=kind, expected="recover --list", where="--list")


def _configs() -> list[str]:
    from huesphere.configs.load import PACKAGED, packaged_names

    names = packaged_names()
    column = max(map(len, names)) + 2
    lines = []
    for name in names:
        first = (PACKAGED / name).read_text(encoding="utf-8").splitlines()[0].lstrip("# ")
        lines += textwrap.wrap(f"{name:{column}}{first}", WIDTH, subsequent_indent=" " * column)
    return lines


def _names(key: str, names: Iterable[str], also: str) -> list[str]:
    text = ", ".join(names)
    wrapped = textwrap.wrap(f"{key}: {text}", WIDTH, subsequent_indent="  ", break_on_hyphens=False)
    return wrapped + textwrap.wrap(also, WIDTH, subsequent_indent="  ", break_on_hyphens=False)
