"""What every depth camera keeps, and what each of those over files and simulations does."""

import json
import sys
from dataclasses import replace

import cv2
import jax
import numpy as np
import pytest

from jshape import PAPER_BOX, Camera, sim
from jshape.camera import D435_BAZAR
from jshape.data.missing import fill_missing
from jshape.errors import BadCamera, BadDataset, BadFile, BadImage, JShapeError, MissingDepth
from jshape.io.cameras import read_camera, write_camera
from jshape.io.recordings import recording_writer
from jshape.robot.cameras.base import (
    AS_THEY_SAY,
    CameraLost,
    CameraSettings,
    DepthCamera,
    EndOfFrames,
    look,
)
from jshape.robot.cameras.files import bag_camera, folder_camera, picture_camera
from jshape.robot.cameras.names import names, open_camera
from jshape.robot.cameras.played import Played, windowed
from jshape.robot.cameras.realsense import played, realsense_camera
from jshape.robot.cameras.simulated import levelled_world, simulated_camera
from tests.seen_beds import above_simulated

SMALL = Camera(64, 48, 60.0, 61.0, 31.0, 24.0, 0.42, 0.47)
COUNT = 6


def scene(rng, unit, count=COUNT):
    """Frames of a tilted bed with noise and a corner without readings."""
    ramp = 0.45 + 0.01 * np.linspace(-1, 1, SMALL.width)
    noisy = ramp + rng.normal(0, 0.0005, (count, *SMALL.shape))
    frames = np.rint(noisy / unit).astype(np.uint16)
    frames[:, :5, :5] = 0
    return frames


def realsense(path, frames):
    pytest.importorskip("pyrealsense2")
    from tests.virtual_realsense import Virtual

    device = Virtual(SMALL, 1e-4)
    for counts in frames:
        device.push(counts)
    opened = realsense_camera(device.source(), temporal=False, timeout=0.3)
    opened.device = device  # it must live as long
    return opened


def realsense_file(path, frames):
    pytest.importorskip("pyrealsense2")
    from tests.virtual_realsense import record

    record(path / "rec.db3", SMALL, 1e-4, frames)
    return realsense_camera(played(path / "rec.db3"), temporal=False)


def bag(how):
    def make(path, frames):
        pytest.importorskip("rosbags")
        from tests.written_bags import depth_bag

        return bag_camera(depth_bag(path / "bag", how, SMALL, frames))

    return make


def folder(path, frames):
    with recording_writer(path / "rec", SMALL, 1e-4) as add:
        for counts in frames:
            add(counts)
    return folder_camera(path / "rec")


def picture(path, frames):
    cv2.imwrite(str(path / "one.png"), frames[0])
    write_camera(path / "camera.json", SMALL, 1e-4)
    return picture_camera(path / "one.png")


def window(path, frames):
    return windowed(folder(path, frames), 0, 0, *SMALL.shape[::-1])


CAMERAS = {
    "realsense": (realsense, 1e-4),
    "realsense file": (realsense_file, 1e-4),
    "ROS 1": (bag("ros1"), 1e-3),
    "ROS 2": (bag("ros2"), 1e-3),
    "MCAP": (bag("mcap"), 1e-3),
    "folder": (folder, 1e-4),
    "window": (window, 1e-4),
    "picture": (picture, 1e-4),
}
"""A new camera is a row here: something that shows frames which the test made, and its unit."""


@pytest.mark.parametrize("name", CAMERAS)
def test_every_camera_shows_the_frames_to_the_bit_and_ends_as_it_should(name, tmp_path, rng):
    make, unit = CAMERAS[name]
    frames = scene(rng, unit)
    opened = make(tmp_path, frames)
    assert isinstance(opened, DepthCamera)
    with opened as camera:
        assert camera is opened and camera.name and "\n" not in camera.name
        assert camera.depth_unit == unit and type(camera.depth_unit) is float
        for field in ("width", "height", "fx", "fy", "u0", "v0", "z_min", "z_max"):
            assert float(getattr(camera.camera, field)) == pytest.approx(
                float(getattr(SMALL, field))
            )
        for expected in frames:
            counts = camera.frame()
            assert counts.dtype == np.uint16 and counts.flags.writeable
            np.testing.assert_array_equal(counts, frames[0] if name == "picture" else expected)
        if name == "picture":
            assert camera.still and camera.frame().any()
        elif getattr(camera, "live", False):
            with pytest.raises(CameraLost, match=r"has sent nothing for 0.3 s; is it unplugged\?"):
                camera.frame()
        else:
            for _ in range(2):
                with pytest.raises(EndOfFrames, match="no more frames"):
                    camera.frame()
    camera.close()
    camera.close()
    with pytest.raises(CameraLost, match="closed"):
        camera.frame()


@pytest.mark.parametrize("name", CAMERAS)
def test_a_look_through_every_camera_is_in_metres(name, tmp_path, rng):
    make, unit = CAMERAS[name]
    with make(tmp_path, scene(rng, unit)) as camera:
        depth = look(camera, COUNT)
    assert depth.dtype == np.float32 and (depth[:5, :5] == 0).all()
    assert np.abs(depth[5:] - (0.45 + 0.01 * np.linspace(-1, 1, SMALL.width))).max() < 0.003


@pytest.mark.full
def test_a_simulated_camera_sees_what_a_hand_does():
    world = levelled_world(3)
    with simulated_camera(world, jax.random.key(0)) as camera:
        assert isinstance(camera, DepthCamera) and camera.live and camera.camera == PAPER_BOX
        first, second = camera.frame(), camera.frame()
        assert first.dtype == np.uint16 and first.shape == PAPER_BOX.shape
        seen = (first > 0) & (second > 0)
        change = (first.astype(float) - second)[seen] * camera.depth_unit
        assert 0.99 < seen.mean() < 1 and 0.0005 < change.std() < 0.0008
        before = look(camera, 5)
        world.act("knock", (240, 197))
        after = look(camera, 5)
        both = (before > 0) & (after > 0)
        assert np.abs((after - before)[both]).max() > 0.01
    with simulated_camera(world, jax.random.key(0), noise=0.0, holes=0.0) as camera:
        assert camera.still and look(camera, 3).all()


def stack(*frames):
    unit = 1e-3
    return Played("camera", SMALL, unit, iter(np.asarray(f, np.uint16) for f in frames))


def test_a_frozen_stream_is_lost(rng):
    same = scene(rng, 1e-3, 1)[0]
    with pytest.raises(CameraLost, match="camera: 15 frames are the same to the bit"):
        look(stack(*[same] * 15))


def test_a_look_at_sixty_per_cent_missing_says_so_by_its_zeros(rng):
    frames = scene(rng, 1e-3, 5)
    frames[:, :, : int(0.6 * SMALL.width)] = 0
    depth = look(stack(*frames), 5)
    assert np.isclose((depth == 0).mean(), 0.6, atol=0.02)
    with pytest.raises(MissingDepth, match=r"5\d\.\d % of the pixels"):
        fill_missing(depth)


def test_a_recording_that_ends_within_a_look_says_so(rng):
    with pytest.raises(EndOfFrames):
        look(stack(*scene(rng, 1e-3, 3)), 15)


def test_pictures_in_metres(tmp_path):
    depth = np.full(SMALL.shape, 0.45, np.float32)
    depth[0, :5] = [0.0, np.nan, np.inf, 9.0, 0.45004]
    np.save(tmp_path / "one.npy", depth)
    with picture_camera(tmp_path / "one.npy", CameraSettings(camera=(SMALL, 1e-3))) as camera:
        assert camera.depth_unit == 1e-4
        assert camera.frame()[0, :6].tolist() == [0, 0, 0, 0, 4500, 4500]
        assert look(camera)[1, 1] == np.float32(0.45)


def test_a_picture_in_another_unit_is_refused(tmp_path):
    depth = np.full(SMALL.shape, 450.0, np.float32)
    np.save(tmp_path / "one.npy", depth)
    assert cv2.imwrite(str(tmp_path / "one.tif"), depth)
    cv2.imwrite(str(tmp_path / "one.png"), 10 * depth.astype(np.uint16))
    match = "values around 450 are not metres, seen .*; 0.001 would fit: --depth-unit 0.001 says so"
    for name in ("one.npy", "one.tif"):
        with pytest.raises(BadImage, match=match):
            picture_camera(tmp_path / name, CameraSettings(camera=(SMALL, 1e-3)))
        with picture_camera(
            tmp_path / name, CameraSettings(camera=(SMALL, 1e-3), depth_unit=1e-3)
        ) as camera:
            assert camera.depth_unit == 1e-4 and (camera.frame() == 4500).all()
    with pytest.raises(BadImage, match="around 4500 are not counts of 0.001 m, .* 0.0001 would"):
        picture_camera(tmp_path / "one.png", CameraSettings(camera=(SMALL, 1e-3)))
    range_given = picture_camera(
        tmp_path / "one.png", CameraSettings(camera=(SMALL, 1e-3), z_range=(4.0, 5.0))
    )
    assert (range_given.frame() == 4500).all()
    with recording_writer(tmp_path / "rec", SMALL, 1e-3) as add:
        add((depth + 1).astype(np.uint16))
    with pytest.raises(BadCamera, match="says its unit itself; --depth-unit is for bags and"):
        open_camera(str(tmp_path / "rec"), CameraSettings(depth_unit=1e-4))


def test_a_recording_with_the_name_of_a_camera_is_a_question(tmp_path, rng, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("sim", "realsense", "sim:3"):
        with recording_writer(name, SMALL, 1e-4) as add:
            add(scene(rng, 1e-4, 1)[0])
        match = f"^{name}: is a camera's name and a recording with camera.json here; write ./{name}"
        with pytest.raises(JShapeError, match=match):
            open_camera(name)
        with open_camera(f"./{name}") as camera:
            assert camera.name == name and not camera.live
    (tmp_path / "notes").mkdir()
    with open_camera("sim:") as camera:
        assert camera.live


def test_pictures_of_nobody_and_of_the_papers_camera(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.full(SMALL.shape, 450, np.uint16))
    with pytest.raises(BadCamera, match="a.png: nothing says what its camera is; give --camera"):
        picture_camera(tmp_path / "a.png")
    with pytest.raises(BadImage, match="64x48 pixels; the camera makes 65x48"):
        picture_camera(tmp_path / "a.png", CameraSettings(camera=(replace(SMALL, width=65), 1e-3)))
    cv2.imwrite(str(tmp_path / "b.png"), np.full(PAPER_BOX.shape, 450, np.uint16))
    assert picture_camera(tmp_path / "b.png").camera == PAPER_BOX
    cv2.imwrite(str(tmp_path / "c.png"), np.full(SMALL.shape, 45, np.uint8))
    with pytest.raises(BadImage, match="8 bits"):
        picture_camera(tmp_path / "c.png")


def test_a_window_moves_the_principal_point(tmp_path, rng):
    frames = scene(rng, 1e-4)
    with windowed(folder(tmp_path, frames), 10, 20, 30, 25) as camera:
        assert (camera.camera.u0, camera.camera.v0, camera.camera.shape) == (21.0, 4.0, (25, 30))
        assert not camera.still and not camera.live
        np.testing.assert_array_equal(camera.frame(), frames[0, 20:45, 10:40])


# Names.


def given(path):
    """Settings with the camera of a file."""
    return CameraSettings(read_camera(path))


def test_every_kind_of_file_opens_by_its_name(tmp_path, rng):
    frames = scene(rng, 1e-4)
    folder(tmp_path, frames)
    picture(tmp_path, frames)
    for text, still in ((tmp_path / "rec", False), (tmp_path / "one.png", True)):
        with open_camera(str(text)) as camera:
            assert camera.camera == SMALL and getattr(camera, "still", False) == still
            np.testing.assert_array_equal(camera.frame(), frames[0])


def test_sim_by_name():
    with open_camera("sim:5", window=(0, 0, 100, 50)) as one, open_camera("sim:5") as other:
        np.testing.assert_array_equal(one.frame(), other.frame()[:50, :100])
    with pytest.raises(JShapeError, match="sim:x: a seed is a whole number"):
        open_camera("sim:x")


def test_a_simulated_camera_stands_where_its_file_says(tmp_path):
    write_camera(tmp_path / "left.json", above_simulated(30), 1e-4)
    with open_camera("sim:3", given(tmp_path / "left.json")) as camera:
        assert camera.camera == above_simulated(30)
        assert camera.name == "simulated camera at (0, 250) mm"
        depth = look(camera, 1)
    assert depth[90, 120] == pytest.approx(0.5, abs=0.01)  # it is aimed at the middle of the bed
    bed = depth[:, 120][depth[:, 120] > 0]
    assert bed[0] > 0.56 > 0.46 > bed[-1]


def test_neither_sdk_nor_rosbags_is_needed_by_the_others(tmp_path, rng, monkeypatch):
    for name in ("pyrealsense2", "rosbags"):
        monkeypatch.setitem(sys.modules, name, None)
    folder(tmp_path, scene(rng, 1e-4))
    with open_camera(str(tmp_path / "rec")) as camera, open_camera("sim") as other:
        assert camera.frame().any() and other.frame().any()


@pytest.mark.parametrize("how", ["ros1", "ros2", "mcap"])
def test_bags_by_name(how, tmp_path, rng):
    pytest.importorskip("rosbags")
    from tests.written_bags import TOPIC, depth_bag

    path = depth_bag(tmp_path / "bag", how, SMALL, scene(rng, 1e-3))
    with open_camera(str(path), CameraSettings(None, TOPIC, (0.3, 1.0))) as camera:
        assert (float(camera.camera.z_min), float(camera.camera.z_max)) == (0.3, 1.0)
        assert TOPIC in camera.name
    if how != "ros1":  # the file alone, without its metadata
        (inside,) = path.glob("*.db3" if how == "ros2" else "*.mcap")
        with open_camera(str(inside)) as camera:
            assert camera.frame().any()


def test_what_is_no_camera_is_said(tmp_path):
    def refused(match, text, kind=JShapeError, settings=AS_THEY_SAY, window=None):
        with pytest.raises(kind, match=match) as found:
            open_camera(text, settings, window)
        assert "\n" not in str(found.value)

    refused("webcam: is not a camera; allowed: realsense\\[:SERIAL.*FOLDER, FILE.png", "webcam")
    refused("no such file", str(tmp_path / "none.db3"))
    refused("none.json: no such file", "none.json")
    refused("neither camera.json", str(tmp_path))
    (tmp_path / "camera.json").write_text("{}")
    refused("missing width", str(tmp_path), BadCamera)
    write_camera(tmp_path / "camera.json", SMALL, 0.001)
    refused("holds no frames", str(tmp_path), BadDataset)
    own = given(tmp_path / "camera.json")
    refused("has a camera of its own", str(tmp_path), BadCamera, own)
    refused("crop window", "sim", BadCamera, window=(400, 0, 100, 100))
    refused("z_min", "sim", BadCamera, CameraSettings(z_range=(0.5, 0.4)))
    (tmp_path / "a.png").write_bytes(b"")
    refused("empty", str(tmp_path / "a.png"), BadFile)
    refused("sim:x/y: a seed is", "sim:x/y")
    refused("file: needs an address: file:PATH", "file")
    refused("is none of a ROS bag, ", f"file:{tmp_path}/none")
    assert len({name for name, _ in names()}) == len(names()) - 1  # FOLDER is two of them


def test_a_camera_file_replaces_what_is_guessed(tmp_path):
    frame = np.full(PAPER_BOX.shape, 4500, np.uint16)
    cv2.imwrite(str(tmp_path / "a.png"), frame)
    other = replace(PAPER_BOX, fx=500.0)
    write_camera(tmp_path / "mine.json", other, 1e-4)
    with open_camera(str(tmp_path / "a.png"), given(tmp_path / "mine.json")) as camera:
        assert camera.camera == other and camera.depth_unit == 1e-4
    assert json.loads((tmp_path / "mine.json").read_text())["fx"] == 500.0
    assert D435_BAZAR.shape != PAPER_BOX.shape and sim.SURFACE == 0.45
