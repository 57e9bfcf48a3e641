"""A real photograph (report 4.2), and what a fit to one proves: the same fit on patches that have nothing to tell."""

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
from huesphere.render.encoding import decode_srgb, encode_srgb

REPORT_R2 = 0.99954
FROM_LEFT, IN_FRONT, FROM_BELOW = np.array([-1.0, 0, 1]), np.array([0.0, 0, 1]), np.array([0.0, -1, 1])
DARKEST, BRIGHTEST = 0.02, 0.98  # full scale: patches with more than a tenth of their pixels beyond are not drawn


PHOTOGRAPHS = "random patches of photographs"
CLOUDS = "random clouds of their mean and covariance"
OWN_CLOUDS = "random clouds of the region's"
ONE_LAMP = "the bust under one white lamp"


@dataclass(frozen=True)
class _Patch:
    """What the fit says of colours that may hold no surface at all."""

    r2: float
    r2_as_shown: float  # of display-encoded samples; NaN where these have no ellipsoid
    significant: bool  # all six coefficients, |t| > 2


@dataclass(frozen=True)
class _Kind:
    """Fits to one kind of colours that hold nothing to find."""

    tried: int
    fits: list[_Patch]  # those that have an ellipsoid

    @property
    def no_ellipsoid(self) -> float:
        return 1 - len(self.fits) / self.tried if self.tried else float("nan")

    @property
    def median_r2(self) -> float:
        return float(np.median([p.r2 for p in self.fits])) if self.fits else float("nan")

    @property
    def significant(self) -> float:
        return float(np.mean([p.significant for p in self.fits])) if self.fits else float("nan")

    def as_good(self, r2: float) -> float:
        """Share of all tried whose R² is at least ``r2``."""
        return sum(p.r2 >= r2 for p in self.fits) / self.tried if self.tried else float("nan")

    def as_good_as_shown(self, r2: float) -> float:
        """The same of display-encoded samples."""
        return sum(p.r2_as_shown >= r2 for p in self.fits) / self.tried if self.tried else float("nan")


def photograph_section(study: Photograph, bust: Rendered, white: np.ndarray) -> Section:
    """Section 4.2 on a photograph. ``white`` (3,): the colour of one lamp on the bust, for a picture under it alone."""
    encoded = _encoded(study.picture)
    linear = decode_srgb(encoded)
    region, larger = _cut(linear, study.region, study.picture), _cut(linear, study.larger, study.picture)
    colours = region.reshape(-1, 3)
    fit = reweighted(colours, least_median_of_squares(colours))
    as_shown = _cut(encoded, study.region, study.picture).reshape(-1, 3)
    shown_fit = reweighted(as_shown, least_median_of_squares(as_shown))
    nothing = _nothing_to_tell(study, bust, white, colours)
    claims = (
        _determination(fit, shown_fit),
        _significance(fit),
        _near_one(fit, colours),
        _lengths(fit, colours),
        _dark_outliers(fit, region),
        _larger(fit, larger),
        _inference(fit, shown_fit, nothing),
    )
    return Section(
        "A real photograph",
        (
            (
                f"The report's picture cannot be used; {study.picture.rsplit('.', 1)[0]} (NASA, public domain; it "
                f"ships with scikit-image) stands in, cheeks and nose at {study.region}. Its samples are "
                "display-encoded and are decoded as sRGB first; what a photographer or a scanner did to them before "
                "is not known."
            ),
            *_sober(fit, shown_fit, nothing),
        ),
        claims,
        (_coefficients(fit), _nothing_table(fit, shown_fit, nothing)),
        _figures(study, encoded, region, larger, fit, nothing),
    )


# ---- what a fit proves -----------------------------------------------------------------------------------------------


def _nothing_to_tell(study: Photograph, bust: Rendered, white: np.ndarray, own: np.ndarray) -> dict[str, _Kind]:
    """The same fit where there is no spectrally varying light to find. ``own`` (N, 3): the region, linear."""
    rng = np.random.default_rng(study.seed)
    drawn = []
    for name in study.others:
        image = decode_srgb(_encoded(name))
        drawn += [patch.reshape(-1, 3) for patch in _patches(image, study.patches, study.side, rng)]
    one = _under_one_light(bust, white, rng)
    side = min(study.side, one.shape[0] // 6)
    kinds = {
        PHOTOGRAPHS: drawn,
        CLOUDS: [_cloud_like(colours, rng) for colours in drawn],
        OWN_CLOUDS: [_cloud_like(own, rng) for _ in range(study.patches)],
        ONE_LAMP: [patch.reshape(-1, 3) for patch in _patches(one, study.patches, side, rng)],
    }
    return {name: _Kind(len(colours), _fitted_all(colours)) for name, colours in kinds.items()}


def _fitted_all(patches: list[np.ndarray]) -> list[_Patch]:
    """LMS and all that follows on each set of colours (N, 3) that has an ellipsoid."""
    found = []
    for colours in patches:
        try:
            fit = reweighted(colours, least_median_of_squares(colours))
        except RecoveryFailure:
            continue
        as_shown = _determination_of(encode_srgb(np.clip(colours, 0, 1)))
        found.append(_Patch(fit.r2, as_shown, all(abs(float(c["t"])) > 2 for c in fit.coefficients)))
    return found


def _determination_of(colours: np.ndarray) -> float:
    """R² of the ellipsoid that LMS finds in colours (N, 3), NaN where there is none."""
    try:
        return determination(residuals(colours, least_median_of_squares(colours)))
    except RecoveryFailure:
        return float("nan")


def _patches(image: np.ndarray, count: int, side: int, rng: np.random.Generator) -> list[np.ndarray]:
    """``count`` squares of an image (H, W, 3) that are neither black nor clipped; fewer where few are."""
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
    """Normal deviates with the mean and the covariance of colours (N, 3): no surface, no light, no ellipsoid."""
    return rng.multivariate_normal(colours.mean(axis=0), np.cov(colours.T), len(colours), method="eigh")


def _under_one_light(bust: Rendered, white: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The bust under one lamp as a photograph would show it: a texture of 2 %, noise of 0.5 %, 8 bits, sRGB; linear."""
    light = np.array([[0.3, 0.3, 0.9]]) / np.linalg.norm([0.3, 0.3, 0.9])
    observation, _ = shaded(bust.truth.normals.astype(float), bust.mask, light, white[None])
    picture = observation.rgb * (1 + 0.02 * rng.standard_normal(bust.mask.shape))[..., None]
    picture = picture + 0.005 * rng.standard_normal(picture.shape)
    return decode_srgb(np.round(255 * encode_srgb(np.clip(picture, 0, 1))) / 255)


def _sober(fit: Fit, as_shown: Fit, nothing: dict[str, _Kind]) -> tuple[str, ...]:
    photographs, clouds, own, one = (nothing[name] for name in (PHOTOGRAPHS, CLOUDS, OWN_CLOUDS, ONE_LAMP))
    excluded = own.as_good(fit.r2) < 0.05
    return (
        (
            "What does such a fit prove? R² = 1 − (median |ρᵀCρ − 1|)² is no share of variance explained: it "
            "asks that half the colours keep a nearly constant size in some norm, and squares what is left. "
            f"R² = {text(fit.r2, 5)} means that the median colour is "
            f"{percent(np.sqrt(max(0.0, 1 - fit.r2)) / 2, 1)} off the ellipsoid in size. The samples as "
            f"encoded, which the report most likely used, give {text(as_shown.r2, 5)}: display encoding "
            "compresses, and any picture fits better in it."
        ),
        (
            "Where there is nothing to find: of random patches of ordinary photographs "
            f"{percent(photographs.no_ellipsoid)} have no ellipsoid at all; the others reach a median R² of "
            f"{text(photographs.median_r2, 5)}, and {percent(photographs.as_good(fit.r2))} of all patches do "
            "as well as this region. Clouds of random numbers with the patches' means and covariances, which "
            f"are pictures of nothing, reach {text(clouds.median_r2, 5)}; patches of the bust under one white "
            f"lamp {text(one.median_r2, 5)}, {percent(one.as_good(fit.r2))} of them as well as the region. All "
            f"six coefficients are significant in {percent(photographs.significant)} of the random patches "
            "that have an ellipsoid: thousands of pixels make any coefficient significant."
        ),
        (
            f"Clouds with the region's own mean and covariance do as well in {percent(own.as_good(fit.r2))} of "
            f"the cases, so the region is {'more' if excluded else 'no more'} of a shell than a shapeless "
            "cloud; but shading under a single lamp piles colours up toward the brightest one as well. "
            "Neither a high R² nor significant coefficients nor κ near 1 nor normals of unit length (which is "
            "κ near 1 once more) shows that a picture was taken under spectrally varying light. What would: "
            "normals that come out integrable without having been made so, a shape known from elsewhere, a "
            "second picture."
        ),
    )


# ---- claims ----------------------------------------------------------------------------------------------------------


def _determination(fit: Fit, as_shown: Fit) -> Claim:
    return Claim(
        "photo-r2",
        "4.2",
        f"The robust R² is {REPORT_R2}: the data belong to an ellipsoidal shell to a high degree of probability.",
        f"{text(fit.r2, 5)} of linear colours, {text(as_shown.r2, 5)} of the samples as encoded. What such a value is "
        "worth is told above.",
        verdict(fit.r2 >= REPORT_R2, max(fit.r2, as_shown.r2) >= 0.99),
        {"R2": fit.r2, "R2 as encoded": as_shown.r2},
    )


def _significance(fit: Fit) -> Claim:
    t = np.array([float(c["t"]) for c in fit.coefficients])
    weakest = float(np.abs(t).min())
    return Claim(
        "photo-significance",
        "4.2",
        "All ellipsoid coefficients are statistically significant.",
        f"Least |t| of the six: {text(weakest, 3)} over {int(fit.accepted.sum())} accepted pixels.",
        verdict(weakest > 2),
        {"least t": weakest},
    )


def _near_one(fit: Fit, colours: np.ndarray) -> Claim:
    k = kappa(colours, fit.C)
    within = float(np.mean(np.abs(k - 1) < 0.1))
    return Claim(
        "photo-kappa",
        "4.2, Fig. 3(d)",
        "κ = ρᵀCρ is close to 1.",
        f"Median {text(median(k), 3)}; within 0.1 of 1 for {percent(within)} of the region.",
        verdict(within > 0.8, within > 0.5),
        {"median": median(k), "within 0.1": within},
    )


def _lengths(fit: Fit, colours: np.ndarray) -> Claim:
    lengths = np.sqrt(kappa(colours[fit.accepted], fit.C))
    within = float(np.mean(np.abs(lengths - 1) < 0.05))
    return Claim(
        "photo-lengths",
        "4.2, Fig. 3(e)",
        "Recovered normals are close to length 1, which lends further weight to the interpretation.",
        f"Within 0.05 of 1 for {percent(within)} of accepted pixels. But |Gρ|² = ρᵀCρ = κ whatever the root: it is the "
        "histogram of κ again and lends no further weight.",
        "does not follow",
        {"within 0.05": within},
    )


def _dark_outliers(fit: Fit, region: np.ndarray) -> Claim:
    size = np.linalg.norm(region.reshape(-1, 3), axis=1)
    out, inside = median(size[~fit.accepted]), median(size[fit.accepted])
    share = float(np.mean(~fit.accepted))
    return Claim(
        "photo-outliers",
        "4.2, Fig. 3(c)",
        "Outliers are generally lower-intensity pixels, in steeper parts near the eye and nose.",
        f"{percent(share)} are outliers; their median |ρ| is {text(out)}, that of the others {text(inside)}.",
        verdict(out < 0.95 * inside, out < inside),
        {"share": share, "median size out": out, "median size in": inside},
    )


def _larger(fit: Fit, larger: np.ndarray) -> Claim:
    r = residuals(larger.reshape(-1, 3), fit.C)
    on = float(np.mean(np.abs(r) <= 2.5 * fit.s0))
    return Claim(
        "photo-larger",
        "4.2, Figs. 3(g), (h)",
        "The same C applies to a larger region; what is not of the main segment is found as outliers.",
        f"{percent(on)} of the larger region is within 2.5 s0 of the ellipsoid, robust R² over all of it "
        f"{text(determination(r), 4)}. Hair, eyes and background are rejected. There is no truth to hold the normals "
        "against.",
        verdict(on > 0.3, on > 0.1),
        {"accepted": on, "R2": determination(r)},
    )


def _inference(fit: Fit, as_shown: Fit, nothing: dict[str, _Kind]) -> Claim:
    photographs, own, one = (nothing[name] for name in (PHOTOGRAPHS, OWN_CLOUDS, ONE_LAMP))
    common = max(photographs.as_good(fit.r2), photographs.as_good_as_shown(as_shown.r2), one.as_good(fit.r2))
    return Claim(
        "photo-inference",
        "4.2, Abstract",
        "The image was in all likelihood taken under spectrally varying illumination.",
        f"{percent(photographs.as_good(fit.r2))} of random patches of photographs fit as well "
        f"({percent(photographs.as_good_as_shown(as_shown.r2))} as encoded), {percent(one.as_good(fit.r2))} of "
        f"patches of a bust under one white lamp, and {percent(own.as_good(fit.r2))} of random clouds with the "
        "region's mean and covariance. It may be true; this does not show it.",
        "does not follow" if common > 0.05 else "in part",
        {f"as good: {name}": kind.as_good(fit.r2) for name, kind in nothing.items()},
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


def _nothing_table(fit: Fit, as_shown: Fit, nothing: dict[str, _Kind]) -> Table:
    rows = tuple(
        (
            name,
            str(kind.tried),
            percent(kind.no_ellipsoid),
            text(kind.median_r2, 5),
            percent(kind.as_good(fit.r2)),
            percent(kind.as_good_as_shown(as_shown.r2)),
            percent(kind.as_good_as_shown(REPORT_R2)),
            percent(kind.significant),
        )
        for name, kind in nothing.items()
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
    return Table(head, rows, "The same fit where no spectrally varying light is to be found; shares of all tried")


def _figures(
    study: Photograph,
    encoded: np.ndarray,
    region: np.ndarray,
    larger: np.ndarray,
    fit: Fit,
    nothing: dict[str, _Kind],
) -> tuple[Figure, ...]:
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
    misfit = {name: np.sort([1 - p.r2 for p in kind.fits]) for name, kind in nothing.items() if kind.fits}
    reached = {name: (m, np.arange(1, len(m) + 1) / nothing[name].tried) for name, m in misfit.items()}
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
            "How good a fit is where there is nothing to find",
            reached,
            "1 − R² (left is better)",
            "share of all tried that reach it",
            log_x=True,
            marked=False,
            at={"this region": max(1 - fit.r2, 1e-6), "the report's": 1 - REPORT_R2},
            bounds_y=(0, 1.02),
            caption="Curves end below 1 where some have no ellipsoid.",
        ),
    )


def _shaded(region: np.ndarray, key: str, title: str) -> tuple[Figure, ...]:
    """Depth over outliers by coupled depth/slope, shaded from left, front and below; nothing where recovery fails."""
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
    said = f"Lit from the left, in front, and below; gaps filled by coupled depth/slope. Status: {estimate.status}."
    return (plots.photo(key, title, stacked, said),)


def _boxed(image: np.ndarray, *boxes: Box) -> np.ndarray:
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
    """The samples (H, W, 3) of a photograph, full scale 1: scikit-image's by name, any other by path."""
    path = Path(name)
    if not path.is_file():
        import skimage

        path = Path(skimage.__file__).parent / "data" / name
    if not path.is_file():
        raise InputError("no such photograph, neither here nor in scikit-image", where=name)
    observation, _ = read_picture(path)
    return observation.rgb.astype(np.float64)


def _cut(image: np.ndarray, box: Box, name: str) -> np.ndarray:
    x0, y0, x1, y1 = box
    if not (0 <= x0 < x1 <= image.shape[1] and 0 <= y0 < y1 <= image.shape[0]):
        raise InputError("a region", got=str(box), expected=f"within {image.shape[1]} × {image.shape[0]}", where=name)
    return image[y0:y1, x0:x1]
