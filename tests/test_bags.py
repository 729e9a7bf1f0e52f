"""Bags of ROS 1, ROS 2 and MCAP, written here: what is read from them, and every damage named."""

import contextlib
import re
import struct
import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest

from jshape import Camera
from jshape.errors import BadCamera, BadFile, BadImage, JShapeError
from jshape.io.bag_images import decode_rvl
from jshape.io.bags import open_bag

pytest.importorskip("rosbags")

from tests.written_bags import (  # noqa: E402
    FORMATS,
    INFO,
    TOPIC,
    depth_bag,
    encode_rvl,
    image,
    info,
    packed,
    png,
    rvl,
    without_index,
    write_bag,
)

SMALL = Camera(40, 30, 50.0, 51.0, 19.5, 14.5, 0.42, 0.47)


@pytest.fixture
def counts(rng):
    frames = rng.integers(430, 470, (4, *SMALL.shape)).astype(np.uint16)
    frames[:, :3, :3] = 0
    return frames


@pytest.fixture
def metres(counts):
    frames = (counts * np.float32(1e-3) + np.float32(0.00023)).astype(np.float32)
    frames[:, :3, :3] = [np.nan, 0.0, np.inf]
    return frames


def read(path, **options):
    bag = open_bag(path, **options)
    try:
        return bag, np.stack(list(bag.frames()))
    finally:
        bag.close()
        bag.close()


def refused(match, path, kind=BadFile, frames=False, **options):
    with pytest.raises(kind, match=match) as found:
        bag = open_bag(path, **options)
        try:
            list(bag.frames())
        finally:
            bag.close()
        assert frames, "it should have been refused at once"
    message = str(found.value)
    assert "\n" not in message and len(message) < 500 and str(path) in message
    return message


@pytest.mark.parametrize("how", FORMATS)
@pytest.mark.parametrize("make", [image, packed, rvl], ids=["plain", "compressedDepth", "RVL"])
def test_counts_come_to_the_bit(how, make, tmp_path, counts):
    bag, frames = read(depth_bag(tmp_path / "bag", how, SMALL, counts, make))
    np.testing.assert_array_equal(frames, counts)
    assert (bag.camera, bag.depth_unit, bag.topic, len(frames)) == (SMALL, 1e-3, TOPIC, 4)


@pytest.mark.parametrize("how", FORMATS)
def test_metres_become_tenths_of_millimetres(how, tmp_path, metres):
    bag, frames = read(depth_bag(tmp_path / "bag", how, SMALL, metres))
    assert bag.depth_unit == 1e-4 and frames.dtype == np.uint16 and not frames[:, :3, :3].any()
    good = frames > 0
    assert good.sum() == 4 * (SMALL.width * SMALL.height - 9)
    assert np.abs(frames * 1e-4 - metres)[good].max() < 0.51e-4


def test_quantised_metres_come_within_their_steps(tmp_path, metres):
    _, frames = read(depth_bag(tmp_path / "bag", "ros2", SMALL, metres, packed))
    good = frames > 0
    assert not frames[:, :3, :3].any() and good[:, 3:, 3:].all()
    # Steps of 1/z: dz = z^2 / a, half of it off at most, and half a count.
    most = 0.5 * 0.47**2 / (100.0 * 101.0) + 0.51e-4
    assert np.abs(frames * 1e-4 - metres)[good].max() < most


def test_big_endian_and_padded_rows(tmp_path, counts):
    topics = [(TOPIC, [image(counts[0], big=True, pad=6)]), (INFO, [info(SMALL)])]
    path = write_bag(tmp_path / "bag", "ros1", topics)
    _, frames = read(path.rename(path.with_suffix(".BAG")))
    np.testing.assert_array_equal(frames, counts[:1])


def test_the_only_depth_topic_is_found_among_others(tmp_path, counts):
    colour = np.zeros((*SMALL.shape, 1), np.uint16)
    topics = [
        ("/camera/infra1/image_rect_raw", [image(colour[..., 0], "mono16")]),
        ("/camera/infra1/camera_info", [info(SMALL, fx=77.0)]),
        (TOPIC, [image(counts[0])]),
        (TOPIC + "/compressedDepth", [packed(counts[0])]),
        (INFO, [info(SMALL)]),
        ("/camera/colour/camera_info", [info(SMALL, fx=99.0)]),
    ]
    path = write_bag(tmp_path / "bag", "mcap", topics)
    bag, frames = read(path)
    assert bag.topic == TOPIC and bag.camera.fx == 50.0
    bag, again = read(path, topic=TOPIC + "/compressedDepth")
    assert bag.camera.fx == 50.0
    np.testing.assert_array_equal(frames, again)
    bag, _ = read(path, topic="/camera/infra1/image_rect_raw")  # asked for by name: so it is
    assert bag.camera.fx == 77.0


def test_several_depth_topics_are_a_question(tmp_path, counts):
    topics = [
        ("/left/depth", [image(counts[0])]), ("/left/camera_info", [info(SMALL)]),
        ("/right/depth", [image(counts[1])]), ("/right/camera_info", [info(SMALL, fx=60.0)]),
    ]  # fmt: skip
    path = write_bag(tmp_path / "bag", "ros2", topics)
    refused("has 2 depth topics: /left/depth, /right/depth; choose one with --topic", path)
    assert read(path, topic="/right/depth")[0].camera.fx == 60.0
    refused("has no topic /x; topics: /left/camera_info", path, topic="/x")
    refused("is sensor_msgs/msg/CameraInfo, not an image", path, topic="/left/camera_info")


def test_names_out_of_a_bag_stay_on_one_line(tmp_path, counts):
    topic = "/a\nb/" + 300 * "x"
    path = write_bag(tmp_path / "bag", "ros1", [(topic, [image(counts[0])])])
    refused("has no CameraInfo on /a b/camera_info", path, BadCamera)
    refused("has no topic /y; topics: /a b/xxx", path, topic="/y")


def test_no_depth_topic_lists_what_there_is(tmp_path, counts):
    path = write_bag(tmp_path / "bag", "ros2", [(INFO, [info(SMALL)])])
    refused(r"has no depth topic; topics: /camera/depth/camera_info \(CameraInfo\)", path)


@pytest.mark.parametrize("how", FORMATS)
def test_a_bag_without_camera_info_needs_a_camera(how, tmp_path, counts):
    path = write_bag(tmp_path / "bag", how, [(TOPIC, [image(f) for f in counts])])
    refused("has no CameraInfo on /camera/depth/camera_info; .*--camera FILE", path, BadCamera)
    bag, frames = read(path, camera=(SMALL, 5e-4))
    assert bag.camera == SMALL and bag.depth_unit == 5e-4
    np.testing.assert_array_equal(frames, counts)


def test_another_cameras_info_is_named_and_not_taken(tmp_path, counts):
    topics = [(TOPIC, [image(counts[0])]), ("/colour/camera_info", [info(SMALL)])]
    path = write_bag(tmp_path / "bag", "ros2", topics)
    refused("there is /colour/camera_info", path, BadCamera)


@pytest.mark.full
@pytest.mark.parametrize(
    "wrong, match",
    [
        ({"fx": 0.0}, "camera_info: fx is 0.0; it must be positive"),
        ({"fy": -50.0}, "fy is -50.0; it must be positive"),
        ({"fx": np.nan}, "fx is nan; it must be a finite number"),
        ({"u0": np.inf}, "u0 is inf"),
        ({"size": (80, 60)}, "the frames have 40x30 pixels; their CameraInfo is for 80x60"),
        ({"size": (0, 0)}, "width is 0"),
        ({"roi": (8, 6, 20, 16)}, r"for 40x30, of which it shows 20x16 at \(8, 6\);"),
        ({"binning": 2}, "for 40x30, 2x2 put together; --camera FILE"),
        ({"size": (48, 40), "roi": (8, 6, 40, 30, 1)}, r"40x30 at \(8, 6\) of .* \(do_rectify\)"),
        ({"distortion": (0.1, 0.0), "p": (0.0,) * 4}, "P is empty; K says .*, the lens 0.1, 0, "),
    ],
    ids=[
        "zero",
        "negative",
        "nan",
        "inf",
        "size",
        "empty",
        "region",
        "binning",
        "distinct",
        "no P",
    ],
)
def test_wrong_intrinsics_are_refused(wrong, match, tmp_path, counts):
    path = write_bag(
        tmp_path / "bag", "ros2", [(TOPIC, [image(counts[0])]), (INFO, [info(SMALL, **wrong)])]
    )
    refused(match, path, BadCamera)
    assert read(path, camera=(SMALL, 1e-3))[0].camera == SMALL
    wide = replace(SMALL, width=80)
    refused("40x30 pixels; the camera given for it makes 80x30", path, BadCamera,
            camera=(wide, 1e-3))  # fmt: skip


P = (433.0, 434.0, 20.5, 13.5)


@pytest.mark.parametrize("how", ["ros1", "ros2"])
@pytest.mark.parametrize(
    "topic, said, taken",
    [
        ("/d/image_rect", {"p": P}, P),
        ("/d/image_rect_raw", {"p": P, "distortion": (0.1, -0.2, 0.0, 0.0, 0.0)}, P),
        ("/rectified/depth", {"p": P}, P),
        ("/d/image_rect", {"p": (0.0,) * 4}, (50.0, 51.0, 19.5, 14.5)),
        ("/d/image_raw", {"p": P}, (50.0, 51.0, 19.5, 14.5)),
        ("/d/depth", {}, (50.0, 51.0, 19.5, 14.5)),
        ("/d/direct", {"size": (90, 80), "roi": (8, 6, 40, 30)}, (50.0, 51.0, 11.5, 8.5)),
        ("/d/depth", {"size": (80, 60), "binning": 2}, (25.0, 25.5, 9.75, 7.25)),
        ("/d/image_rect", {"p": P, "size": (99, 98), "roi": (4, 2, 80, 60), "binning": 2},
         (216.5, 217.0, 8.25, 5.75)),
    ],
)  # fmt: skip
def test_the_intrinsics_are_those_of_the_frames(how, topic, said, taken, tmp_path, counts):
    beside = topic.rpartition("/")[0] + "/camera_info"
    path = write_bag(tmp_path / "bag", how, [(topic, [image(counts[0])]),
                                             (beside, [info(SMALL, **said)])])  # fmt: skip
    camera = read(path)[0].camera
    assert (camera.fx, camera.fy, camera.u0, camera.v0) == pytest.approx(taken)
    assert (camera.width, camera.height) == (40, 30)


def test_intrinsics_that_may_be_others_are_a_question(tmp_path, counts):
    def one(name, topic, match, **said):
        topics = [(topic, [image(counts[0])]), ("/d/camera_info", [info(SMALL, **said)])]
        refused(match, write_bag(tmp_path / name, "ros1", topics), BadCamera)

    one("either", "/d/depth", "K says fx 50, fy 51, .* rectified frames, fx 433, .*--camera", p=P)
    lens = {"distortion": (0.1, -0.2, 0.0, 0.0, 0.0)}
    one("bent", "/d/depth", "neither rect nor raw; .* the lens 0.1, -0.2, .* 433,", p=P, **lens)
    one("bent, no P", "/d/depth", "neither rect nor raw; .* fx 0, .*--camera", p=(0,) * 4, **lens)


EIGHT = (0.4, 0.1, 1e-3, -2e-3, 0.02, 0.5, 0.05, 0.03)
"""k1, k2, p1, p2, k3, k4, k5, k6."""


@pytest.mark.parametrize("how", ["ros1", "ros2"])
@pytest.mark.parametrize(
    "model, distortion, lens",
    [
        ("plumb_bob", (0.1, -0.02, 1e-3, 2e-3, 5e-3), (0.1, -0.02, 1e-3, 2e-3, 5e-3, 0, 0, 0)),
        ("plumb_bob", (0.1, -0.02, 0.0, 0.0), (0.1, -0.02, 0, 0, 0, 0, 0, 0)),
        ("rational_polynomial", EIGHT, EIGHT),
        ("rational_polynomial", (*EIGHT, 0.0, 0.0, 0.0, 0.0), EIGHT),
        ("", EIGHT, EIGHT),
        ("plumb_bob", (0.0,) * 5, None),
        ("equidistant", (0.0,) * 4, None),
    ],
)
def test_raw_frames_have_the_lens_of_k_and_d(how, model, distortion, lens, tmp_path, counts):
    said = {"model": model, "distortion": distortion, "p": P}
    part = {"size": (90, 80), "roi": (8, 6, 80, 60), "binning": 2}
    for name, more in (("whole", {}), ("part", part)):
        topics = [("/d/image_raw", [image(counts[0])]),
                  ("/d/camera_info", [info(SMALL, **said, **more)])]  # fmt: skip
        camera = read(write_bag(tmp_path / name, how, topics))[0].camera
        assert camera.lens == lens and camera.width == 40
    assert camera.fx == 25.0, "region and binning change K, and D no bit"


@pytest.mark.parametrize(
    "said, match",
    [
        ({"model": "equidistant", "distortion": (0.1, 0, 0, 0)}, "is of the model 'equidistant'; "),
        ({"distortion": (*EIGHT, 0.01)}, "has 9 coefficients of distortion, .* behind the eighth"),
        ({"distortion": (-9.0, 0, 0, 0, 0)}, "no straight rays belong to the image's edge"),
        ({"distortion": (np.nan, 0, 0, 0, 0)}, "lens is .*; it must be 8 numbers"),
    ],
)
def test_lenses_that_are_not_read_are_refused(said, match, tmp_path, counts):
    topics = [("/d/image_raw", [image(counts[0])]), ("/d/camera_info", [info(SMALL, **said)])]
    refused(match, write_bag(tmp_path / "bag", "ros2", topics), BadCamera)


def test_hostile_rvl_is_refused(rng):
    whole = encode_rvl(np.where(rng.random((30, 40)) < 0.3, 0, rng.integers(1, 60000, (30, 40))))
    words = whole[8:]
    size = struct.Struct("<II")
    bad = {
        "no size": whole[:5],
        "empty": size.pack(40, 30),
        "cut off": whole[: len(whole) // 2],
        "more pixels": size.pack(41, 30) + words,
        "a number without end": size.pack(40, 30) + b"\xff" * 4000,
        "a long number": size.pack(40, 30) + b"\xff" * 8 + b"\0" * 4000,
        "runs of nothing": size.pack(40, 30) + b"\0" * 4000,
    }
    for name, data in bad.items():
        with pytest.raises(BadImage, match="^x: the RVL stream is cut off or damaged$"):
            decode_rvl(data, "x")
            pytest.fail(name)
    for sides in ((0, 30), (2**16, 2**16), (2**32 - 1, 2**32 - 1)):
        with pytest.raises(BadImage, match="pixels; 1 to 67,108,864 are read"):
            decode_rvl(size.pack(*sides) + words, "x")
    for _ in range(300):  # damage anywhere: refused, or another image of this size
        broken = bytearray(whole)
        for at in rng.integers(8, len(whole), 3):
            broken[at] = rng.integers(256)
        with contextlib.suppress(BadImage):
            assert decode_rvl(bytes(broken), "x").shape == (30, 40)


@pytest.mark.parametrize("name", ["extremes", "zeros", "one", "long runs"])
def test_rvl_comes_to_the_bit(name, rng):
    frame = {
        "extremes": rng.choice([0, 1, 65535], (7, 9)),
        "zeros": np.zeros((5, 4)),
        "one": np.full((1, 1), 65535),
        "long runs": np.repeat([0, 40000, 0, 3], 700).reshape(40, 70),
    }[name].astype(np.uint16)
    np.testing.assert_array_equal(decode_rvl(encode_rvl(frame), "x"), frame)


def test_rvl_without_a_name_and_a_png_that_is_none(tmp_path, counts):
    def bag(name, form):
        topics = [("/d/depth", [packed(counts[0], form, rvl=True)]),
                  ("/d/camera_info", [info(SMALL)])]  # fmt: skip
        return write_bag(tmp_path / name, "ros1", topics)

    np.testing.assert_array_equal(read(bag("old", "; compressedDepth"))[1][0], counts[0])
    refused("holds no PNG", bag("png", "; compressedDepth png"), BadImage, frames=True)


def test_a_camera_info_that_changes_ends_the_frames(tmp_path, counts):
    infos = [info(SMALL), info(SMALL), info(SMALL, fx=52.0), info(SMALL)]
    path = write_bag(tmp_path / "bag", "ros2", [(TOPIC, [image(f) for f in counts]), (INFO, infos)])
    bag = open_bag(path)
    frames = bag.frames()
    np.testing.assert_array_equal([next(frames), next(frames)], counts[:2])
    with pytest.raises(BadCamera, match="is another one from frame [23] on; --camera FILE"):
        list(frames)
    bag.close()
    assert len(read(path, camera=(SMALL, 1e-3))[1]) == 4


@pytest.mark.parametrize("how", ["ros2", "mcap"])
def test_a_bag_of_several_files_is_read_in_the_order_of_time(how, tmp_path, counts):
    path = tmp_path / "bag"
    for part, frames in enumerate((counts[:1], counts[1:])):
        written = depth_bag(tmp_path / f"part{part}", how, SMALL, frames)
        path.mkdir(exist_ok=True)
        file = next(p for p in written.iterdir() if p.suffix != ".yaml")
        file.rename(path / f"part{part}{file.suffix}")
    text = (written / "metadata.yaml").read_text()
    refused("has no metadata.yaml, .*; ros2 bag reindex writes it", path)
    both = ", ".join(p.name for p in sorted(path.iterdir()))
    listed = re.sub(r"relative_file_paths:\s*- \S+", f"relative_file_paths: [{both}]", text)
    assert both in listed
    (path / "metadata.yaml").write_text(listed)
    np.testing.assert_array_equal(read(path)[1], counts)
    backwards = listed.replace(both, ", ".join(reversed(both.split(", "))))
    (path / "metadata.yaml").write_text(backwards)
    refused("goes back in time: metadata.yaml lists", path, frames=True)


@pytest.mark.full
@pytest.mark.parametrize("form", ["16UC1; png compressed ", "mono16; png compressed", "png"])
def test_counts_as_png_come_to_the_bit(form, tmp_path, counts):
    topic = "/camera/depth/image_raw/compressed"
    grey = np.zeros(SMALL.shape, np.uint8)
    topics = [(topic, [png(f, form) for f in counts]), (INFO, [info(SMALL)]),
              ("/camera/depth/other/compressed", [png(grey, "png")])]  # fmt: skip
    bag, frames = read(write_bag(tmp_path / "bag", "ros1", topics))
    np.testing.assert_array_equal(frames, counts)
    assert bag.topic == topic and bag.camera == SMALL
    topics.append((topic.removesuffix("/compressed"), [image(counts[0])]))
    topics.append((topic + "Depth", [packed(counts[0])]))
    assert read(write_bag(tmp_path / "both", "ros2", topics))[0].topic == topics[-2][0]
    assert read(write_bag(tmp_path / "two", "ros2", topics[:3] + topics[4:]))[0].topic == (
        topic + "Depth"
    )


def test_an_mcap_without_its_index_says_what_makes_one(tmp_path, counts):
    path = depth_bag(tmp_path / "bag", "mcap", SMALL, counts)
    refused("Unindexed MCAP .*`mcap recover` makes", without_index(next(path.glob("*.mcap"))))


@pytest.mark.parametrize("make", [image, packed])
@pytest.mark.parametrize("blank", [False, True], ids=["first", "later"])
def test_metres_that_are_millimetres_are_refused(make, blank, tmp_path, counts):
    tiny = (counts * np.float32(1e-3)).astype(np.float32)
    wrong = tiny * (10 if make is packed else 1000)  # packed, 10 and more are no reading
    around, factor = (r"4\.[45]", "0.1") if make is packed else ("4[45]", "0.001")
    frames = [np.zeros_like(tiny[0])] * blank + list(wrong)
    path = depth_bag(tmp_path / "bag", "ros2", SMALL, frames, make)
    match = f"values around {around}.* are not metres, .* {factor} would fit: --depth-unit {factor}"
    refused(match, path, BadImage, frames=blank)
    bag, found = read(path, depth_unit=float(factor))
    assert bag.depth_unit == 1e-4 and len(found) == 4 + blank
    assert np.abs(found[blank:] * 1e-4 - tiny)[:, 3:, 3:].max() < 1e-3
    assert not found[:, :3, :3].any()


@pytest.mark.parametrize(
    "scale, unit, options",
    [
        (10, "0.0001", {}),
        (10, "0.0001", {"camera": (SMALL, 1e-3)}),
        (1, "0.001", {"camera": (SMALL, 1e-4)}),
        (10, None, {"camera": (SMALL, 1e-4)}),
        (10, None, {"z_range": (4.0, 5.0)}),
        (10, None, {"depth_unit": 1e-3}),
        (2, None, {}),  # 0.9 m: a camera at another height, which no factor brings nearer
        (40, "0.0001", {}),  # 18 m: beyond what is read
    ],
)
def test_counts_of_another_unit_are_refused(scale, unit, options, tmp_path, counts):
    name = "16UC1" if options else "mono16"
    topics = [(TOPIC, [image(f * np.uint16(scale), name) for f in counts]), (INFO, [info(SMALL)])]
    path = write_bag(tmp_path / "bag", "ros1", topics)
    if unit is None:
        np.testing.assert_array_equal(read(path, **options)[1], counts * scale)
        return
    match = rf"values around [0-9.]+ are not counts of .*--depth-unit {unit} says so"
    refused(match, path, BadImage, **options)
    assert read(path, depth_unit=float(unit), **options)[0].depth_unit == float(unit)


def test_an_mcap_of_another_system_is_said_to_be(tmp_path, counts):
    path = next(depth_bag(tmp_path / "bag", "mcap", SMALL, counts).glob("*.mcap"))
    path.write_bytes(path.read_bytes().replace(b"ros2", b"ros1", 1))
    refused(r"cannot be read: .* not one of ROS \(Profile is not ros2", path)


def test_frames_that_change_within_a_bag(tmp_path, counts, metres):
    topics = [(TOPIC, [image(counts[0]), image(counts[1, :20])]), (INFO, [info(SMALL)])]
    path = write_bag(tmp_path / "size", "ros2", topics)
    refused("frame 1 of .*: has 40x20 pixels; the camera makes 40x30", path, BadImage)
    topics = [(TOPIC, [image(counts[0]), image(metres[1])]), (INFO, [info(SMALL)])]
    path = write_bag(tmp_path / "kind", "ros2", topics)
    refused("frame 1 of .*: has another encoding than the first", path, BadImage)


def test_what_is_no_depth_image_is_said(tmp_path, counts):
    def one(name, make, match):
        path = write_bag(tmp_path / name, "ros2", [(TOPIC, [make]), (INFO, [info(SMALL)])])
        refused(match, path, BadImage, topic=TOPIC)

    one("colour", image(counts[0], "rgb8"), "is 'rgb8'; depth is one of 16UC1, 32FC1")
    one("short", image(counts[0, :, :7].copy(), "32FC1"), "the frame is cut off")
    one("rvl", _rvl(counts[0]), "pixels; 1 to 67,108,864 are read")
    one("jpeg", packed(counts[0], "; jpeg compressed bgr8"), "packed depth is compressedDepth or")
    one("float", png(counts[0], "32FC1; png compressed"), "packed depth is compressedDepth or a")
    one("nothing", _zeros(counts[0] * np.float32(1e-3)), "compressedDepth's numbers are 0 and 0")
    one("8 bits", _eight(counts[0]), "holds a PNG of uint8; packed depth has 16 bits")
    one("torn", _torn(counts[0]), "the PNG is cut off or damaged")


def _rvl(array):
    make = packed(array, "; compressedDepth rvl")
    return lambda *a: _with(make(*a), lambda data: np.r_[data[:12], np.arange(50, dtype=np.uint8)])


def _eight(array):
    small = cv2.imencode(".png", array.astype(np.uint8))[1].reshape(-1)
    return lambda *a: _with(packed(array)(*a), lambda data: np.r_[data[:12], small])


def _zeros(array):
    return lambda *a: _with(packed(array)(*a), lambda data: np.r_[0 * data[:12], data[12:]])


def _torn(array):
    make = packed(array)
    return lambda *a: _with(make(*a), lambda data: data[: len(data) // 2])


def _with(message, change):
    message.data = change(message.data)
    return message


@pytest.mark.parametrize("how", FORMATS)
@pytest.mark.parametrize("share", [0.02, 0.3, 0.6, 0.9, 0.995])
def test_a_truncated_bag_is_one_line(how, share, tmp_path, rng):
    frames = rng.integers(430, 470, (6, 60, 80)).astype(np.uint16)
    camera = Camera(80, 60, 50.0, 50.0, 40.0, 30.0, 0.4, 0.5)
    path = depth_bag(tmp_path / "bag", how, camera, frames)
    inside = path if how == "ros1" else next(p for p in path.iterdir() if p.suffix != ".yaml")
    data = inside.read_bytes()
    inside.write_bytes(data[: int(share * len(data))])
    refused("cut off or damaged", path, JShapeError, frames=True)
    refused("cut off or damaged", inside, JShapeError, frames=True)
    hint = {"ros1": "realsense:alone.bag", "ros2": "", "mcap": "mcap recover"}[how]
    alone = inside.rename(tmp_path / f"alone{inside.suffix}")
    refused(rf"cut off or damaged.*\).*{hint}", alone, JShapeError, frames=True)


def test_what_is_no_bag_is_said(tmp_path):
    refused("no such file", tmp_path / "none.bag")
    (tmp_path / "folder").mkdir()
    refused("has no metadata.yaml", tmp_path / "folder")
    (tmp_path / "folder" / "metadata.yaml").write_text("hello: [")
    refused("cut off or damaged", tmp_path / "folder")
    for suffix in (".bag", ".db3", ".mcap"):
        for content in (b"", b"hello", bytes(5000)):
            path = tmp_path / f"junk{suffix}"
            path.write_bytes(content)
            refused("cut off or damaged|has no depth topic", path)
    (tmp_path / "a.txt").write_text("a")
    refused("is not a bag; allowed: .bag, .db3, .mcap", tmp_path / "a.txt")


def test_missing_rosbags_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rosbags", None)
    refused(r"pip install 'jshape\[ros\]'", tmp_path / "a.db3", JShapeError)


def test_a_closed_bag_is_closed(tmp_path, counts):
    bag = open_bag(depth_bag(tmp_path / "bag", "ros2", SMALL, counts))
    frames = bag.frames()
    next(frames)
    bag.close()
    with pytest.raises(BadFile):
        list(frames)
    with pytest.raises(BadFile, match="was closed"):
        next(bag.frames())


def test_what_librealsense_records_is_read_without_it(tmp_path, counts):
    """Its .db3 has no metadata, its own topic names, and the unit as a text."""
    pytest.importorskip("pyrealsense2")
    from tests.virtual_realsense import record

    record(tmp_path / "rec.db3", SMALL, 1e-4, counts)
    bag, frames = read(tmp_path / "rec.db3")
    np.testing.assert_array_equal(frames, counts)
    assert bag.depth_unit == 1e-4 and bag.camera == SMALL
