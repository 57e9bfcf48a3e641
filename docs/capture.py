"""Make the pictures of docs/capture.md: python docs/capture.py → docs/images/capture.png; prints its table.

Each case is a rendered scene, the bust of huesphere in direct light with cast shadows under three lamps, right or with
one thing wrong. Shown are the picture, the angular error of `weak-integrability`, and the number that decides: the
condition of F times the misfit of the picture to ρ = F n.
"""

import io
import sys
import tempfile
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

import huesphere as hs
from huesphere.configs.load import load_config
from huesphere.eval.metrics import angular_error_deg, colour_condition, fit_colour_matrix
from huesphere.recover.methods.table import METHODS
from huesphere.render.run import render_config

IMAGE = Path(__file__).parent / "images" / "capture.png"
SIZE = 80
COLUMNS = 4  # of the figure, which has two rows of pictures with their errors; the last place holds the scale
METHOD = "weak-integrability"
NOISE = 1e-3  # of full scale
OVEREXPOSED = 2.5
COLOURS = 256  # of the file's palette: a third of the size
LEAST_PIXELS = 10  # that see every lamp and are not clipped, for a fit of F
COMMON = ["name=case", f"camera.resolution=[{SIZE},{SIZE}]", "render.transport=[direct]", "surface.reflectance=0.6"]
COMMON += [f"camera.read_noise={NOISE}"]
PRIMARIES = tuple(f"{{gaussian: {{centre: {nm}, sigma: {sigma}}}}}" for nm, sigma in ((610, 25), (540, 25), (460, 20)))
NATURAL = ("A", "D65", "FL2")


def lamps(azimuths: tuple[float, ...], off_axis: float, spectra: tuple[str, ...] = PRIMARIES) -> str:
    """The key ``lights`` of a config: lamps at ``azimuths`` and ``off_axis`` degrees."""
    sine, cosine = np.sin(np.radians(off_axis)), np.cos(np.radians(off_axis))
    lights = []
    for azimuth, spectrum in zip(np.radians(azimuths), spectra, strict=True):
        direction = f"[{sine * np.cos(azimuth):.4f}, {sine * np.sin(azimuth):.4f}, {cosine:.4f}]"
        lights.append(f"{{kind: distant, direction: {direction}, spectrum: {spectrum}}}")
    return f"lights=[{', '.join(lights)}]"


RIGHT = lamps((90, 210, 330), 35)
CASES: dict[str, list[str]] = {
    "right: three primaries,\n120° apart, 35° off axis": [RIGHT],
    "lamps of like colours\n(A, D65, FL2)": [lamps((90, 210, 330), 35, NATURAL)],
    "lamps all on one side": [lamps((60, 90, 120), 35)],
    "lamps near the camera\n(10° off axis)": [lamps((90, 210, 330), 10)],
    "overexposed 2.5 times,\nclipped": [RIGHT, "camera.exposure=OVER", "camera.bits=12"],
    "two paints": [RIGHT, "surface={reflectance: 0.6, checker: {reflectance: 0.45, size: 0.5}}"],
    "glossy": [RIGHT, "surface={kind: coated, reflectance: 0.4, roughness: 0.3}"],
}


def too_long(folder: Path) -> float:
    """The exposure at which the right picture is OVEREXPOSED times as bright as it should be."""
    sets = [*COMMON, RIGHT, "camera.exposure=1"]
    render_config(load_config("mozart_5gels", overrides=sets), folder, progress=quiet, log=quiet, overwrite=True)
    observation = hs.open_run(folder)[0].observation()
    return OVEREXPOSED * 0.9 / float(np.percentile(observation.rgb[observation.mask], 99.9))


def told(value: float, form: str, unit: str = "") -> str:
    """A number of the table; "–" where it is not known."""
    return f"{value:{form}}{unit}" if np.isfinite(value) else "–"


def quiet(*_: object) -> None:
    return


def measured(sets: list[str], folder: Path) -> tuple[hs.RunItem, np.ndarray, dict[str, float | str]]:
    """(the rendered item, angular error (H, W), the numbers of the case)."""
    config = load_config("mozart_5gels", overrides=[*COMMON, *sets])
    render_config(config, folder, progress=quiet, log=quiet, overwrite=True)
    (item,) = hs.open_run(folder)
    observation, truth = item.observation(), item.truth()
    estimate = METHODS[METHOD](observation)
    error = angular_error_deg(estimate.normals, truth.normals)
    lit = truth.mask & (truth.attached_shadow + truth.cast_shadow < 0.01).all(axis=-1)
    lit &= (observation.rgb < 0.999).all(axis=-1) | (observation.camera.saturation is None)  # clipped ones are left out
    rgb, normals = observation.rgb[lit].astype(float), truth.normals[lit].astype(float)
    F, misfit = np.full((3, 3), np.nan), float("nan")
    if lit.sum() >= LEAST_PIXELS:
        F = fit_colour_matrix(rgb, normals)
        misfit = float(np.sqrt(np.mean((rgb - normals @ F.T) ** 2) / np.mean(rgb**2)))
    condition = colour_condition(F) if np.isfinite(F).all() else float("nan")
    given = np.isfinite(error) & truth.mask
    numbers: dict[str, float | str] = {
        "cond F": condition,
        "misfit": misfit,
        "product": condition * misfit,
        "median": float(np.median(error[given])) if given.any() else float("nan"),
        "coverage": float(given.sum() / truth.mask.sum()),
        "verdict": estimate.verdict,
    }
    return item, error, numbers


def main() -> None:
    figure, axes = plt.subplots(4, COLUMNS, figsize=(2.25 * COLUMNS, 10.0), layout="constrained")
    places = np.concatenate([axes[:2].T, axes[2:].T])  # (case, picture and error)
    print(f"| | cond F | misfit | product | median error | normals given | verdict |\n{'| --- ' * 7}|")
    with tempfile.TemporaryDirectory() as folder:
        over = f"{too_long(Path(folder)):.6g}"
        for (title, sets), (above, below) in zip(CASES.items(), places):
            item, error, of = measured([one.replace("OVER", over) for one in sets], Path(folder))
            above.imshow(plt.imread(item.folder / "preview.png"))
            above.set_title(title, fontsize=9)
            shown = below.imshow(error, cmap="viridis", vmin=0, vmax=30)
            fit = f"cond F {of['cond F']:.0f} × misfit {of['misfit']:.1%}"
            if of["coverage"]:
                below.set_title(f"{of['median']:.1f}°, {of['verdict']}\n{fit}", fontsize=8)
            else:
                below.set_title(f"no normals, {of['verdict']}\nnothing is left to fit", fontsize=8)
            plain = title.replace("\n", " ")
            print(
                f"| {plain} | {told(of['cond F'], '.1f')} | {told(of['misfit'], '.1%')} | {told(of['product'], '.2f')} "
                f"| {told(of['median'], '.1f', '°')} | {of['coverage']:.0%} | {of['verdict']} |",
                flush=True,
            )
    for axis in axes.flat:
        axis.set_axis_off()
    figure.colorbar(shown, cax=places[-1, 1].inset_axes((0.2, 0.0, 0.1, 1.0)), label="angular error, degrees")
    drawn = io.BytesIO()
    figure.savefig(drawn, dpi=100)
    picture = Image.open(drawn).convert("RGB").quantize(COLOURS, Image.Quantize.MAXCOVERAGE, kmeans=3)
    picture.save(sys.argv[1] if len(sys.argv) > 1 else IMAGE, optimize=True)


if __name__ == "__main__":
    main()
