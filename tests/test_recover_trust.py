"""The verdict: what counts as evidence, that worse figures never help, and that broken pictures are not trusted."""

import json
from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from sharing import shared
from synthesis import TWIN, angles_deg, dome, light_colours, median_error, shade

from huesphere.eval.metrics import COLUMNS
from huesphere.recover.interreflection.removal import gathered_light
from huesphere.recover.io.estimate import Estimate, read_estimate, write_estimate
from huesphere.recover.methods.table import METHODS
from huesphere.recover.methods.weak import recover_weak_integrability
from huesphere.recover.reasons import Reason
from huesphere.recover.run import describe, recover_one
from huesphere.recover.status import REMEDIES
from huesphere.recover.trust.alternatives import turns
from huesphere.recover.trust.evidence import Evidence, evidence_of
from huesphere.recover.trust.factors import FACTORS
from huesphere.recover.trust.hollow import Hollowness, hollowness
from huesphere.recover.trust.joined import joined_to
from huesphere.recover.trust.outline import inflated, outline
from huesphere.recover.trust.stated_error import (
    APART_DEG,
    LEAST_OF_OWN_ROTATION,
    pixel_figures,
    rotation_figures,
    weights,
)
from huesphere.recover.trust.verdict import factors_of, judged
from huesphere.render.dataset import Observation, write_observation
from huesphere.scenes.encoding import encode_srgb

GELS = light_colours("gels")
FAST = ("least-squares", "drew-kontsevich", "weak-integrability", "robust", "knit", "auto")
RNG = np.random.default_rng(0)


@cache
def picture(noise: float = 0.0) -> tuple[Observation, np.ndarray, np.ndarray]:
    """(observation, normals, mask) of a bumpy body that turns away at its outline."""
    normals, mask = dome(72, elongation=0.9, bumps=0.05, cap=0.995)
    return shade(normals, mask, GELS, noise=noise)[0], normals, mask


@cache
def ball(size: int = 72) -> tuple[np.ndarray, np.ndarray]:
    """(normals, mask) of a ball."""
    return dome(size, cap=0.995)


@cache
def unjudged() -> Estimate:
    return recover_weak_integrability(picture()[0])


@cache
def evidence() -> Evidence:
    found = evidence_of(unjudged(), picture()[0])
    assert found is not None
    return found


def found_in_picture(noise: float, method: str) -> Estimate:
    return shared(f"trust-{noise}-{method}", lambda: recover_one(picture(noise)[0], method))


def found_in_broken(kind: str, method: str) -> Estimate:
    return shared(f"trust-{kind}-{method}", lambda: recover_one(broken(kind)[0], method))


# ---- evidence --------------------------------------------------------------------------------------------------------


def test_an_inflated_disc_is_a_ball():
    normals, mask = ball()
    assert np.median(angles_deg(inflated(mask)[mask], normals[mask])) < 1.5


@pytest.mark.parametrize(("turn", "sign"), [(np.eye(3), 1), (TWIN, -1)])
def test_the_outline_tells_a_ball_from_a_bowl(turn, sign):
    normals, mask = ball()
    observation, _ = shade(normals, mask, GELS)
    found = outline(normals @ turn, mask, mask, observation.rgb.astype(float), mask)
    assert sign * found.outward > 0.95
    assert (found.rim_deg < 10) == (sign > 0)
    assert (found.template_deg < found.template_other_deg) == (sign > 0)


def test_an_object_that_fills_the_picture_has_no_outline():
    normals, mask = ball()
    everything = np.ones_like(mask)
    observation, _ = shade(normals, mask, GELS)
    assert outline(normals, mask, everything, observation.rgb.astype(float), mask).outward == 0


def test_a_rotation_away_from_the_right_one_is_told():
    """Terms N × N_x, N × N_y of true normals of a surface: turned, the least curl is where they came from."""
    normals, mask = dome(64, elongation=0.8, bumps=0.1, cap=0.7)
    inner = mask & np.roll(mask, 1, 0) & np.roll(mask, -1, 0) & np.roll(mask, 1, 1) & np.roll(mask, -1, 1)
    N_y, N_x = np.gradient(normals, axis=(0, 1))
    row, column = np.nonzero(inner)

    def terms(turn):
        N, x, y = (values[inner] @ turn.T for values in (normals, N_x, N_y))
        return np.concatenate([np.cross(N, x), -np.cross(N, y)], axis=1)

    angle = np.radians(6.0)
    turn = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    right, wrong = turns(terms(np.eye(3)), row, column), turns(terms(turn), row, column)
    assert right.moved_deg < 0.5
    assert wrong.moved_deg == pytest.approx(6.0, abs=0.5)
    assert right.rival > 3


def test_interreflection_rules_a_twin_out_only_by_what_is_there():
    assert Hollowness(own=0.0, twin=0.3, twin_albedo=0.01).twin_possible == pytest.approx(0.01)  # a ball without light
    assert Hollowness(own=0.3, twin=0.0, own_gain=10.0).twin_possible == pytest.approx(0.1)  # a bowl with its light
    assert Hollowness(own=0.3, twin=0.0, own_gain=10.0, offset_gain=9.0).twin_possible == pytest.approx(0.9)
    assert Hollowness(own=0.0, twin=0.0).twin_possible == 1.0  # a plane has none either way


def possible_albedo_of_the_bowl(albedo: float, noise: float) -> float:
    """The bound of the bowl's albedo, of a noisy picture that looks like one of a ball.

    It is one of a bowl that lights itself with this ``albedo``, or at albedo 0 that of a ball.
    """
    normals, mask = dome(72, cap=0.8)
    bowl = normals @ TWIN
    direct, _ = shade(bowl if albedo else normals, mask, GELS)
    light = direct.rgb.astype(float)
    for _ in range(6 if albedo else 0):
        light = direct.rgb + albedo * gathered_light(bowl, mask, direct, light, azimuths=12)
    light += noise * np.random.default_rng(1).standard_normal(light.shape)
    seen = replace(direct, rgb=np.where(mask[..., None], light, 0).astype(np.float32))
    found = recover_weak_integrability(seen)
    assert np.median(angles_deg(found.normals[found.valid], normals[found.valid])) < 2  # as the ball, right or not
    core = found.inlier & mask
    return hollowness(found.normals.astype(float), found.valid, core, seen, seen.rgb.astype(float)).twin_possible


def test_a_bowl_may_have_an_albedo_that_a_ball_in_the_same_noise_may_not():
    """Normals carry the noise of their own pixels, and must not carry it into the light that these gather."""
    of_bowl, of_ball = (possible_albedo_of_the_bowl(albedo, noise=1e-3) for albedo in (0.5, 0.0))
    assert of_ball < 0.1
    assert of_bowl > 0.2


def test_a_quadric_and_its_mirror_image_are_two_surfaces_without_noise_too():
    y, x = np.mgrid[1:-1:72j, -1:1:72j]
    mask = np.hypot(x, y) < 0.97
    normals = np.stack([-x, y, np.ones_like(x)], axis=-1)  # the saddle z = (x² − y²) / 2
    normals = np.where(mask[..., None], normals / np.linalg.norm(normals, axis=-1, keepdims=True), np.nan)
    found = recover_one(shade(normals, mask, GELS)[0], "weak-integrability")
    assert found.status == "rotation-undetermined"
    assert "another surface explains the picture as well" in found.message


# ---- factors ---------------------------------------------------------------------------------------------------------

WORSE = {  # figures, with a direction in which they speak against an estimate
    "stated_deg": 1,
    "rotation_deg": 1,
    "correlated_deg": 1,
    "halves_deg": 1,
    "not_integrable_deg": 1,
    "turn_spread_deg": 1,
    "turn_moved_deg": 1,
    "rival": -1,
    "off_axis_deg": 1,
    "facing_away": 1,
    "twin_possible": 1,
    "rim_deg": 1,
    "interpolated": 1,
    "mapped": 1,
    "core": -1,
}


@settings(deadline=None)
@given(st.sampled_from(sorted(WORSE)), st.floats(0.01, 0.99), st.floats(1.05, 20))
def test_no_worse_figure_makes_an_estimate_more_credible(name, start, times):
    own = replace(evidence(), **{name: start})
    worse = replace(own, **{name: start * times if WORSE[name] > 0 else start / times})
    before, after = factors_of(own), factors_of(worse)
    assert all(after[factor] <= before[factor] + 1e-12 for factor in FACTORS)


def test_every_factor_has_a_status_with_a_remedy_and_says_what_was_measured():
    for factor in FACTORS.values():
        assert factor.status in REMEDIES
        assert len(factor.told(evidence(), 1.0)) > 30


def test_figures_without_a_value_are_as_bad_as_can_be():
    lost = replace(evidence(), rival=float("inf"), turn_spread_deg=float("nan"))
    assert factors_of(lost)["rotation"] < factors_of(evidence())["rotation"]


# ---- verdict ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("method", "noise"),
    [*((method, 0.0) for method in ("weak-integrability", "robust", "knit", "auto")), ("knit", 1e-3), ("auto", 1e-3)],
)
def test_what_is_right_is_trusted(method, noise):
    found = found_in_picture(noise, method)
    assert median_error(found, picture(noise)[1]) < 2.0
    assert (found.status, found.verdict, found.doubts) == ("ok", "trust", ())


def test_an_estimate_that_was_turned_is_not_trusted():
    angle = np.radians(25.0)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    found = unjudged()
    assert found.solution is not None
    normals = np.where(found.valid[..., None], found.normals @ turn.T, np.nan).astype(np.float32)
    wrong = replace(found, normals=normals, solution=replace(found.solution, F=found.solution.F @ turn.T))
    assert judged(found, picture()[0]).verdict == "trust"
    doubtful = judged(wrong, picture()[0])
    assert doubtful.verdict == "doubtful"
    assert doubtful.status in REMEDIES
    assert doubtful.doubts
    assert doubtful.message == doubtful.doubts[0]


def broken(kind: str) -> tuple[Observation, np.ndarray]:
    """(observation that breaks an assumption, normals)."""
    normals, mask = dome(72, elongation=0.9, bumps=0.05, cap=0.97)
    observation, _ = shade(normals, mask, GELS, noise=1e-3)
    rgb = observation.rgb.astype(np.float64)
    column = np.mgrid[:72, :72][1] / 71.0
    rng = np.random.default_rng(1)
    if kind == "two colours":
        rgb = rgb * np.where((column > 0.5)[..., None], [1.0, 0.3, 0.5], 1.0)
    elif kind == "brightness over the object":
        rgb = rgb * (0.3 + 0.7 * column)[..., None]
    elif kind == "display-encoded, taken as linear":
        rgb = encode_srgb(np.clip(rgb, 0, 1))
    elif kind == "shuffled blocks":
        blocks = rgb.reshape(9, 8, 9, 8, 3).swapaxes(1, 2).reshape(81, 8, 8, 3)[rng.permutation(81)]
        rgb, mask = blocks.reshape(9, 9, 8, 8, 3).swapaxes(1, 2).reshape(72, 72, 3), np.ones_like(mask)
        rgb += 0.02
    elif kind == "noise":
        rgb = rng.uniform(0.1, 0.9, rgb.shape)
    elif kind == "black level":
        rgb = rgb + 0.15
    rgb = np.where(mask[..., None], rgb, 0.0)
    return replace(observation, rgb=rgb.astype(np.float32), mask=mask), normals


KINDS = ("two colours", "brightness over the object", "display-encoded, taken as linear", "shuffled blocks", "noise")


@pytest.mark.parametrize("method", FAST)
@pytest.mark.parametrize("kind", [*KINDS, "black level"])
def test_a_broken_assumption_is_not_trusted_where_it_makes_the_normals_wrong(kind, method):
    found, normals = found_in_broken(kind, method), broken(kind)[1]
    wrong = found.valid.any() and median_error(found, normals) > 10
    assert not (wrong and found.verdict == "trust"), f"{median_error(found, normals):.0f}° off and trusted"
    assert found.verdict != "trust" or kind not in ("shuffled blocks", "noise")


@pytest.mark.parametrize("method", METHODS)
def test_the_verdict_is_trust_exactly_where_the_status_is_ok_and_doubts_come_with_the_rest(method):
    for found in (found_in_picture(1e-3, method), found_in_broken("two colours", method)):
        assert (found.status == "ok") == (found.verdict == "trust")
        assert (found.verdict == "failed") == (not found.valid.any())
        assert bool(found.doubts) == (found.status != "ok")


def test_the_verdict_survives_the_way_to_disk_and_is_in_the_tables(tmp_path):
    observation, _ = broken("two colours")
    path = tmp_path / "observation.exr"
    write_observation(path, observation)
    found = recover_one(observation, "weak-integrability")
    write_estimate(tmp_path, found, path)
    record = json.loads((tmp_path / "weak-integrability.json").read_text())
    assert record["verdict"] == "doubtful"
    assert record["doubts"] == list(found.doubts)
    assert read_estimate(tmp_path, "weak-integrability")[0].doubts == found.doubts
    assert "verdict" in COLUMNS


def test_the_terminal_says_the_verdict_and_every_doubt_on_a_line():
    found = found_in_broken("two colours", "weak-integrability")
    lines = describe("picture", found).splitlines()
    assert "doubtful" in lines[0]
    assert found.status in lines[0]
    assert len(lines) >= 1 + len(found.doubts)
    assert "trust" in describe("picture", judged(unjudged(), picture()[0])).splitlines()[0]


# ---- stated errors ---------------------------------------------------------------------------------------------------


def test_stated_errors_have_a_weight_for_each_figure_and_only_where_there_are_normals():
    found = judged(unjudged(), picture()[0])
    figures = pixel_figures(unjudged(), evidence(), picture()[2])
    assert set(figures) == set(weights()["weights"])
    assert (np.isfinite(found.uncertainty_deg) == found.valid).all()
    assert found.uncertainty_deg[found.valid].min() > 0


def test_an_interpolated_normal_is_stated_to_be_worse_the_farther_it_is_from_colours():
    observation, _, mask = picture(1e-3)
    rgb = observation.rgb.copy()
    rgb[30:44, 30:44] = np.nan  # lost samples, which `knit` interpolates
    found = recover_one(replace(observation, rgb=rgb), "knit")
    middle, edge = found.uncertainty_deg[36:38, 36:38].mean(), found.uncertainty_deg[30, 30:44].mean()
    assert middle > 1.2 * edge > 2 * np.median(found.uncertainty_deg[mask & ~np.isnan(rgb[..., 0])])


def test_stated_errors_grow_with_what_speaks_against_the_estimate():
    worse = replace(evidence(), halves_deg=10 * evidence().halves_deg + 1, turn_moved_deg=5.0)
    own = judged(unjudged(), picture()[0], evidence()).uncertainty_deg
    more = judged(unjudged(), picture()[0], worse).uncertainty_deg
    assert np.nanmedian(more) > 1.3 * np.nanmedian(own)


def test_the_rotations_stated_error_is_of_the_evidence_and_not_far_below_the_methods_own():
    figures = rotation_figures(evidence())
    assert set(figures) == set(weights()["rotation"]["weights"])
    own = evidence().rotation_deg
    turned = replace(
        unjudged(), solution=replace(unjudged().solution, rotation_covariance=np.radians(2.0) ** 2 * np.eye(3))
    )
    worse = replace(evidence(), rotation_deg=np.sqrt(3) * 2.0, halves_deg=5.0, turn_moved_deg=5.0, correlated_deg=2.0)
    better = replace(evidence(), rotation_deg=np.sqrt(3) * 2.0)
    stated = [judged(turned, picture()[0], one).rotation_stderr_deg for one in (better, worse)]
    assert stated[1] > 1.5 * stated[0]
    assert min(stated) >= LEAST_OF_OWN_ROTATION * np.sqrt(3) * 2.0 * (1 - 1e-9)
    far = replace(better, turn_moved_deg=20.0, turn_spread_deg=1.0)  # from the most integrable rotation
    assert judged(turned, picture()[0], far).rotation_stderr_deg == pytest.approx(18.0)
    assert judged(unjudged(), picture()[0], evidence()).rotation_stderr_deg >= LEAST_OF_OWN_ROTATION * own * (1 - 1e-9)


def test_evidence_is_json_whatever_it_is():
    lost = Evidence(**{field.name: float("nan") for field in fields(Evidence)})
    assert json.loads(json.dumps(lost.record())) == {field.name: None for field in fields(Evidence)}


# ---- normals that join the rest --------------------------------------------------------------------------------------


def test_a_patch_of_other_normals_does_not_join_and_a_smooth_shadow_does():
    normals, mask = ball()
    all_lit, shadow, wrong = mask.copy(), np.zeros_like(mask), np.zeros_like(mask)
    shadow[20:50, 40:60] = wrong[30:40, 45:55] = True
    all_lit &= ~shadow
    turned = normals.copy()
    turned[wrong] = normals[wrong] @ Rotation.from_euler("xyz", [40, -35, 0], degrees=True).as_matrix().T
    joined = joined_to(all_lit, turned, mask)
    assert not joined[wrong].any()
    assert joined[mask & ~wrong].all()
    assert np.array_equal(joined_to(all_lit, normals, mask), mask)
    assert np.array_equal(joined_to(np.zeros_like(mask), turned, mask), mask)  # nothing to join to: nothing is told


def test_normals_that_join_nowhere_have_a_large_stated_error_and_count_in_the_evidence():
    observation, normals, mask = picture()
    estimate, wrong = unjudged(), np.zeros_like(mask)
    wrong[30:38, 30:38] = True
    turned = np.where(wrong[..., None], normals @ np.diag([-1.0, 1.0, 1.0]) + [0.9, 0.0, 0.0], estimate.normals)
    turned /= np.linalg.norm(turned, axis=-1, keepdims=True)
    reason = np.where(wrong, Reason.MISSES_LIGHTS, estimate.reason).astype(np.uint8)
    changed = replace(estimate, normals=turned.astype(np.float32), reason=reason, valid=estimate.valid | wrong)
    found = evidence_of(changed, observation)
    assert found.apart == pytest.approx(wrong.sum() / changed.valid.sum(), rel=0.1)
    assert evidence().apart < 0.01
    stated = judged(changed, observation).uncertainty_deg
    assert np.median(stated[wrong]) >= APART_DEG
    assert np.median(stated[changed.valid & ~wrong]) < 5


def test_a_cone_is_not_trusted_since_many_ellipsoids_fit_its_colours():
    y, x = (0.98 - 1.96 * np.mgrid[:72, :72] / 71) * np.array([1, -1])[:, None, None]
    mask, along = np.hypot(x, y) < 0.95, np.maximum(np.hypot(x, y), 1e-9)
    normals = np.dstack([0.7 * x / along, 0.7 * y / along, np.full_like(x, np.sqrt(1 - 0.49))])
    for noise in (3e-4, 1e-3):
        observation = shade(normals, mask, GELS, noise=noise)[0]
        for method in ("weak-integrability", "least-squares"):
            assert METHODS[method](observation).verdict != "trust", (noise, method)
    assert evidence().spread_deg > 5 * (evidence().white_deg + evidence().correlated_deg)
    noisy = replace(evidence(), white_deg=0.2)
    flat = replace(noisy, spread_deg=0.05)
    assert factors_of(flat)["model"] < 0.1 < factors_of(noisy)["model"]
    assert "cone" in FACTORS["model"].told(flat, 1.0)
    assert "cone" not in FACTORS["model"].told(noisy, 1.0)
