"""Sheets of a flat ellipsoid: one a region, opposite ones across the plane between them, the whole by its cost."""

import numpy as np
import pytest

from huesphere.recover.every_pixel.sheets import one_sheet_a_region

ACROSS = np.array([0.0, 0.6, 0.8])  # the normal of the plane in which the two sheets mirror each other


def rolled(shape: tuple[int, int] = (20, 60), *, most: float = 0.9) -> np.ndarray:
    """Unit normals (H, W, 3) whose component across the plane goes from −``most`` at the left to ``most``."""
    component = np.broadcast_to(np.linspace(-most, most, shape[1]), shape)
    along = np.array([1.0, 0.0, 0.0])
    return component[..., None] * ACROSS + np.sqrt(1 - component[..., None] ** 2) * along


def sheets(n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The normals as they are on the two sheets, of which one is known up to the other: (first, second)."""
    component = n @ ACROSS
    away = np.abs(component)[..., None] * ACROSS + n - component[..., None] * ACROSS
    return away, away - 2 * (away @ ACROSS)[..., None] * ACROSS


def chosen(n: np.ndarray, own: np.ndarray, costs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(normals that are chosen (H, W, 3), where that is decided (H, W))."""
    first, second = sheets(n)
    is_second, decided = one_sheet_a_region(first, second, costs, own)
    return np.where(is_second[..., None], second, first), decided


def cheaper_at(n: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Costs (2, H, W) that tell the right sheet at the pixels ``where`` alone."""
    first, second = sheets(n)
    right = np.array([np.linalg.norm(one - n, axis=-1) < 1e-9 for one in (first, second)])
    return np.where(where & ~right, 1.0, 0.0)


def test_a_surface_changes_sheet_where_it_passes_through_the_plane_between_them():
    n = rolled()
    own, told = np.ones(n.shape[:2], bool), np.zeros(n.shape[:2], bool)
    told[5:15, 2:8] = True  # far to one side of the plane, and then to the other
    for where in (told, np.fliplr(told)):
        found, decided = chosen(n, own, cheaper_at(n, where))
        np.testing.assert_allclose(found[decided], n[decided], atol=1e-9)
        np.testing.assert_array_equal(decided, np.abs(n @ ACROSS) > 0.1)


def test_the_sum_of_costs_decides_for_all_regions_that_hang_together():
    """Fewer pixels that say the opposite, as dear as the others, are overruled, on the other side of the plane too."""
    n = rolled()
    own = np.ones(n.shape[:2], bool)
    right, wrong = (np.zeros(n.shape[:2], bool) for _ in range(2))
    right[:12, 2:8], wrong[:8, -8:-2] = True, True
    costs = cheaper_at(n, right) + cheaper_at(n, wrong)[::-1]
    found, decided = chosen(n, own, costs)
    np.testing.assert_allclose(found[decided], n[decided], atol=1e-9)


def test_a_surface_that_comes_near_the_plane_and_turns_back_keeps_its_sheet():
    n = rolled()
    component = np.minimum(np.abs(n @ ACROSS)[..., None] + 0.06, 0.95)
    n = component * ACROSS + np.sqrt(1 - component**2) * np.array([1.0, 0.0, 0.0])
    own, left = np.ones(n.shape[:2], bool), np.zeros(n.shape[:2], bool)
    left[:, :20] = True
    found, decided = chosen(n, own, cheaper_at(n, left)[::-1])
    wrong = np.linalg.norm(found - n, axis=-1) > 0.1
    assert wrong[decided & left].all()  # as the costs say there
    assert not wrong[decided & np.fliplr(left)].any()  # no cost there: the first sheet, whatever the left side has


def test_regions_whose_bands_contradict_each_other_are_undecided():
    """Around a point from which the component grows in three sectors each would be opposite to both others."""
    y, x = np.mgrid[-30:31, -30:31]
    component = 0.6 * np.abs(np.cos(1.5 * np.arctan2(y, x)))
    first = component[..., None] * ACROSS + np.sqrt(1 - component[..., None] ** 2) * np.array([1.0, 0.0, 0.0])
    second = first - 2 * (first @ ACROSS)[..., None] * ACROSS
    own = np.hypot(x, y) > 10
    _, decided = one_sheet_a_region(first, second, np.zeros((2, *own.shape)), own)
    assert not decided.any()


@pytest.mark.parametrize("own", [np.zeros((6, 8), bool), np.ones((6, 8), bool)], ids=["no pixel", "all in the plane"])
def test_nothing_is_decided_where_there_is_nothing_to_decide(own):
    n = np.broadcast_to([1.0, 0.0, 0.0], (*own.shape, 3))
    second, decided = one_sheet_a_region(n, n, np.zeros((2, *own.shape)), own)
    assert not second.any()
    assert not decided.any()
