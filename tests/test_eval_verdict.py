"""Verdicts in words, errors by what the light does, and stated against true errors, on cases worked by hand."""

from dataclasses import replace

import numpy as np
import pytest

from huesphere.configs.commandline import TERMINAL_WIDTH
from huesphere.eval.calibration import LEAST_PIXELS, calibration_curve, count_errors
from huesphere.eval.maps import STRIPE_EVERY, data_uri, hatched
from huesphere.eval.metrics import Row
from huesphere.eval.regions import errors_by_region, region_map
from huesphere.eval.table import doubted_results, verdict_lines
from huesphere.eval.verdict import DOUBTFUL_DEG, doubtful_pixels, verdict_of
from huesphere.recover.io.estimate import Estimate
from huesphere.recover.reasons import Reason
from huesphere.recover.status import REMEDIES
from huesphere.render.dataset import Truth

NOISY = f"the normals are uncertain (±9°); {REMEDIES['uncertain']}"
TURNED = f"the normals are most integrable when turned by 22°; {REMEDIES['rotation-undetermined']}"


def row(method: str, status: str = "uncertain", verdict: str = "doubtful") -> Row:
    return Row("bump", "full", method, status, verdict=verdict, message=NOISY)


def test_a_doubt_is_told_apart_from_its_remedy_and_no_remedy_is_said_twice():
    verdict = verdict_of(row("a"), (NOISY, TURNED, NOISY.replace("9", "8")))
    assert verdict.word == "doubtful"
    assert verdict.why[0] == "the normals are uncertain (±9°)"
    assert len(verdict.why) == 3
    assert verdict.todo == (REMEDIES["uncertain"], REMEDIES["rotation-undetermined"])


def test_what_is_trusted_has_no_reasons_and_what_was_not_rendered_is_failed():
    assert verdict_of(replace(row("a", "ok", "trust"), message="")).why == ()
    lost = verdict_of(Row("bump", "full", "a", "failed", message="the picture was not rendered"))
    assert (lost.word, lost.why) == ("failed", ("the picture was not rendered",))
    assert verdict_of(Row("bump", "full", "theirs", "ok")).word == ""


def test_the_terminal_says_each_reason_once_within_its_width():
    rows = [row("a"), row("b"), row("c", "ok", "trust")]
    verdicts = [verdict_of(each, (NOISY,) if each.verdict != "trust" else ()) for each in rows]
    lines = verdict_lines(doubted_results(rows, verdicts))
    assert sum("why:" in line for line in lines) == sum("do:" in line for line in lines) == 1
    assert "bump/full a, bump/full b" in lines[0]
    assert not any("bump/full c" in line for line in lines)
    assert max(map(len, lines)) <= TERMINAL_WIDTH


def truth(attached: np.ndarray, cast: np.ndarray) -> Truth:
    height, width = attached.shape[:2]
    normals = np.broadcast_to([0.0, 0.0, 1.0], (height, width, 3))
    return Truth(normals, np.zeros((height, width)), np.ones((height, width), bool), attached, cast)


def test_each_pixel_is_of_one_kind_and_a_half_hidden_light_is_a_cast_shadow():
    attached, cast = np.zeros((1, 5, 2)), np.zeros((1, 5, 2))
    attached[0, 1, 0] = attached[0, 2, 1] = attached[0, 3, 0] = 1.0
    cast[0, 2, 0], cast[0, 4, 1] = 1.0, 0.5
    reason = np.full((1, 5), Reason.ALL_LIT, np.uint8)
    reason[0, 3] = Reason.INTERPOLATED_DARK
    mask = np.ones((1, 5), bool)
    assert region_map(truth(attached, cast), reason, mask).tolist() == [[0, 1, 2, 3, 2]]
    mask[0, 0] = False
    assert region_map(truth(attached, cast), None, mask).tolist() == [[-1, 1, 2, 1, 2]]


def test_errors_of_each_kind_are_over_its_own_pixels():
    kind = np.array([[0, 0, 0, 2, 2, -1]])
    error = np.array([[1.0, 2.0, 6.0, 10.0, np.nan, 50.0]])
    lit, cast = errors_by_region(kind, error, np.array([[1.0, 1.0, 4.0, 7.0, 7.0, 7.0]]))
    assert (lit.region, lit.pixels, lit.coverage, lit.median_deg, lit.mean_deg) == ("lit", 3, 1.0, 2.0, 3.0)
    assert (cast.region, cast.share, cast.coverage, cast.median_deg) == ("cast shadow", 0.4, 0.5, 10.0)
    assert (lit.stated_median_deg, cast.stated_median_deg) == (1.0, 7.0)


@pytest.mark.parametrize("factor", [0.5, 1.0, 3.0])
def test_the_curve_of_errors_that_are_a_multiple_of_the_stated_ones_has_that_slope(factor: float):
    stated = np.geomspace(0.05, 20.0, 20_000)
    curve = calibration_curve([count_errors(stated, factor * stated)])
    assert curve.stated_deg.size >= 12
    inner = slice(1, -1)  # the outermost classes are filled in part
    assert curve.median_deg[inner] / curve.stated_deg[inner] == pytest.approx(factor, rel=0.03)
    assert (curve.low_deg < curve.median_deg).all()
    assert curve.pixels.sum() == 20_000


def test_classes_of_few_pixels_have_no_point_and_what_is_not_stated_is_not_counted():
    stated = np.array([1.0] * (LEAST_PIXELS - 1) + [np.nan] * 100)
    assert count_errors(stated, np.ones_like(stated)).sum() == LEAST_PIXELS - 1
    assert calibration_curve([count_errors(stated, np.ones_like(stated))]).stated_deg.size == 0


def test_doubtful_pixels_are_those_without_a_normal_interpolated_or_uncertain():
    normals = np.broadcast_to([0.0, 0.0, 1.0], (1, 5, 3)).astype(np.float32)
    valid = np.array([[False, True, True, True, True]])
    stated = np.array([[np.nan, DOUBTFUL_DEG, 0.1, 0.1, 0.1]], np.float32)
    codes = [Reason.OUTLIER, Reason.ALL_LIT, Reason.INTERPOLATED, Reason.MISSES_LIGHTS, Reason.ALL_LIT]
    estimate = Estimate("a", "ok", "", normals, valid, valid, stated, reason=np.array([codes], np.uint8))
    mask = np.array([[True, True, True, True, False]])
    assert doubtful_pixels(estimate, mask).tolist() == [[True, True, True, False, False]]


def test_stripes_lie_on_the_hatched_pixels_only_and_are_visible_on_any_ground():
    ground = np.full((40, 40, 3), 128, np.uint8)
    where = np.zeros((40, 40), bool)
    where[:, 20:] = True
    image = hatched(ground, where)
    assert (image[:, :20] == 128).all()
    for shade in (0, 255):
        assert np.mean(image[:, 20:, 0] == shade) == pytest.approx(1 / STRIPE_EVERY, abs=0.02)


def test_the_ground_of_a_map_is_clear_on_the_page():
    import base64
    import io

    from PIL import Image

    image = np.full((8, 8, 3), 255, np.uint8)
    image[2:6, 2:6] = [10, 120, 200]
    text = data_uri(image, 90, clear=True).partition(",")[2]
    alpha = np.asarray(Image.open(io.BytesIO(base64.b64decode(text))).convert("RGBA"))[..., 3]
    assert (alpha[2:6, 2:6] == 255).all()
    assert alpha.sum() == 16 * 255
