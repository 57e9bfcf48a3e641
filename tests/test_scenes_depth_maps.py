"""Depth maps from files: gaps are no surface, numbers are read as they were written, the sign is known or said."""

import numpy as np
import pytest

from huesphere.configs.errors import InputError
from huesphere.scenes.depth_maps.read import read_depth_map

SIDE = 40


def dome():
    """(depth of a cap, 6 to 14 steps high; the disc that it covers), (SIDE, SIDE) each."""
    rows, cols = np.indices((SIDE, SIDE)) - (SIDE - 1) / 2
    r = np.hypot(rows, cols) / 15
    return 6 + 8 * np.sqrt(np.clip(1 - r**2, 0, None)), r < 1


def with_gaps(gap, dtype=np.float64):
    depth, disc = dome()
    return np.where(disc, depth, gap).astype(dtype), disc


def write_exr(path, parts):
    import OpenEXR

    OpenEXR.File(
        [
            OpenEXR.Part(
                {"type": OpenEXR.scanlineimage}, {n: np.ascontiguousarray(v) for n, v in part.items()}, f"p{k}"
            )
            for k, part in enumerate(parts)
        ]
    ).write(str(path))


def read(path, **options):
    lines: list[str] = []
    return read_depth_map(path, log=lines.append, **options), "\n".join(lines)


# ---- samples that are no surface -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("gap", "dtype"),
    [
        (-9999, np.float32),
        (65535, np.uint16),
        (255, np.uint8),
        (-32768, np.int16),
        (32767, np.int16),
        (65504, np.float16),
        (65504, np.float32),
        (1e10, np.float32),
        (np.finfo(np.float32).max, np.float32),
        (np.finfo(np.float64).min, np.float64),
        (-500, np.float64),
        (-1, np.float32),
        (np.inf, np.float32),
        (0, np.float64),
    ],
)
def test_a_value_far_outside_the_others_is_background_and_said(tmp_path, gap, dtype):
    depth, disc = with_gaps(gap, dtype)
    np.save(tmp_path / "z.npy", depth)
    grid, said = read(tmp_path / "z.npy")
    assert np.array_equal(grid.mask, disc)
    assert np.isinf(gap) or f"{dtype(gap):.10g}" in said


def test_several_marks_are_all_background(tmp_path):
    depth, disc = with_gaps(-9999)
    depth[:4] = 1e10
    depth[-4:] = 0
    np.save(tmp_path / "z.npy", depth)
    assert np.array_equal(read(tmp_path / "z.npy")[0].mask, disc)


@pytest.mark.parametrize("largest", [255, 200])
def test_a_map_that_fills_its_type_has_no_gap(tmp_path, largest):
    depth, _ = dome()
    scaled = np.round(1 + (depth - 6) / 8 * (largest - 1)).astype(np.uint8)
    np.save(tmp_path / "z.npy", scaled)
    assert read(tmp_path / "z.npy")[0].mask.all()


def test_a_floor_is_surface(tmp_path):
    np.save(tmp_path / "z.npy", dome()[0])  # half of it is 6 exactly
    grid, said = read(tmp_path / "z.npy")
    assert grid.mask.all()
    assert "kept" not in said


def test_a_plateau_apart_from_the_rest_is_kept_and_asked_about(tmp_path):
    np.save(tmp_path / "z.npy", with_gaps(15.5)[0])
    grid, said = read(tmp_path / "z.npy")
    assert grid.mask.all()
    assert "15.5 is kept as a depth although it fills 55% of the map" in said


def test_zero_is_a_height_where_nan_marks_the_gaps(tmp_path):
    depth, disc = with_gaps(np.nan)
    depth[18:22, 18:22] = 0
    np.save(tmp_path / "z.npy", depth)
    grid, said = read(tmp_path / "z.npy")
    assert np.array_equal(grid.mask, disc)
    assert "16 samples" in said
    assert "0 is kept" in said
    zero_too = read(tmp_path / "z.npy", no_data=0.0)[0]
    assert zero_too.mask.sum() == disc.sum() - 16


def test_zeros_that_heights_pass_through_are_heights(tmp_path):
    rows, cols = np.indices((SIDE, SIDE)) - SIDE // 2
    depth = (rows / 4 + np.sin(cols)) * 1.0
    assert (depth == 0).sum() == 1
    np.save(tmp_path / "z.npy", depth)
    assert read(tmp_path / "z.npy")[0].mask.all()


def test_the_key_no_data_is_obeyed(tmp_path):
    depth, disc = with_gaps(7.25, np.float32)
    np.save(tmp_path / "z.npy", depth)
    assert read(tmp_path / "z.npy")[0].mask.all()
    assert np.array_equal(read(tmp_path / "z.npy", no_data=7.25)[0].mask, disc)
    two = np.where(dome()[1], depth, -3)
    two[:2] = 99.1
    np.save(tmp_path / "two.npy", two.astype(np.float32))
    assert np.array_equal(read(tmp_path / "two.npy", no_data=(-3.0, 99.1))[0].mask, disc)
    np.save(tmp_path / "far.npy", with_gaps(-9999)[0])
    assert read(tmp_path / "far.npy", no_data="none")[0].mask.all()


@pytest.mark.parametrize(("tag", "gap"), [("-77.5", -77.5), ("6.5\0", 6.5), ("-3.4028234663852886e+38", -3.4028235e38)])
def test_the_tag_of_a_tiff_is_obeyed(tmp_path, tag, gap):
    import tifffile

    depth, disc = with_gaps(gap, np.float32)
    tifffile.imwrite(tmp_path / "z.tif", depth, extratags=[(42113, "s", 0, tag, True)])
    grid, said = read(tmp_path / "z.tif")
    assert np.array_equal(grid.mask, disc)
    assert "as the file says" in said


def test_a_tag_that_is_no_number_is_refused(tmp_path):
    import tifffile

    tifffile.imwrite(tmp_path / "z.tif", dome()[0].astype(np.float32), extratags=[(42113, "s", 0, "none", True)])
    with pytest.raises(InputError, match="GDAL_NODATA"):
        read(tmp_path / "z.tif")


def test_a_mask_in_the_file_decides_alone(tmp_path):
    depth, disc = with_gaps(-9999)
    np.savez(tmp_path / "z.npz", depth=np.where(disc, depth - 6, depth), mask=disc)
    assert np.array_equal(read(tmp_path / "z.npz")[0].mask, disc)


# ---- text ----------------------------------------------------------------------------------------------------------


def text_of(depth, separator, comma=False):
    rows = [separator.join(f"{x:.4f}" for x in row) for row in depth]
    return "\n".join(row.replace(".", ",") if comma else row for row in rows) + "\n"


@pytest.mark.parametrize(
    ("separator", "comma"),
    [
        *((separator, False) for separator in (" ", "\t", ",", ", ", " , ", ";")),
        *((separator, True) for separator in (" ", "\t", ";", "; ")),
    ],
)
def test_text_is_read_whatever_separates_its_numbers(tmp_path, separator, comma):
    depth, disc = with_gaps(0)
    (tmp_path / "z.txt").write_text(text_of(depth, separator, comma))
    grid, said = read(tmp_path / "z.txt")
    assert np.array_equal(grid.mask, disc)
    assert np.abs(grid.depth - depth)[disc].max() < 1e-4
    assert ("decimal commas" in said) == comma


def test_empty_cells_are_gaps_and_a_trailing_separator_is_none(tmp_path):
    depth, disc = with_gaps(0)
    rows = [",".join(f"{x:.3f}" if inside else "" for x, inside in zip(*two)) for two in zip(depth, disc)]
    (tmp_path / "z.csv").write_text("\n".join(rows))
    assert np.array_equal(read(tmp_path / "z.csv")[0].mask, disc)
    (tmp_path / "t.csv").write_text("\n".join(row + "," for row in text_of(depth, ",").split()))
    assert np.array_equal(read(tmp_path / "t.csv")[0].mask, disc)


@pytest.mark.parametrize("row", ["1.5 2,5 3.5", "1,234.5 2,345.6", "1,2,3 4,5,6", "1, 2 3, 4", "1,5;2.5"])
def test_text_that_could_be_read_in_two_ways_is_refused(tmp_path, row):
    (tmp_path / "z.txt").write_text("\n".join([row] * 20))
    with pytest.raises(InputError, match="two ways"):
        read(tmp_path / "z.txt")


def esri(depth, gap, cell="2", extra=""):
    head = f"NCOLS {depth.shape[1]}\nnrows {depth.shape[0]}\nxllcenter 5000\nyllcenter 0\ncellsize {cell}\n{extra}"
    return head + "\n".join(" ".join(f"{x:.4f}" for x in row) for row in np.nan_to_num(depth, nan=gap)) + "\n"


@pytest.mark.parametrize(("extra", "gap"), [("NODATA_value -1\n", -1), ("nodata_value 9\n", 9), ("", -9999)])
def test_an_esri_grid_is_read_with_its_header(tmp_path, extra, gap):
    depth, disc = with_gaps(np.nan)
    (tmp_path / "z.asc").write_text(esri(depth, gap, extra=extra))
    grid, _ = read(tmp_path / "z.asc")
    assert np.array_equal(grid.mask, disc)
    assert np.abs(grid.depth - depth / 2)[disc].max() < 1e-4  # a cell is 2 units wide
    unscaled, _ = read(tmp_path / "z.asc", depth_scale=1.0)
    assert np.abs(unscaled.depth - depth)[disc].max() < 1e-4


@pytest.mark.parametrize("change", [("nrows 40", "nrows 41"), ("nrows 40", "nrows x"), ("cellsize 2", "dx 1\ndy 3")])
def test_a_wrong_header_of_an_esri_grid_is_refused(tmp_path, change):
    text = esri(dome()[0], 0).replace(*change)
    (tmp_path / "z.asc").write_text(text)
    with pytest.raises(InputError, match=r"z\.asc"):
        read(tmp_path / "z.asc")


@pytest.mark.parametrize("suffix", [".txt", ".npy"])
def test_points_on_a_grid_are_that_grid_with_y_up(tmp_path, suffix):
    depth, disc = with_gaps(np.nan)
    depth[10, 20] = 13.75  # no longer symmetric
    rows, cols = np.nonzero(disc)
    points = np.stack([100 + 0.5 * cols, -0.5 * rows, 0.5 * depth[disc]], axis=1)
    points = np.random.default_rng(1).permutation(points)
    path = tmp_path / f"z{suffix}"
    np.savetxt(path, points, header="x y z", comments="") if suffix == ".txt" else np.save(path, points)
    grid, said = read(path)
    top, left = rows.min(), cols.min()
    cut = depth[top : rows.max() + 1, left : cols.max() + 1]
    assert np.array_equal(grid.mask, np.isfinite(cut))
    assert np.abs(grid.depth - cut)[grid.mask].max() < 1e-6
    assert "x y z" in said


def test_points_off_a_grid_are_refused(tmp_path):
    points = np.random.default_rng(0).random((500, 3))
    np.savetxt(tmp_path / "z.txt", points)
    with pytest.raises(InputError, match="list of points"):
        read(tmp_path / "z.txt")


# ---- EXR -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "part",
    [
        ("Z",),
        ("ViewLayer.Depth.Z",),
        ("ViewLayer.Depth.V",),
        ("View.Depth.Z", "View.Normal.X", "View.Normal.Y", "View.Normal.Z"),
        ("R", "G", "B", "Z"),
        ("a.depth.Z", "b.Mist.Z"),
    ],
)
def test_the_distance_of_a_renderer_is_turned_into_height(tmp_path, part):
    depth, disc = dome()
    distance = np.where(disc, 50 - depth, np.inf).astype(np.float32)
    channels = {name: np.full_like(distance, 0.5) for name in part}
    channels[next(n for n in part if n[-1] in "ZV" and "Normal" not in n)] = distance
    write_exr(tmp_path / "z.exr", [channels])
    grid, said = read(tmp_path / "z.exr")
    assert np.array_equal(grid.mask, disc)
    assert np.abs(grid.depth - (depth - 50))[disc].max() < 1e-4
    assert "away from the camera" in said
    hollow, _ = read(tmp_path / "z.exr", toward_camera=True)
    assert np.abs(hollow.depth + grid.depth)[disc].max() < 1e-6


def test_depth_of_this_project_grows_toward_the_camera(tmp_path):
    depth, _ = dome()
    write_exr(tmp_path / "z.exr", [{"depth.Z": depth.astype(np.float32)}])
    grid, said = read(tmp_path / "z.exr")
    assert np.abs(grid.depth - depth).max() < 1e-5
    assert "growing toward the camera" in said


def test_depth_is_found_in_another_part(tmp_path):
    depth, _ = dome()
    write_exr(
        tmp_path / "z.exr", [{c: np.zeros((SIDE, SIDE), np.float32) for c in "RGB"}, {"Z": depth.astype(np.float32)}]
    )
    assert np.abs(read(tmp_path / "z.exr")[0].depth + depth).max() < 1e-5


def test_several_channels_that_may_be_depth_are_asked_about(tmp_path):
    depth = dome()[0].astype(np.float32)
    write_exr(tmp_path / "z.exr", [{"a.Z": depth, "b.Z": 2 * depth, "N.X": depth, "N.Y": depth, "N.Z": depth}])
    with pytest.raises(InputError, match=r"a\.Z, b\.Z.*shape\.channel"):
        read(tmp_path / "z.exr")
    assert np.abs(read(tmp_path / "z.exr", channel="b.Z")[0].depth + 2 * depth).max() < 1e-5
    with pytest.raises(InputError, match="expected one of"):
        read(tmp_path / "z.exr", channel="c.Z")


def test_colours_are_no_depth(tmp_path):
    depth = dome()[0].astype(np.float32)
    write_exr(tmp_path / "z.exr", [{"R": depth, "G": depth, "B": depth}])
    assert np.abs(read(tmp_path / "z.exr")[0].depth - depth).max() < 1e-5
    write_exr(tmp_path / "z.exr", [{"R": depth, "G": 2 * depth, "B": depth}])
    with pytest.raises(InputError, match="no depth channel"):
        read(tmp_path / "z.exr")
