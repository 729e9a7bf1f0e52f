"""The RealSense camera on the SDK itself: a software device, real filters, real recordings."""

import gc
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

from jshape import D435_BAZAR, Camera
from jshape.errors import BadCamera, BadFile, JShapeError
from jshape.robot.cameras import realsense
from jshape.robot.cameras.base import CameraLost, CameraSettings, EndOfFrames, look
from jshape.robot.cameras.names import open_camera
from jshape.robot.cameras.realsense import played, realsense_camera

rs = pytest.importorskip("pyrealsense2")

from tests.virtual_realsense import SERIAL, Virtual, record  # noqa: E402

SMALL = Camera(64, 48, 60.0, 61.0, 31.0, 24.0, 0.42, 0.47)
UNIT = 1e-4


def noisy(rng, count, shape=SMALL.shape, holes=0.0, std=5.0):
    frames = np.rint(4500 + rng.normal(0, std, (count, *shape))).astype(np.uint16)
    frames[rng.random(frames.shape) < holes] = 0
    return frames


def through(frames, camera=SMALL, unit=UNIT, **options):
    """What comes out of the camera of what is pushed into the virtual device."""
    device = Virtual(camera, unit)
    with realsense_camera(device.source(), **options) as seen:
        out = []
        for counts in frames:
            device.push(counts)
            out.append(seen.frame())
    device.stop()
    return seen, np.stack(out)


def test_a_virtual_d435_says_what_it_is_and_shows_what_is_pushed(rng):
    frames = noisy(rng, 5, D435_BAZAR.shape)
    seen, out = through(frames, D435_BAZAR, temporal=False)
    assert seen.camera == D435_BAZAR and seen.depth_unit == 1e-4
    assert seen.name == f"virtual D435 {SERIAL}" and seen.live
    np.testing.assert_array_equal(out, frames)


@pytest.mark.parametrize("unit", [1e-3, 1e-4, 2.5e-4])
def test_the_unit_is_the_devices(unit, rng):
    seen, _ = through(noisy(rng, 1), unit=unit)
    assert seen.depth_unit == unit


def test_the_sdks_temporal_filter_smooths_and_bridges_gaps(rng):
    frames = noisy(rng, 20, holes=0.1)
    frames[:, :10, :10] = 0  # never read
    _, out = through(frames, temporal=True)
    plain, smooth = (np.where(f > 0, f.astype(float), np.nan)[10:, 10:] for f in (frames, out))
    # An exponential mean with weight a has sqrt(a / (2 - a)) of the noise: half of it.
    assert np.nanstd(smooth, 0).mean() < 0.6 * np.nanstd(plain, 0).mean()
    assert (out[10:, 10:] == 0).mean() < 0.02 < (frames[10:, 10:] == 0).mean()
    assert not out[:, :10, :10].any(), "it invents nothing where nothing was ever read"


def test_a_step_of_more_than_the_filters_reach_is_taken_at_once(rng):
    low, high = noisy(rng, 8, std=0), noisy(rng, 2, std=0) - 150  # 15 mm
    _, out = through(np.concatenate([low, high]))
    assert (out[8] == 4350).all()
    _, out = through(np.concatenate([low, low[:2] - 50]))  # 5 mm: smoothed
    assert (np.abs(out[8].astype(int) - 4480) <= 1).all()


def test_hole_filling_is_the_sdks_and_off_unless_asked_for(rng):
    frames = noisy(rng, 2, holes=0.1)
    _, plain = through(frames, temporal=False)
    _, filled = through(frames, temporal=False, holes=True)
    assert (plain[:, 1:-1, 1:] == 0).mean() > 0.08 and (filled[:, 1:-1, 1:] == 0).mean() < 0.001
    kept = plain > 0
    np.testing.assert_array_equal(filled[kept], plain[kept])


def test_a_look_through_the_device_is_a_median_in_metres(rng):
    device = Virtual(SMALL, UNIT)
    for counts in noisy(rng, 15):
        device.push(counts)
    with realsense_camera(device.source()) as camera:
        depth = look(camera)
    assert np.abs(depth - 0.45).max() < 0.001 and depth.std() < 0.0003


def test_sixty_per_cent_missing_comes_as_missing(rng):
    frames = noisy(rng, 15)
    frames[:, :, : int(0.6 * SMALL.width)] = 0
    device = Virtual(SMALL, UNIT)
    for counts in frames:
        device.push(counts)
    with realsense_camera(device.source()) as camera:
        assert np.isclose((look(camera) == 0).mean(), 0.6, atol=0.02)


def test_a_frozen_device_is_lost(rng):
    same = noisy(rng, 1)[0]
    device = Virtual(SMALL, UNIT)
    for _ in range(15):
        device.push(same)
    with realsense_camera(device.source()) as camera:
        with pytest.raises(CameraLost, match="virtual D435 .*: 15 frames are the same to the bit"):
            look(camera)


def test_an_unplugged_device_is_lost(rng):
    device = Virtual(SMALL, UNIT)
    device.push(noisy(rng, 1)[0])
    with realsense_camera(device.source(), timeout=0.25) as camera:
        camera.frame()
        device.started.stop()
        with pytest.raises(CameraLost, match=r"sent nothing for 0.25 s; is it unplugged\?"):
            camera.frame()


def test_a_device_that_fails_is_lost():
    device = Virtual(SMALL, UNIT)

    def wait(milliseconds):
        raise RuntimeError("Device\ndisconnected")

    with realsense_camera(device.source()._replace(wait=wait)) as camera:
        with pytest.raises(CameraLost, match="is lost: Device disconnected"):
            camera.frame()


@pytest.mark.parametrize("lens, match", [({"fx": -60.0}, "fx is -60.0"), ({"fy": 0.0}, "fy is 0")])
def test_wrong_intrinsics_are_refused(lens, match):
    device = Virtual(replace(SMALL, **lens), UNIT)
    with pytest.raises(BadCamera, match=f"virtual D435 {SERIAL}: {match}"):
        realsense_camera(device.source())


def test_a_lens_is_the_sdks():
    coeffs = (0.08, -0.2, 1e-3, -2e-3, 0.05)
    device = Virtual(SMALL, UNIT, coeffs=coeffs)
    camera = realsense_camera(device.source()).camera
    np.testing.assert_allclose(camera.lens, (*coeffs, 0, 0, 0), rtol=1e-6)
    lens = device.profile.as_video_stream_profile().get_intrinsics()
    point = [0.11, -0.07, 0.4]
    theirs = rs.rs2_project_point_to_pixel(lens, point)
    np.testing.assert_allclose(camera.pixel(*point), theirs, atol=1e-3)


@pytest.mark.parametrize("model", ["inverse_brown_conrady", "modified_brown_conrady"])
def test_lenses_of_other_models_are_refused_unless_they_are_straight(model):
    model = getattr(rs.distortion, model)
    device = Virtual(SMALL, UNIT, coeffs=(0.1, 0.0, 0.0, 0.0, 0.0), model=model)
    with pytest.raises(BadCamera, match="brown_conrady, of which none but brown_conrady is read"):
        realsense_camera(device.source())
    straight = Virtual(SMALL, UNIT, model=model)
    assert realsense_camera(straight.source()).camera.lens is None


# Recordings of the SDK.


@pytest.fixture
def recorded(tmp_path, rng):
    frames = noisy(rng, 12, D435_BAZAR.shape)
    record(tmp_path / "rec.db3", D435_BAZAR, UNIT, frames)
    return tmp_path / "rec.db3", frames


def test_a_recording_comes_back_to_the_bit_however_slowly_it_is_asked(recorded):
    path, frames = recorded
    with realsense_camera(played(path), temporal=False) as camera:
        assert camera.camera == D435_BAZAR and camera.depth_unit == UNIT and not camera.live
        assert camera.name == f"virtual D435 {SERIAL}"
        for k, counts in enumerate(frames):
            np.testing.assert_array_equal(camera.frame(), counts)
            if k < 3:
                time.sleep(0.1)  # three frames long
        for _ in range(2):
            with pytest.raises(EndOfFrames, match="no more frames"):
                camera.frame()
    with realsense_camera(played(path), temporal=False) as camera:  # closed early: anew
        np.testing.assert_array_equal(camera.frame(), frames[0])


def test_a_recording_through_the_filter_is_what_was_live(recorded):
    path, frames = recorded
    _, live = through(frames, D435_BAZAR)
    with realsense_camera(played(path)) as camera:
        out = np.stack([camera.frame() for _ in frames])
    np.testing.assert_array_equal(out, live)
    assert (live != frames).mean() > 0.5


def test_recordings_by_name_with_a_camera_of_ones_own(recorded):
    path, frames = recorded
    mine = replace(D435_BAZAR, fx=440.0, z_min=0.3, z_max=1.0)
    with open_camera(f"realsense:{path}", CameraSettings((mine, 0.001))) as camera:
        assert camera.camera == mine and camera.depth_unit == UNIT
        np.testing.assert_array_equal(camera.frame(), frames[0])
    with pytest.raises(BadCamera, match="848x480 pixels; the camera given for it makes 64x48"):
        open_camera(f"realsense:{path}", CameraSettings((SMALL, 0.001)))


def test_recordings_that_cannot_be_played(recorded, tmp_path):
    path, _ = recorded
    data = path.read_bytes()

    def refused(match, file):
        with pytest.raises(BadFile, match=match) as found:
            realsense_camera(played(file))
        message = str(found.value)
        assert "\n" not in message and file.name in message and len(message) < 400

    (tmp_path / "cut.db3").write_bytes(data[: len(data) // 2])
    (tmp_path / "junk.db3").write_bytes(b"x" * 5000)
    (tmp_path / "junk.bag").write_bytes(b"x" * 5000)
    (tmp_path / "empty.db3").write_bytes(b"")
    (tmp_path / "other.mcap").write_bytes(data)
    for name in ("cut.db3", "junk.db3", "junk.bag", "empty.db3"):
        refused("not a recording of the RealSense SDK with depth, or damaged", tmp_path / name)
    refused("no such file", tmp_path / "none.db3")
    refused("the SDK's recordings are .db3 or .bag", tmp_path / "other.mcap")
    gc.collect()  # what the SDK holds of a damaged file goes without a noise


# Nothing plugged in, nothing installed.


def test_no_device_is_said_at_once(monkeypatch):
    monkeypatch.setattr(realsense, "devices", list)
    start = time.monotonic()
    with pytest.raises(CameraLost, match="^no RealSense camera is connected$"):
        open_camera("realsense")
    assert time.monotonic() - start < 2
    other = [realsense.Device("Intel RealSense D435", "42")]
    monkeypatch.setattr(realsense, "devices", lambda: other)
    with pytest.raises(CameraLost, match="camera 7 is connected; there is Intel RealSense D435 42"):
        open_camera("realsense:7")


def test_devices_can_be_listed():
    assert isinstance(realsense.devices(), list)


def test_no_sdk_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    for text in ("realsense", "realsense:42", f"realsense:{tmp_path}/rec.db3"):
        with pytest.raises(JShapeError) as found:
            open_camera(text)
        assert "pip install 'jshape[realsense]'" in str(found.value)
        assert "libusb-1.0-0" in str(found.value) and "\n" not in str(found.value)
