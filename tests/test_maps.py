"""Height maps on disk: to the last bit, and every damage in one line."""

import numpy as np
import pytest

from jshape import HeightMap
from jshape.errors import BadFile, BadImage
from jshape.height_map import as_frame
from jshape.io.maps import read_map, write_map

FRAME = np.array([[0, -1, 0, 0.3], [1, 0, 0, 0.1], [0, 0, 1, 0.8], [0, 0, 0, 1]], float)


@pytest.fixture
def found(rng):
    heights = (0.01 * rng.standard_normal((6, 9))).astype(np.float32)
    heights[0, :3] = np.nan
    seen = np.isfinite(heights)
    seen[4, 4] = False
    return HeightMap(heights, 0.0013, (-0.017, 0.4), seen, as_frame(FRAME))


@pytest.fixture
def arrays(found, tmp_path):
    """What a map's file holds."""
    write_map(tmp_path / "map.npz", found)
    with np.load(tmp_path / "map.npz", allow_pickle=False) as file:
        return dict(file)


def test_a_map_comes_back_to_the_bit(found, tmp_path):
    write_map(tmp_path / "map.npz", found)
    again = read_map(tmp_path / "map.npz")
    np.testing.assert_array_equal(again.heights, found.heights)
    np.testing.assert_array_equal(again.mask, found.mask)
    assert (again.pitch, again.origin, again.frame) == (found.pitch, found.origin, found.frame)
    assert [path.name for path in tmp_path.iterdir()] == ["map.npz"]


def test_the_file_is_that_of_the_contract(arrays):
    assert sorted(arrays) == ["frame", "height_m", "pitch_m", "seen", "x_m", "y_m"]
    assert arrays["height_m"].shape == (6, 9) == arrays["seen"].shape
    np.testing.assert_allclose(arrays["x_m"], -0.017 + 0.0013 * np.arange(9))
    np.testing.assert_allclose(arrays["y_m"], 0.4 + 0.0013 * np.arange(6))
    np.testing.assert_array_equal(arrays["frame"], FRAME)


def test_somebody_elses_numbers_are_read(tmp_path, arrays):
    del arrays["frame"]
    heights, seen = arrays["height_m"].astype(">f8"), arrays["seen"].astype(np.uint8)
    arrays |= {"seen": seen, "height_m": heights, "pitch_m": np.array([0.0013]), "note": seen[0]}
    np.savez(tmp_path / "own.npz", **arrays)
    again = read_map(tmp_path / "own.npz")
    assert again.frame is None and again.heights.dtype == np.float32
    np.testing.assert_array_equal(again.mask, arrays["seen"] > 0)


WRONG = {
    "no heights": ({"height_m": None}, "has no height_m, so it is no height map; it holds"),
    "no pitch": ({"pitch_m": None}, "has no pitch_m"),
    "one row": (
        {"height_m": np.zeros(9)},
        r"shape \(9,\); expected metres as floats of",
    ),
    "counts": ({"height_m": np.zeros((6, 9), np.uint16)}, "height_m is uint16"),
    "turned": ({"seen": np.ones((9, 6), bool)}, r"seen is bool of shape \(9, 6\); .* \(6, 9\)"),
    "shares": ({"seen": np.ones((6, 9))}, "seen is float64"),
    "x and y swapped": (
        {"x_m": np.arange(6) * 0.0013},
        r"x_m is .*; expected metres of shape \(9,",
    ),
    "another pitch": ({"pitch_m": 0.0014}, "x_m goes up in steps of 0.0013, .* pitch_m is 0.0014;"),
    "x in mm": ({"x_m": np.arange(9) * 1.3}, "steps of 1.3, .*; all are metres"),
    "pitch in mm": ({"pitch_m": 1.3}, "pitch_m is 1.3; all are metres"),
    "uneven": ({"y_m": 0.0013 * np.arange(6) ** 1.1}, "y_m goes up in steps of"),
    "NaN in x": ({"x_m": np.full(9, np.nan)}, "x_m goes up in steps of nan"),
    "two pitches": ({"pitch_m": np.ones(2)}, r"pitch_m is float64 of shape \(2,\)"),
    "no pitch at all": ({"pitch_m": np.nan}, "pitch_m is nan"),
    "all in mm": ({"height_m": np.arange(54.0).reshape(6, 9)}, "heights span .*; they are in metr"),
    "nothing seen": ({"seen": np.zeros((6, 9), bool)}, "no height is known"),
    "seen unknown": (
        {"height_m": np.full((6, 9), np.nan), "seen": np.ones((6, 9), bool)},
        "seen is true at 54 nodes without a height",
    ),
    "no rotation": ({"frame": 2 * np.eye(4)}, "frame is .*; it must be the 4x4 matrix of a rotati"),
    "frame of 3": ({"frame": np.eye(3)}, "frame is .*; it must be the 4x4"),
    "frame in mm": ({"frame": np.eye(4) + np.eye(4, k=3) * 300}, "frame moves by 300; .* in metre"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_no_map_is_refused(case, tmp_path, arrays):
    wrong, match = WRONG[case]
    kept = {name: value for name, value in (arrays | wrong).items() if value is not None}
    np.savez(tmp_path / "x.npz", **kept)
    refused(tmp_path / "x.npz", match)


def refused(path, match):
    with pytest.raises(BadFile, match=match) as found:
        read_map(path)
    assert "\n" not in str(found.value) and str(path) in str(found.value)


def test_damaged_files_are_refused(tmp_path, found):
    path = tmp_path / "x.npz"
    refused(path, "no such file")
    write_map(path, found)
    path.write_bytes(path.read_bytes()[:300])
    refused(path, "not a readable NPZ")
    np.savez(path, height_m=np.array([{}], object))
    refused(path, "Object arrays cannot be loaded")


def test_no_map_is_not_written(tmp_path, found):
    with pytest.raises(BadImage, match="pitch is 1.3; expected 0.00001 to 0.1"):
        write_map(tmp_path / "x.npz", HeightMap(found.heights, 1.3))
    assert not list(tmp_path.iterdir())
