"""Claims of the report on a real photograph (4.2), and a test of its inference on colours without any such light.

The report concludes from a good ellipsoid fit that a photograph was taken under spectrally varying light. Here the same
fit is made to *controls*, colours for which that is false or meaningless: random patches of ordinary photographs,
random clouds of colours, and patches of a bust under one white lamp.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from huesphere.configs.errors import InputError
from huesphere.configs.study import Box, Photograph
from huesphere.eval import maps, slopes
from huesphere.eval.studies import plots
from huesphere.eval.studies.page import Claim, Figure, Section, Table, verdict
from huesphere.eval.studies.pictures import Rendered, median, percent, shaded, text
from huesphere.recover.depth.integration import depth_from_normals
from huesphere.recover.ellipsoid.fit import Fit, determination, kappa, least_median_of_squares, reweighted
from huesphere.recover.ellipsoid.normal_equations import residuals
from huesphere.recover.io.picture import read_picture
from huesphere.recover.methods.table import METHODS
from huesphere.recover.status import RecoveryFailure
from huesphere.render.dataset import CameraInfo, Observation
from huesphere.scenes.encoding import decode_srgb, encode_srgb

REPORT_R2 = 0.99954  # the report's robust R²
FROM_LEFT, IN_FRONT, FROM_BELOW = np.array([-1.0, 0, 1]), np.array([0.0, 0, 1]), np.array([0.0, -1, 1])
DARKEST, BRIGHTEST = 0.02, 0.98  # of full scale; patches with over a tenth of their pixels outside are not used

# Names of the controls
PHOTOGRAPHS = "random patches of photographs"
CLOUDS = "random clouds of their mean and covariance"
OWN_CLOUDS = "random clouds of the region's"
ONE_LAMP = "the bust under one white lamp"


@dataclass(frozen=True)
class _ControlFit:
    """The ellipsoid fit to one set of colours of a control."""

    r2: float  # robust R² of the linear colours
    r2_encoded: float  # of the same colours, display-encoded; NaN where these have no ellipsoid
    significant: bool  # whether |t| > 2 for all six coefficients


@dataclass(frozen=True)
class _Control:
    """The fits to all sets of colours of one control. Shares are NaN where there are none."""

    tried: int  # number of sets of colours
    fits: list[_ControlFit]  # of those sets that have an ellipsoid

    @property
    def no_ellipsoid(self) -> float:
        """Share of the sets that have no ellipsoid."""
        return 1 - len(self.fits) / self.tried if self.tried else float("nan")

    @property
    def median_r2(self) -> float:
        """Median R² of the sets that have an ellipsoid."""
        return float(np.median([p.r2 for p in self.fits])) if self.fits else float("nan")

    @property
    def significant(self) -> float:
        """Share of the sets with an ellipsoid whose six coefficients are all significant."""
        return float(np.mean([p.significant for p in self.fits])) if self.fits else float("nan")

    def as_good(self, r2: float) -> float:
        """Share of all sets with an R² of at least ``r2``."""
        return sum(p.r2 >= r2 for p in self.fits) / self.tried if self.tried else float("nan")

    def as_good_encoded(self, r2: float) -> float:
        """Share of all sets with an R² of at least ``r2`` when their colours are display-encoded."""
        return sum(p.r2_encoded >= r2 for p in self.fits) / self.tried if self.tried else float("nan")


def photograph_section(study: Photograph, bust: Rendered, white: np.ndarray) -> Section:
    """The section on report 4.2, with a photograph in place of the report's.

    ``white`` (3,): colour of the bust's surface under one white lamp, for the control pictures of ``bust``.
    """
    encoded = _encoded(study.picture)
    linear = decode_srgb(encoded)
    region, larger = _cut(linear, study.region, study.picture), _cut(linear, study.larger, study.picture)
    colours = region.reshape(-1, 3)
    fit = reweighted(colours, least_median_of_squares(colours))
    encoded_colours = _cut(encoded, study.region, study.picture).reshape(-1, 3)
    encoded_fit = reweighted(encoded_colours, least_median_of_squares(encoded_colours))
    controls = _fit_controls(study, bust, white, colours)
    claims = (
        _determination(fit, encoded_fit),
        _significance(fit),
        _near_one(fit, colours),
        _lengths(fit, colours),
        _dark_outliers(fit, colours),
        _larger(fit, larger),
        _inference(fit, encoded_fit, controls),
    )
    return Section(
        "A real photograph",
        (
            (
                f"The report's picture is not available. The photograph used instead is "
                f"{study.picture.rsplit('.', 1)[0]} (NASA, public domain; part of scikit-image), with cheeks and nose "
                f"at {study.region}. Its samples are display-encoded and are decoded as sRGB first; how they were "
                "processed before that is not known."
            ),
            *_discussion(fit, encoded_fit, controls),
        ),
        claims,
        (_coefficients(fit), _control_table(fit, encoded_fit, controls)),
        _figures(study, encoded, region, larger, fit, controls),
    )


# ---- controls --------------------------------------------------------------------------------------------------------


def _fit_controls(study: Photograph, bust: Rendered, white: np.ndarray, own: np.ndarray) -> dict[str, _Control]:
    """The ellipsoid fits of each control, by its name. ``own`` (N, 3): linear colours of the photograph's region."""
    rng = np.random.default_rng(study.seed)
    drawn = []
    for name in study.others:
        image = decode_srgb(_encoded(name))
        drawn += [patch.reshape(-1, 3) for patch in _patches(image, study.patches, study.side, rng)]
    one = _under_one_light(bust, white, rng)
    side = min(study.side, one.shape[0] // 6)
    sets = {
        PHOTOGRAPHS: drawn,
        CLOUDS: [_cloud_like(colours, rng) for colours in drawn],
        OWN_CLOUDS: [_cloud_like(own, rng) for _ in range(study.patches)],
        ONE_LAMP: [patch.reshape(-1, 3) for patch in _patches(one, study.patches, side, rng)],
    }
    return {name: _Control(len(colours), _fit_all(colours)) for name, colours in sets.items()}


def _fit_all(sets: list[np.ndarray]) -> list[_ControlFit]:
    """The fit, LMS and reweighted least squares, to each set of colours (N, 3) that has an ellipsoid."""
    found = []
    for colours in sets:
        try:
            fit = reweighted(colours, least_median_of_squares(colours))
        except RecoveryFailure:
            continue
        encoded = _determination_of(encode_srgb(np.clip(colours, 0, 1)))
        found.append(_ControlFit(fit.r2, encoded, all(abs(float(c["t"])) > 2 for c in fit.coefficients)))
    return found


def _determination_of(colours: np.ndarray) -> float:
    """R² of the ellipsoid that LMS finds in colours (N, 3), NaN where there is none."""
    try:
        return determination(residuals(colours, least_median_of_squares(colours)))
    except RecoveryFailure:
        return float("nan")


def _patches(image: np.ndarray, count: int, side: int, rng: np.random.Generator) -> list[np.ndarray]:
    """Up to ``count`` random squares (side, side, 3) of an ``image`` (H, W, 3) that are neither black nor clipped."""
    found: list[np.ndarray] = []
    for _ in range(50 * count):
        row, column = (int(rng.integers(0, size - side + 1)) for size in image.shape[:2])
        patch = image[row : row + side, column : column + side]
        beyond = (patch.max(axis=-1) < DARKEST) | (patch.max(axis=-1) > BRIGHTEST)
        if beyond.mean() < 0.1:
            found.append(patch)
        if len(found) == count:
            break
    return found


def _cloud_like(colours: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Normally distributed colours (N, 3) with the mean and covariance of ``colours`` (N, 3): a picture of nothing."""
    return rng.multivariate_normal(colours.mean(axis=0), np.cov(colours.T), len(colours), method="eigh")


def _under_one_light(bust: Rendered, white: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Linear colours (H, W, 3) of the bust under one lamp, as a photograph would give them.

    With a texture of 2 %, noise of 0.5 %, sRGB encoding and rounding to 8 bits.
    """
    light = np.array([[0.3, 0.3, 0.9]]) / np.linalg.norm([0.3, 0.3, 0.9])
    observation, _ = shaded(bust.truth.normals.astype(float), bust.mask, light, white[None])
    picture = observation.rgb * (1 + 0.02 * rng.standard_normal(bust.mask.shape))[..., None]
    picture = picture + 0.005 * rng.standard_normal(picture.shape)
    return decode_srgb(np.round(255 * encode_srgb(np.clip(picture, 0, 1))) / 255)


def _discussion(fit: Fit, encoded_fit: Fit, controls: dict[str, _Control]) -> tuple[str, ...]:
    """Three paragraphs: what R² measures, how good the fits to the controls are, and what would be evidence."""
    photographs, clouds, own, one = (controls[name] for name in (PHOTOGRAPHS, CLOUDS, OWN_CLOUDS, ONE_LAMP))
    better_than_clouds = own.as_good(fit.r2) < 0.05
    return (
        (
            "What does such a fit prove? R² = 1 − (median |ρᵀCρ − 1|)² is not a share of explained variance. It "
            "is high if half of the colours have a nearly constant size in some norm, and it depends on the square "
            f"of the deviation. R² = {text(fit.r2, 5)} means that the median deviation of a colour from the ellipsoid "
            f"is {percent(np.sqrt(max(0.0, 1 - fit.r2)) / 2, 1)} of its size. The samples as encoded, which the report "
            f"most likely used, give {text(encoded_fit.r2, 5)}: display encoding compresses the range of sizes, so "
            "that any picture fits better."
        ),
        (
            "The same fit was made to colours without spectrally varying light. Of random patches of ordinary "
            f"photographs {percent(photographs.no_ellipsoid)} have no ellipsoid; the others have a median R² of "
            f"{text(photographs.median_r2, 5)}, and {percent(photographs.as_good(fit.r2))} of all patches fit "
            "as well as this region. Clouds of random numbers with the patches' means and covariances have a median "
            f"R² of {text(clouds.median_r2, 5)}. Patches of the bust under one white lamp have "
            f"{text(one.median_r2, 5)}, and {percent(one.as_good(fit.r2))} of them fit as well as the region. All "
            f"six coefficients are significant in {percent(photographs.significant)} of the random patches "
            "that have an ellipsoid: with thousands of pixels any coefficient is significant."
        ),
        (
            f"Random clouds with the region's own mean and covariance fit as well in {percent(own.as_good(fit.r2))} "
            f"of the cases, so the region is {'closer' if better_than_clouds else 'no closer'} to an ellipsoid than a "
            "cloud without structure. But under a single lamp shading concentrates colours near the brightest one as "
            "well. A high R², significant coefficients and κ near 1 do not show that a picture was taken under "
            "spectrally varying light; nor do normals of unit length, which is the same as κ near 1. Evidence would "
            "be normals that are integrable although integrability was not used to find them, a shape known from "
            "another source, or a second picture."
        ),
    )


# ---- claims ----------------------------------------------------------------------------------------------------------


def _determination(fit: Fit, encoded_fit: Fit) -> Claim:
    """Claim on the robust R² of the region's colours, linear (``fit``) and display-encoded (``encoded_fit``)."""
    return Claim(
        "photo-r2",
        "4.2",
        f"The robust R² is {REPORT_R2}: the data belong to an ellipsoidal shell to a high degree of probability.",
        f"R² is {text(fit.r2, 5)} for linear colours and {text(encoded_fit.r2, 5)} for the samples as encoded. The "
        "text above discusses what such a value means.",
        verdict(fit.r2 >= REPORT_R2, max(fit.r2, encoded_fit.r2) >= 0.99),
        {"R2": fit.r2, "R2 as encoded": encoded_fit.r2},
    )


def _significance(fit: Fit) -> Claim:
    """Claim on the coefficients of the ellipsoid: the least |t| of the six."""
    t = np.array([float(c["t"]) for c in fit.coefficients])
    weakest = float(np.abs(t).min())
    return Claim(
        "photo-significance",
        "4.2",
        "All ellipsoid coefficients are statistically significant.",
        f"The least |t| of the six is {text(weakest, 3)}, over {int(fit.accepted.sum())} accepted pixels.",
        verdict(weakest > 2),
        {"least t": weakest},
    )


def _near_one(fit: Fit, colours: np.ndarray) -> Claim:
    """Claim on κ = ρᵀCρ of the region's ``colours`` (N, 3): its median, and how often it is within 0.1 of 1."""
    k = kappa(colours, fit.C)
    within = float(np.mean(np.abs(k - 1) < 0.1))
    return Claim(
        "photo-kappa",
        "4.2, Fig. 3(d)",
        "κ = ρᵀCρ is close to 1.",
        f"The median is {text(median(k), 3)}, and κ is within 0.1 of 1 for {percent(within)} of the region.",
        verdict(within > 0.8, within > 0.5),
        {"median": median(k), "within 0.1": within},
    )


def _lengths(fit: Fit, colours: np.ndarray) -> Claim:
    """Claim on the lengths |Gρ| of the accepted ``colours``, of (N, 3): how often they are within 0.05 of 1."""
    lengths = np.sqrt(kappa(colours[fit.accepted], fit.C))
    within = float(np.mean(np.abs(lengths - 1) < 0.05))
    return Claim(
        "photo-lengths",
        "4.2, Fig. 3(e)",
        "Recovered normals are close to length 1, which lends further weight to the interpretation.",
        f"The length is within 0.05 of 1 for {percent(within)} of the accepted pixels. But |Gρ|² = ρᵀCρ = κ for every "
        "root G: this is the histogram of κ again and no further evidence.",
        "does not follow",
        {"within 0.05": within},
    )


def _dark_outliers(fit: Fit, colours: np.ndarray) -> Claim:
    """Claim on the outliers: their median |ρ| and that of the others, ``colours`` (N, 3) of the region, full scale 1.

    Where on the face the outliers lie is a part of the statement that is not measured, so it holds in part at best.
    """
    size = np.linalg.norm(colours, axis=1)
    out, inside = median(size[~fit.accepted]), median(size[fit.accepted])
    share = float(np.mean(~fit.accepted))
    return Claim(
        "photo-outliers",
        "4.2, Fig. 3(c)",
        "Outliers are generally lower-intensity pixels, in steeper parts near the eye and nose.",
        f"{percent(share)} of the pixels are outliers; their median |ρ| is {text(out)}, that of the others "
        f"{text(inside)} (full scale 1). Where on the face they lie, and how steep it is there, is not measured.",
        verdict(False, out < inside),
        {"share": share, "median size out": out, "median size in": inside},
    )


def _larger(fit: Fit, larger: np.ndarray) -> Claim:
    """Claim on a larger region, colours ``larger`` (H, W, 3): the share of it on the ellipsoid of the region."""
    r = residuals(larger.reshape(-1, 3), fit.C)
    on = float(np.mean(np.abs(r) <= 2.5 * fit.s0))
    return Claim(
        "photo-larger",
        "4.2, Figs. 3(g), (h)",
        "The same C applies to a larger region; what is not of the main segment is found as outliers.",
        f"{percent(on)} of the larger region is within 2.5 s0 of the ellipsoid; the robust R² over all of it is "
        f"{text(determination(r), 4)}. Hair, eyes and background are rejected. The true normals are not known.",
        verdict(on > 0.3, on > 0.1),
        {"accepted": on, "R2": determination(r)},
    )


def _inference(fit: Fit, encoded_fit: Fit, controls: dict[str, _Control]) -> Claim:
    """Claim that the fit shows the kind of light: the shares of the sets of each control that fit as well."""
    photographs, own, one = (controls[name] for name in (PHOTOGRAPHS, OWN_CLOUDS, ONE_LAMP))
    common = max(photographs.as_good(fit.r2), photographs.as_good_encoded(encoded_fit.r2), one.as_good(fit.r2))
    return Claim(
        "photo-inference",
        "4.2, Abstract",
        "The image was in all likelihood taken under spectrally varying illumination.",
        f"{percent(photographs.as_good(fit.r2))} of random patches of photographs fit as well "
        f"({percent(photographs.as_good_encoded(encoded_fit.r2))} as encoded), {percent(one.as_good(fit.r2))} of "
        f"patches of a bust under one white lamp, and {percent(own.as_good(fit.r2))} of random clouds with the "
        "region's mean and covariance. The statement may be true, but the fit does not show it.",
        "does not follow" if common > 0.05 else "in part",
        {f"as good: {name}": control.as_good(fit.r2) for name, control in controls.items()},
    )


# ---- tables and figures ----------------------------------------------------------------------------------------------


def _coefficients(fit: Fit) -> Table:
    rows = tuple(
        (
            str(c["name"]),
            *(text(float(c[key]), 4) for key in ("value", "stderr", "low", "high")),
            text(float(c["t"]), 3),
        )
        for c in fit.coefficients
    )
    return Table(
        ("coefficient", "value", "standard error", "95 % from", "to", "t"), rows, "The ellipsoid of the region"
    )


def _control_table(fit: Fit, encoded_fit: Fit, controls: dict[str, _Control]) -> Table:
    rows = tuple(
        (
            name,
            str(control.tried),
            percent(control.no_ellipsoid),
            text(control.median_r2, 5),
            percent(control.as_good(fit.r2)),
            percent(control.as_good_encoded(encoded_fit.r2)),
            percent(control.as_good_encoded(REPORT_R2)),
            percent(control.significant),
        )
        for name, control in controls.items()
    )
    head = (
        "fitted to",
        "tried",
        "no ellipsoid",
        "median R²",
        "as good as the region",
        "as encoded",
        f"≥ {REPORT_R2}, as encoded",
        "all six significant",
    )
    return Table(head, rows, "The same fit to colours without spectrally varying light; shares of all that were tried")


def _figures(
    study: Photograph,
    encoded: np.ndarray,
    region: np.ndarray,
    larger: np.ndarray,
    fit: Fit,
    controls: dict[str, _Control],
) -> tuple[Figure, ...]:
    """The report's Figs. 3(a)–(h), and the quality of the fits to the controls."""
    bytes_ = np.round(255 * encoded).astype(np.uint8)
    accepted = fit.accepted.reshape(region.shape[:2])
    colours = region.reshape(-1, 3)
    white = _cut(bytes_, study.region, study.picture).copy()
    white[~accepted] = 255
    on_larger = np.abs(residuals(larger.reshape(-1, 3), fit.C)).reshape(larger.shape[:2]) <= 2.5 * fit.s0
    larger_white = _cut(bytes_, study.larger, study.picture).copy()
    larger_white[~on_larger] = 255
    k = kappa(colours, fit.C)
    bins = np.linspace(0, 2, 81)
    misfit = {name: np.sort([1 - p.r2 for p in control.fits]) for name, control in controls.items() if control.fits}
    reached = {name: (m, np.arange(1, len(m) + 1) / controls[name].tried) for name, m in misfit.items()}
    return (
        plots.photo("photo-3a", "Fig. 3(a): the photograph and the region", _boxed(bytes_, study.region, study.larger)),
        plots.cloud("photo-3b", "Fig. 3(b): colours of the region", colours, fit.accepted, fit.C),
        plots.photo("photo-3c", "Fig. 3(c): outliers, in white", white),
        plots.histogram("photo-3d", "Fig. 3(d): κ = ρᵀCρ", {"region": k}, bins, "κ", at={"the ellipsoid": 1.0}),
        plots.histogram(
            "photo-3e",
            "Fig. 3(e): length of the recovered normals",
            {"accepted": np.sqrt(kappa(colours[fit.accepted], fit.C))},
            np.linspace(0.5, 1.5, 81),
            "|Gρ|",
        ),
        *_shaded(region, "photo-3f", "Fig. 3(f): recovered surface of the region"),
        plots.photo(
            "photo-3g", "Figs. 3(g), (h): the same C on the larger region", larger_white, "White: off the ellipsoid."
        ),
        plots.curves(
            "photo-nothing",
            "Quality of fits to colours without spectrally varying light",
            reached,
            "1 − R² (left is better)",
            "share of all tried that reach it",
            log_x=True,
            marked=False,
            at={"this region": max(1 - fit.r2, 1e-6), "the report's": 1 - REPORT_R2},
            bounds_y=(0, 1.02),
            caption="A curve ends below 1 where some sets of colours have no ellipsoid.",
        ),
    )


def _shaded(region: np.ndarray, key: str, title: str) -> tuple[Figure, ...]:
    """The recovered surface, with the gaps at outliers filled, shaded from left, front and below.

    No figure where recovery fails.
    """
    mask = np.ones(region.shape[:2], bool)
    observation = Observation(region.astype(np.float32), mask, CameraInfo(known=False))
    estimate = METHODS["drew-kontsevich"](observation)
    if not estimate.valid.any():
        return ()
    depth = depth_from_normals(estimate.normals, estimate.valid, mask)
    q, p = np.gradient(depth)
    n = np.stack([-p, q, np.ones_like(p)], axis=-1)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    lights = (FROM_LEFT, IN_FRONT, FROM_BELOW)
    views = [maps.shading_map(slopes.shade(n, light / np.linalg.norm(light)), mask) for light in lights]
    gap = np.full((3, region.shape[1], 3), 255, np.uint8)
    stacked = np.concatenate([views[0], gap, views[1], gap, views[2]])
    caption = f"Lit from the left, in front, and below; gaps filled by coupled depth/slope. Status: {estimate.status}."
    return (plots.photo(key, title, stacked, caption),)


def _boxed(image: np.ndarray, *boxes: Box) -> np.ndarray:
    """A copy of the image (H, W, 3) with the outlines of the boxes (x0, y0, x1, y1) drawn, in pixels."""
    out = image.copy()
    for (x0, y0, x1, y1), colour in zip(boxes, ((255, 255, 255), (86, 180, 233))):
        for line in (
            out[y0 - 1 : y0 + 1, x0:x1],
            out[y1 - 1 : y1 + 1, x0:x1],
            out[y0:y1, x0 - 1 : x0 + 1],
            out[y0:y1, x1 - 1 : x1 + 1],
        ):
            line[:] = colour
    return out


def _encoded(name: str) -> np.ndarray:
    """Display-encoded samples (H, W, 3) of a photograph, full scale 1: a path, or the name of one of scikit-image's.

    Raises InputError where there is neither.
    """
    path = Path(name)
    if not path.is_file():
        import skimage

        path = Path(skimage.__file__).parent / "data" / name
    if not path.is_file():
        raise InputError("no such photograph, neither here nor in scikit-image", where=name)
    observation, _ = read_picture(path)
    return observation.rgb.astype(np.float64)


def _cut(image: np.ndarray, box: Box, name: str) -> np.ndarray:
    """The part of an image (H, W, …) in the box (x0, y0, x1, y1). Raises InputError where it is not inside."""
    x0, y0, x1, y1 = box
    if not (0 <= x0 < x1 <= image.shape[1] and 0 <= y0 < y1 <= image.shape[0]):
        raise InputError("a region", got=str(box), expected=f"within {image.shape[1]} × {image.shape[0]}", where=name)
    return image[y0:y1, x0:x1]
