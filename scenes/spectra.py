"""Spectra on one wavelength grid: emitters E(λ) and reflectances S(λ), by name, formula or file.

The step of the grid is 1 nm, at which products of tables with steps of 5 or 10 nm, linear in between, are integrated
accurately. The integral of the report's Eq. (3) is a sum over this grid times 1 nm.
"""

import functools
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from huesphere.configs.errors import InputError
from huesphere.configs.regular_file import TABLE_BYTES, read_text
from huesphere.configs.spectra import BlackbodySpectrum, CsvSpectrum, DaylightSpectrum, GaussianSpectrum, SpectrumSpec
from huesphere.configs.suggest import closest
from huesphere.scenes.colour_tables import colour_science

WAVELENGTHS = np.arange(380.0, 781.0)  # nm
STEP = 1.0  # nm
VISIBLE = (WAVELENGTHS >= 400.0) & (WAVELENGTHS <= 700.0)  # the band in which an emitter has mean 1

SECOND_RADIATION_CONSTANT = 1.438776877e7  # nm K, CODATA 2018

# Colour checkers searched for a patch name, in this order: measured at 5 nm first.
CHECKERS = ("ISO 17321-1", "ColorChecker N Ohta", "BabelColor Average")


def emission(spec: SpectrumSpec, *, where: str = "spectrum") -> np.ndarray:
    """Relative power of an emitter on WAVELENGTHS, shape (W,), mean 1 over 400–700 nm.

    Raises InputError for an unknown name, a bad file, or an emitter that is dark over the whole visible band.
    """
    if isinstance(spec, str):
        values = _named(spec, _illuminants(), "illuminant", where)
    else:
        values = _formula(spec, where)
    if values.min() < 0:
        raise InputError(f"{where}: negative power", got=f"{values.min():.3g}", expected="values of 0 or more")
    mean = values[VISIBLE].mean()
    if not mean > 0:
        raise InputError(f"{where}: no power between 400 and 700 nm", expected="an emitter that can be seen")
    return values / mean


def reflectance(spec: SpectrumSpec, *, where: str = "reflectance") -> np.ndarray:
    """Spectral reflectance on WAVELENGTHS, shape (W,), each value in [0, 1]; raises InputError outside it."""
    if isinstance(spec, str):
        values = _named(spec, _patches(), "reflectance", where)
    elif isinstance(spec, BlackbodySpectrum | DaylightSpectrum):
        raise InputError(
            f"{where}: a surface has no colour temperature", expected="a patch name, number, gaussian or csv"
        )
    else:
        values = _formula(spec, where)
    if values.min() < 0 or values.max() > 1:
        raise InputError(
            f"{where}: a reflectance", got=f"{values.min():.4g} to {values.max():.4g}", expected="values from 0 to 1"
        )
    return values


def _formula(
    spec: float | GaussianSpectrum | BlackbodySpectrum | DaylightSpectrum | CsvSpectrum, where: str
) -> np.ndarray:
    """The spectrum (W,) of a constant, formula or file, not scaled."""
    if isinstance(spec, GaussianSpectrum):
        band = spec.gaussian
        return band.peak * np.exp(-0.5 * ((WAVELENGTHS - band.centre) / band.sigma) ** 2)
    if isinstance(spec, BlackbodySpectrum):
        # Planck's law, relative: the first radiation constant cancels in the scaling to mean 1.
        return (WAVELENGTHS / 560.0) ** -5 / np.expm1(SECOND_RADIATION_CONSTANT / (WAVELENGTHS * spec.blackbody))
    if isinstance(spec, DaylightSpectrum):
        return _daylight(spec.daylight)
    if isinstance(spec, CsvSpectrum):
        return read_csv(Path(spec.csv), columns=1, where=where)[:, 0]
    return np.full(WAVELENGTHS.shape, float(spec))


def _daylight(temperature: float) -> np.ndarray:
    colour = colour_science()

    xy = colour.temperature.CCT_to_xy_CIE_D(temperature)
    return on_grid(colour.sd_CIE_illuminant_D_series(xy))


def on_grid(distribution) -> np.ndarray:  # a colour.SpectralDistribution or MultiSpectralDistributions
    """A colour-science table on WAVELENGTHS: linear between its points, its end values beyond them."""
    values = np.asarray(distribution.values, dtype=float)
    columns = values.reshape(len(values), -1).T
    resampled = np.stack([np.interp(WAVELENGTHS, distribution.wavelengths, c) for c in columns], axis=-1)
    return resampled[:, 0] if values.ndim == 1 else resampled


def _named(name: str, tables: dict, what: str, where: str) -> np.ndarray:
    return on_grid(tables[known_name(name, tables, what, where)])


def known_name(name: str, known: Iterable[str], what: str, where: str) -> str:
    """The one of the ``known`` names that equals ``name`` except for case.

    Raises InputError, with the most similar name, if there is none. ``what`` is the kind of name.
    """
    by_lower = {key.lower(): key for key in known}
    key = by_lower.get(name.strip().lower())
    if key is None:
        near = closest(name, by_lower.values(), cutoff=0.4)
        hint = f"did you mean {near!r}?" if near else f"known are {', '.join(sorted(by_lower.values()))}"
        raise InputError(f"{where}: unknown {what} {name!r}; {hint}")
    return key


def illuminant_names() -> list[str]:
    """Names of the emission spectra, as a config may write them."""
    return list(_illuminants())


def patch_names() -> list[str]:
    """Names of the reflectances, as a config may write them."""
    return list(_patches())


@functools.cache
def _illuminants() -> dict:
    colour = colour_science()

    return dict(colour.SDS_ILLUMINANTS.items())


@functools.cache
def _patches() -> dict:
    colour = colour_science()

    patches: dict = {}
    for checker in CHECKERS:
        for name, distribution in colour.SDS_COLOURCHECKERS[checker].items():
            patches.setdefault(name, distribution)
    return patches


def read_csv(path: Path, *, columns: int, where: str) -> np.ndarray:
    """A spectral table from a text file, on WAVELENGTHS, shape (W, columns).

    Header and comment lines are skipped, and quotes around cells. Linear between the given wavelengths, and the end
    values beyond them, as CIE 15 recommends and as the named tables are carried on. Raises InputError if it cannot be
    read as numbers.
    """
    table = _read_table(path, columns, where)
    return np.stack([np.interp(WAVELENGTHS, table[:, 0], c) for c in table[:, 1:].T], axis=-1)


def table_ends(config: BaseModel) -> list[str]:
    """A line for each spectral table of ``config`` whose end values are carried on, unless they are 0."""
    lines = {}
    for spec, where in _tables(config, ""):
        columns = 3 if where == "camera.sensitivity" else 1
        table = _read_table(Path(spec.csv), columns, where)
        low, high = WAVELENGTHS[0], WAVELENGTHS[-1]
        beyond = []
        if table[0, 0] > low and table[0, 1:].any():
            beyond.append(f"below {table[0, 0]:g} nm ({', '.join(f'{v:.4g}' for v in table[0, 1:])})")
        if table[-1, 0] < high and table[-1, 1:].any():
            beyond.append(f"above {table[-1, 0]:g} nm ({', '.join(f'{v:.4g}' for v in table[-1, 1:])})")
        if beyond:
            lines[spec.csv] = f"table {spec.csv}: its end values are carried on {' and '.join(beyond)}"
    return list(lines.values())


def _tables(node: Any, place: str) -> Iterator[tuple[CsvSpectrum, str]]:
    """Each spectral table that a config names, with the dotted key under which it does."""
    if isinstance(node, CsvSpectrum):
        yield node, place
    elif isinstance(node, BaseModel):
        for name in type(node).model_fields:
            yield from _tables(getattr(node, name), f"{place}.{name}".lstrip("."))
    elif isinstance(node, tuple):
        for number, one in enumerate(node):
            yield from _tables(one, f"{place}.{number}")


def _read_table(path: Path, columns: int, where: str) -> np.ndarray:
    """The rows (n, 1 + columns) of a table: wavelengths in nm, then values. Raises InputError."""
    try:
        text = read_text(path, most=TABLE_BYTES, encoding="utf-8-sig")
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{where}: cannot read the table", got=type(error).__name__, where=path) from None
    rows: list[list[float]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        cells = line.split("#")[0].replace(",", " ").replace(";", " ").replace('"', " ").split()
        if not cells:
            continue
        try:
            row = [float(cell) for cell in cells]
        except ValueError:
            if rows:
                raise InputError(f"{where}: not a number", got=line[:60], where=f"{path}:{number}") from None
            continue  # a header
        if len(row) != columns + 1:
            raise InputError(
                f"{where}: columns",
                got=str(len(row)),
                expected=f"{columns + 1} (wavelength in nm, values)",
                where=f"{path}:{number}",
            )
        rows.append(row)
    table = np.array(rows, dtype=float)
    if len(rows) < 2 or not np.isfinite(table).all() or (np.diff(table[:, 0]) <= 0).any():
        raise InputError(f"{where}: needs at least two rows of finite numbers in order of wavelength", where=path)
    if table[-1, 0] < 400 or table[0, 0] > 700:
        raise InputError(f"{where}: wavelengths in nm", got=f"{table[0, 0]:g} to {table[-1, 0]:g}", where=path)
    return table
