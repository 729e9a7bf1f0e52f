"""camera.json, there and back, and every way in which it can be wrong."""

import json
from dataclasses import fields, replace

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jshape import D435_NOMINAL, PAPER_BOX
from jshape.camera import PRESETS, Camera
from jshape.data.depth import check_depth_unit
from jshape.errors import BadCamera, BadFile
from jshape.io.cameras import (
    camera_fields,
    camera_from,
    read_camera,
    write_camera,
)

GOOD = {
    "width": 480, "height": 395, "fx": 433.0, "fy": 433, "u0": 240, "v0": -3.5,
    "z_min": 0.42, "z_max": 0.47, "depth_unit": 0.0001,
}  # fmt: skip


def write(path, content):
    path.write_text(json.dumps(content))
    return path


@pytest.mark.parametrize("name", PRESETS)
def test_round_trip(tmp_path, name):
    write_camera(tmp_path / "camera.json", PRESETS[name], 0.0001)
    assert read_camera(tmp_path / "camera.json") == (PRESETS[name], 0.0001)


def test_traced_numbers_are_written_short(tmp_path):
    camera = replace(PAPER_BOX, z_min=jnp.float32(0.42), fx=np.float64(433.25))
    write_camera(tmp_path / "camera.json", camera, 0.001)
    assert json.loads((tmp_path / "camera.json").read_text())["z_min"] == 0.42
    found, unit = read_camera(tmp_path / "camera.json")
    assert (found.z_min, found.fx, unit) == (0.42, 433.25, 0.001)


@settings(max_examples=50)
@given(
    st.builds(
        Camera,
        *[st.integers(1, 5000)] * 2,
        *[st.floats(1, 5000, width=32)] * 2,
        *[st.floats(-5000, 5000, width=32)] * 2,
        z_min=st.floats(0.0625, 1, width=32),
        z_max=st.floats(1.5, 10, width=32),
        bits=st.integers(1, 24),
    )
)
def test_fields_round_trip_exactly(camera):
    assert camera_from(camera_fields(camera), "x") == camera


@pytest.mark.parametrize("value", [0.1, 1 / 3, 433.0, 2e-3])
def test_float32_is_written_short_and_exact(value):
    narrow = replace(PAPER_BOX, fx=jnp.float32(value))
    written = camera_fields(narrow)["fx"]
    assert np.float32(written) == np.float32(value)
    assert len(repr(written)) <= 12


def test_bits_are_optional(tmp_path):
    camera, unit = read_camera(write(tmp_path / "c.json", GOOD))
    assert (camera.bits, unit, camera.v0) == (8, 0.0001, -3.5)
    assert isinstance(camera.fy, float)
    said = {f.name for f in fields(Camera)} - {"orthographic", "lens", "pose"}  # they say nothing
    assert set(camera_fields(camera)) == said


@pytest.mark.parametrize("name", GOOD)
def test_a_missing_field_is_named(tmp_path, name):
    path = write(tmp_path / "c.json", {k: v for k, v in GOOD.items() if k != name})
    with pytest.raises(BadCamera, match=f"missing {name}|{name} is missing") as info:
        read_camera(path)
    assert str(path) in str(info.value)


def test_other_names_of_the_principal_point_are_told_ours(tmp_path):
    theirs = {{"u0": "cx", "v0": "cy"}.get(name, name): value for name, value in GOOD.items()}
    with pytest.raises(BadCamera, match="unknown 'cx', 'cy'; .*did you mean u0, v0"):
        read_camera(write(tmp_path / "c.json", theirs))


@pytest.mark.parametrize("name", [*GOOD, "bits", "depth_unit"])
@pytest.mark.parametrize(
    "value", ["433", None, [1], {"a": 1}, True, 10**400, ""], ids=lambda value: str(value)[:8]
)
def test_a_field_that_is_no_number_is_named(tmp_path, name, value):
    path = write(tmp_path / "c.json", GOOD | {name: value})
    with pytest.raises(BadCamera, match=name) as info:
        read_camera(path)
    assert str(path) in str(info.value) and "\n" not in str(info.value)


@pytest.mark.parametrize(
    "change",
    [
        {"width": 0}, {"width": -480}, {"width": 480.5}, {"height": 0}, {"fx": 0}, {"fy": -433},
        {"z_min": 0}, {"z_min": -1}, {"z_max": -1}, {"z_min": 0.47, "z_max": 0.42},
        {"z_min": 0.5, "z_max": 0.5}, {"bits": 0}, {"bits": 25}, {"bits": 8.5},
        {"depth_unit": 0}, {"depth_unit": -0.001}, {"zmin": 0.4}, {"depthunit": 0.001},
    ],
    ids=str,
)  # fmt: skip
def test_a_field_out_of_range_is_named(tmp_path, change):
    path = write(tmp_path / "c.json", GOOD | change)
    with pytest.raises(BadCamera, match=next(iter(change))) as info:
        read_camera(path)
    assert str(path) in str(info.value) and "\n" not in str(info.value)


def test_a_bad_camera_is_not_written(tmp_path):
    path = tmp_path / "c.json"
    for camera, unit in (
        (replace(D435_NOMINAL, fx=-1.0), 0.001),
        (replace(D435_NOMINAL, fx=float("nan")), 0.001),
        (D435_NOMINAL, float("nan")),
        (D435_NOMINAL, 0.0),
    ):
        with pytest.raises(BadCamera):
            write_camera(path, camera, unit)
    assert not path.exists()


def test_a_missing_unit_is_asked_for(tmp_path):
    path = write(tmp_path / "c.json", {k: v for k, v in GOOD.items() if k != "depth_unit"})
    with pytest.raises(BadCamera, match="depth_unit is missing: metres per count of the frames$"):
        read_camera(path)
    assert read_camera(path, 0.5)[1] == 0.5


def test_no_file(tmp_path):
    with pytest.raises(BadFile, match="no such file"):
        read_camera(tmp_path / "none.json")
    (tmp_path / "nan.json").write_text('{"width": NaN}')
    with pytest.raises(BadFile, match="NaN"):
        read_camera(tmp_path / "nan.json")


def test_the_cameras_of_shared_data(shared_data):
    found = sorted(shared_data.glob("mpm/*/*/camera.json"))
    assert found
    for path in found:
        camera, unit = read_camera(path)
        assert camera == PAPER_BOX and unit == 0.0001


@pytest.mark.parametrize("unit", [0, -1, "0.001", None, True, float("nan"), [1]])
def test_a_depth_unit_is_a_positive_number(unit):
    with pytest.raises(BadCamera, match="here: depth_unit"):
        check_depth_unit(unit, "here")
    assert check_depth_unit(np.float32(0.5), "here") == 0.5
