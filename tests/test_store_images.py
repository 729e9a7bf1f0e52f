"""Depth images on disk: every format there and back, and every wrong file refused in one line."""

import io
import os
import struct
import zlib
from collections import Counter
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image

from jshape import D435_BAZAR, PAPER_BOX, Camera
from jshape.data.missing import only_readings
from jshape.errors import BadCamera, BadFile, BadImage, JShapeError
from jshape.io import images
from jshape.io.formats import read_array, read_drawing
from jshape.io.images import check_depth, read_counts, read_depth

SMALL = Camera(12, 9, 15.0, 15.0, 5.5, 4.0, 0.4, 0.5)


@pytest.fixture
def counts(rng):
    counts = rng.integers(4000, 5000, SMALL.shape).astype(np.uint16)
    counts[2, 3:5] = 0
    return counts


def encoded(suffix, array, *options):
    return cv2.imencode(suffix, array, list(options))[1].tobytes()


def npy(array, **options):
    stream = io.BytesIO()
    np.save(stream, array, **options)
    return stream.getvalue()


def npy_of_shape(shape):
    stream = io.BytesIO()
    header = {"descr": "<f8", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(stream, header)
    return stream.getvalue() + bytes(64)


def tiff(*bands, bits=None, packed=1, kind=1, planes=False, size=None, nodata=None, order="<"):
    """An uncompressed TIFF of bands (H, W), whatever its tags say of it."""
    first = bands[0]
    (height, width), deep = first.shape, bits or 8 * first.itemsize
    data = np.stack(bands, 0 if planes else -1).astype(first.dtype.newbyteorder(order)).tobytes()
    wide, high = size or (width, height)
    sample = {"u": 1, "i": 2, "f": 3}[first.dtype.kind]
    count = len(bands)
    tags = {
        256: (4, [wide]), 257: (4, [high]), 258: (3, [deep] * count), 259: (3, [packed]),
        262: (3, [kind]), 273: (4, [8]), 277: (3, [count]), 278: (4, [high]),
        279: (4, [len(data)]), 284: (3, [1 + planes]), 339: (3, [sample] * count),
    }  # fmt: skip
    if nodata is not None:
        tags[42113] = (2, nodata.encode() + b"\0")
    out = bytearray((b"II" if order == "<" else b"MM") + struct.pack(order + "HI", 42, 8)) + data
    entries = b""
    for tag, (code, values) in tags.items():
        form = f"{order}{len(values)}{'s' if code == 2 else 'H' if code == 3 else 'I'}"
        raw = struct.pack(form, *([values] if code == 2 else values))
        if len(raw) > 4:
            at = len(out)
            out += raw
            raw = struct.pack(order + "I", at)
        entries += struct.pack(order + "HHI", tag, code, len(values)) + raw.ljust(4, b"\0")
    struct.pack_into(order + "I", out, 4, len(out))
    return bytes(out) + struct.pack(order + "H", len(tags)) + entries + bytes(4)


def put(folder, name, content):
    (folder / name).write_bytes(content)
    return folder / name


def metres(counts, unit):
    return np.where(counts == 0, np.nan, counts * np.float32(unit)).astype(np.float32)


@pytest.mark.parametrize("unit", [0.001, 0.0001])
@pytest.mark.parametrize("name", ["a.png", "a.tiff", "a.npy", "wrong.jpg"])
def test_counts_become_metres(tmp_path, counts, name, unit):
    suffix = Path(name).suffix.replace("jpg", "png")
    content = npy(counts) if suffix == ".npy" else encoded(suffix, counts)
    depth = read_depth(put(tmp_path, name, content), depth_unit=unit)
    assert depth.dtype == np.float32
    np.testing.assert_array_equal(depth, metres(counts, unit))


FLOATS = [(".npy", kind) for kind in ("f2", "<f4", "<f8", ">f4", ">f8")]
FLOATS += [(".tiff", "f4"), (".tiff", "f8")]


@pytest.mark.parametrize("suffix, kind", FLOATS)
def test_floating_point_is_metres(tmp_path, counts, suffix, kind):
    expected = metres(counts, 1e-4).astype(kind)
    content = npy(expected) if suffix == ".npy" else encoded(suffix, expected)
    depth = read_depth(put(tmp_path, "a" + suffix, content), depth_unit=7.0)
    np.testing.assert_array_equal(depth, expected.astype(np.float32))


def test_column_order_and_old_headers_of_npy(tmp_path, counts):
    np.testing.assert_array_equal(
        read_depth(put(tmp_path, "a.npy", npy(np.asfortranarray(counts))), depth_unit=1e-4),
        metres(counts, 1e-4),
    )
    stream = io.BytesIO()
    np.lib.format.write_array(stream, counts, version=(2, 0))
    read_depth(put(tmp_path, "b.npy", stream.getvalue()))


def test_no_reading_has_many_signs(tmp_path):
    depth = np.full((3, 4), 0.45)
    depth[0] = 0, -1, np.nan, np.inf
    found = read_depth(put(tmp_path, "a.npy", npy(depth)))
    assert np.isnan(found[0]).all() and not np.isnan(found[1:]).any()


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("kind", ["u2", "i2", "i4", "f4", "f8"])
def test_a_tiff_of_one_channel_keeps_its_numbers_and_says_what_is_no_data(tmp_path, kind, order):
    numbers = np.arange(108).reshape(9, 12).astype(kind)
    content = tiff(numbers, order=order)
    found = read_array(put(tmp_path, "a.tif", content))
    assert found.dtype == numbers.dtype and not np.ma.isMaskedArray(found)
    np.testing.assert_array_equal(found, numbers)
    found = read_array(put(tmp_path, "b.tif", tiff(numbers, order=order, nodata="7")))
    np.testing.assert_array_equal(np.ma.getmaskarray(found), numbers == 7)
    np.testing.assert_array_equal(np.ma.getdata(found), numbers)
    for odd in ("nan", "text", "1e300"):
        found = read_array(put(tmp_path, "c.tif", tiff(numbers, order=order, nodata=odd)))
        np.testing.assert_array_equal(found, numbers)
        assert not np.ma.isMaskedArray(found)


def test_no_data_and_the_largest_count_are_no_readings_and_are_counted(tmp_path, counts):
    counts[0, :4], counts[1, :3] = 65535, 4321
    left_out = Counter()
    path = put(tmp_path, "a.tif", tiff(counts, nodata="4321"))
    depth = read_depth(path, depth_unit=1e-4, camera=SMALL, left_out=left_out)
    assert np.isnan(depth[0, :4]).all() and np.isnan(depth[counts == 4321]).all()
    assert left_out == {
        "0": 2, "masked or NODATA": (counts == 4321).sum(), "at 65535 (the largest uint16)": 4
    }  # fmt: skip
    cleaned = read_counts(path)
    np.testing.assert_array_equal(cleaned == 0, np.isnan(depth))
    # A PNG says it as GDAL writes it: by the grey that is transparent.
    content = encoded(".png", counts)
    chunk = b"tRNS" + struct.pack(">H", 4321)
    chunk = struct.pack(">I", 2) + chunk + struct.pack(">I", zlib.crc32(chunk))
    path = put(tmp_path, "a.png", content[:33] + chunk + content[33:])
    np.testing.assert_array_equal(read_depth(path, depth_unit=1e-4), depth)


def test_8_bits_are_luminance_and_clipped_is_not_missing(tmp_path):
    level = np.arange(108, dtype=np.uint8).reshape(9, 12)
    level[0, :2] = 0, 255
    for suffix in (".png", ".tiff"):
        path = put(tmp_path, "a" + suffix, encoded(suffix, level))
        depth = read_depth(path, camera=SMALL)
        np.testing.assert_allclose(depth, SMALL.depth(level), rtol=1e-6)
        np.testing.assert_allclose(depth[0, :2], (0.5, 0.4), rtol=1e-6)
        with pytest.raises(BadImage, match="need a camera"):
            read_depth(path)
        with pytest.raises(BadImage, match="12x9 pixels; the camera makes 480x395"):
            read_depth(path, camera=PAPER_BOX)


def test_white_of_8_bits_is_nearest_whatever_the_cameras_bits(tmp_path):
    level = np.full((9, 12), 255, np.uint8)
    level[0, 0] = 0
    white = put(tmp_path, "a.png", encoded(".png", level))
    sixteen = Camera(12, 9, 15.0, 15.0, 5.5, 4.0, 0.4, 0.5, bits=16)
    depth = read_depth(white, camera=sixteen)
    np.testing.assert_allclose(depth.ravel(), [0.5] + [0.4] * 107)


@pytest.mark.parametrize("check_range", [True, False])
@pytest.mark.parametrize("level, colour", [(0, "black"), (255, "white")])
def test_8_bits_of_one_clipped_level_show_nothing(tmp_path, level, colour, check_range):
    path = put(tmp_path, "a.png", encoded(".png", np.full((9, 12), level, np.uint8)))
    words = f"a.png: every pixel is {colour}: nothing within the camera's range"
    with pytest.raises(BadImage, match=words) as info:
        read_depth(path, camera=SMALL, check_range=check_range)
    assert "\n" not in str(info.value)


def test_an_array_that_was_read_before(tmp_path, counts):
    path = put(tmp_path, "a.png", encoded(".png", counts))
    raw = images.read_array(path)
    assert raw.dtype == np.uint16 and raw.shape == SMALL.shape
    depth = read_depth(path, raw=raw, depth_unit=1e-4, camera=SMALL)
    np.testing.assert_array_equal(depth, read_depth(path, depth_unit=1e-4, camera=SMALL))
    with pytest.raises(BadImage, match="^now: depths are"):
        read_depth("now", raw=raw, depth_unit=1.0, camera=SMALL)
    with pytest.raises(BadCamera, match="now: depth_unit"):
        read_depth("now", raw=raw, depth_unit=-1.0)


def test_the_range_may_be_left_unchecked_but_not_the_size(tmp_path):
    far = put(tmp_path, "a.npy", npy(np.full(SMALL.shape, 0.8)))
    with pytest.raises(BadImage, match="0.4 to 0.5 m"):
        read_depth(far, camera=SMALL)
    np.testing.assert_allclose(read_depth(far, camera=SMALL, check_range=False), 0.8)
    with pytest.raises(BadImage, match="12x9 pixels; the camera makes 480x395"):
        read_depth(far, camera=PAPER_BOX, check_range=False)
    nothing = put(tmp_path, "b.npy", npy(np.zeros(SMALL.shape)))
    with pytest.raises(BadImage, match="no pixel has a reading"):
        read_depth(nothing, camera=SMALL, check_range=False)


def png(width, height, depth, colour, body=b"", interlaced=0, extra=b""):
    def chunk(kind, content):
        check = zlib.crc32(kind + content)
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", check)

    header = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, interlaced)
    parts = chunk(b"IHDR", header), extra, chunk(b"IDAT", body), chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


GREY = np.full((9, 12), 4500, np.uint16)
GOOD = {
    "png": encoded(".png", GREY),
    "tiff": encoded(".tiff", GREY),
    "float.tiff": encoded(".tiff", GREY.astype(np.float32) / 1e4),
    "npy": npy(GREY),
}
COLOUR = np.full((9, 12, 3), 200, np.uint8)
BAD = {
    "empty.png": (b"", "empty"),
    "text.png": (b"hello world", "not an image; allowed: PNG, TIFF or NPY"),
    "rgb.png": (encoded(".png", COLOUR), "colour (RGB)"),
    "rgba.png": (encoded(".png", np.dstack([COLOUR, COLOUR[..., 0]])), "colour (RGBA)"),
    "rgb16.png": (encoded(".png", COLOUR.astype(np.uint16)), "colour (RGB)"),
    "palette.png": (png(4, 4, 8, 3, zlib.compress(bytes(20))), "palette"),
    "alpha.png": (png(4, 4, 8, 4, zlib.compress(bytes(40))), "grey with alpha"),
    "bits.png": (png(8, 4, 1, 0, zlib.compress(bytes(8))), "1-bit PNG"),
    "huge.png": (png(60_000, 60_000, 16, 0, b"x"), "60000x60000 pixels; at most"),
    "zero.png": (png(0, 5, 16, 0, b"x"), "is empty"),
    "body.png": (GOOD["png"][:-12], "cut off or damaged"),
    "rgb.tiff": (encoded(".tiff", COLOUR), "3 channels"),
    "a.exr": (b"v/1\x01" + bytes(40), "an EXR; save it as NPY or float TIFF; allowed: PNG"),
    "alpha.tiff": (tiff(GREY, GREY), "2 channels of 16 bits"),
    "bands.tiff": (tiff(GREY, GREY, GREY, planes=True), "3 channels of 16 bits"),
    "12.tiff": (tiff(GREY, bits=12), "holds uint12; read are uint8, uint16, int8"),
    "u4.tiff": (tiff(GREY.astype(np.uint32)), "holds uint32"),
    "half.tiff": (tiff(GREY.astype(np.float16)), "holds float16"),
    "zstd.tiff": (tiff(GREY, packed=50000), "holds uint16, compression 50000"),
    "palette.tiff": (tiff(GREY.astype(np.uint8), kind=3), "palette"),
    "wide.tiff": (tiff(GREY, size=(60_000, 60_000)), "60000x60000 pixels; at most"),
    "tags.tiff": (tiff(GREY)[:-40], "the TIFF is cut off or damaged"),
    "i2.tiff": (tiff(GREY.astype(np.int16)), "holds int16; raw depth is uint16"),
    "int.tiff": (encoded(".tiff", GREY.astype(np.int32)), "int32"),
    "photo.jpg": (encoded(".jpg", COLOUR), "JPEG"),
    "a.bmp": (encoded(".bmp", COLOUR), "BMP"),
    "zeros.png": (encoded(".png", GREY * 0), "no pixel has a reading"),
    "zeros.npy": (npy(GREY * 0.0), "no pixel has a reading"),
    "nan.npy": (npy(np.full((9, 12), np.nan)), "no pixel has a reading"),
    "nan.tiff": (encoded(".tiff", np.full((9, 12), np.nan, np.float32)), "no pixel"),
    "int64.npy": (npy(GREY.astype(np.int64)), "holds int64"),
    "int16.npy": (npy(GREY.astype(np.int16)), "holds int16"),
    "bool.npy": (npy(GREY > 0), "holds bool"),
    "complex.npy": (npy(GREY.astype(complex)), "complex128"),
    "text.npy": (npy(np.array([["a"]])), "<U1"),
    "fields.npy": (npy(np.zeros((2, 2), [("a", "f4")])), "expected float"),
    "object.npy": (npy(np.array([[{}]], object), allow_pickle=True), "not a readable NPY: "),
    "3d.npy": (npy(np.ones((9, 12, 5))), "shape (9, 12, 5)"),
    "rgb.npy": (npy(COLOUR), "3 channels"),
    "1d.npy": (npy(np.ones(5)), "shape (5,)"),
    "0d.npy": (npy(np.float32(1)), "shape ()"),
    "none.npy": (npy(np.ones((0, 4))), "is empty"),
    "header.npy": (b"\x93NUMPY\x01\x00\x10\x00import os; os.x()", "not a readable NPY"),
    "version.npy": (b"\x93NUMPY\x09\x00\x10\x00", "not a readable NPY"),
    "claims.npy": (npy(np.ones((2, 2))).replace(b"(2, 2)", b"(9**9)"), "not a readable NPY"),
    "large.npy": (
        npy(np.ones((2, 2))).replace(b"(2, 2), }  ", b"(99999, 9)}"),
        "not a readable NPY: ",
    ),
    "minus.npy": (npy_of_shape((-2, 2)), "not a readable NPY: "),
    "minuses.npy": (npy_of_shape((-2, -2)), "not a readable NPY: "),
    "true.npy": (npy_of_shape((True, 4)), "not a readable NPY: "),
    "deep.npy": (npy_of_shape((1,) * 99), "not a readable NPY: "),
    "archive.npz": (b"PK\x03\x04" + bytes(50), "NPZ archive"),
    "cloud.png": (b"ply\nformat ascii 1.0\n", "point cloud"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_wrong_file_is_refused_in_one_line(tmp_path, name, capfd):
    content, match = BAD[name]
    path = put(tmp_path, name, content)
    with pytest.raises((BadImage, BadFile)) as info:
        read_depth(path, camera=SMALL)
    message = str(info.value)
    assert message.startswith(f"{path}: ") and match in message and "\n" not in message
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    "body", [b"not zlib", zlib.compress(bytes(20)), zlib.compress(b"\x09" * 36)]
)
def test_a_png_whose_checksums_are_right_and_pixels_are_not_is_refused(tmp_path, body):
    with pytest.raises(BadImage, match="the PNG is cut off, damaged"):
        read_depth(put(tmp_path, "a.png", png(4, 4, 16, 0, body)))


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5, 0.7, 0.9, 0.99])
@pytest.mark.parametrize("name", GOOD)
def test_a_cut_off_file_is_refused_and_nothing_is_printed(tmp_path, name, share, capfd):
    whole = read_depth(put(tmp_path, "whole." + name, GOOD[name]))
    path = put(tmp_path, "a." + name, GOOD[name][: max(int(share * len(GOOD[name])), 4)])
    try:
        depth = read_depth(path)
    except BadImage as problem:
        assert "\n" not in str(problem)
    else:  # a TIFF's last bytes need not be pixels
        assert name.endswith("tiff") and share > 0.9
        np.testing.assert_array_equal(depth, whole)
    assert capfd.readouterr() == ("", "")


@settings(max_examples=150)
@given(st.data(), st.sampled_from(sorted(GOOD)))
def test_a_damaged_file_never_escapes_as_another_error(tmp_path_factory, data, name):
    content = bytearray(GOOD[name])
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path = put(tmp_path_factory.getbasetemp(), "damaged", bytes(content))
    try:
        depth = read_depth(path, camera=SMALL)
    except JShapeError as problem:
        assert "\n" not in str(problem)
    else:
        assert depth.shape == SMALL.shape


@given(st.binary(max_size=200), st.sampled_from([b"", *(c[:8] for c in GOOD.values())]))
def test_noise_never_escapes_as_another_error(tmp_path_factory, noise, start):
    with pytest.raises(JShapeError):
        read_depth(put(tmp_path_factory.getbasetemp(), "noise", start + noise))


def test_text_and_profiles_in_a_png_are_ignored_silently(tmp_path, capfd):
    profile = b"iCCPicc\0\0abcd"  # packed bytes that do not unpack
    broken_profile = struct.pack(">I", 9) + profile + struct.pack(">I", zlib.crc32(profile))
    content = GOOD["png"][:33] + broken_profile + GOOD["png"][33:] + b"trailing"
    np.testing.assert_allclose(read_depth(put(tmp_path, "a.png", content)), 4.5)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", ["none.png", ".", "x\0y", "n" * 300])
def test_no_such_file(tmp_path, name):
    with pytest.raises(BadFile) as info:
        read_depth(f"{tmp_path}/{name}")
    assert "\n" not in str(info.value)


@pytest.mark.parametrize("unit", [0.0, -1.0, float("nan"), float("inf")])
def test_a_bad_depth_unit(tmp_path, unit):
    path = put(tmp_path, "a.png", GOOD["png"])
    with pytest.raises(BadCamera, match="depth_unit"):
        read_depth(path, depth_unit=unit)


def test_the_wrong_unit_is_hinted_at(tmp_path):
    path = put(tmp_path, "a.png", GOOD["png"])
    assert read_depth(path, camera=SMALL, depth_unit=1e-4).shape == SMALL.shape
    with pytest.raises(BadImage, match="4.5 to 4.5 m.*0.4 to 0.5 m.*depth_unit 0.0001 instead"):
        read_depth(path, camera=SMALL)
    path = put(tmp_path, "mm.npy", npy(GREY / 10.0))
    with pytest.raises(BadImage, match="millimetres"):
        read_depth(path, camera=SMALL)
    with pytest.raises(BadImage) as info:
        check_depth(np.full(SMALL.shape, 0.8), SMALL, "here")
    assert "would fit" not in str(info.value)


def test_check_depth(rng):
    depth = rng.uniform(0.35, 0.55, SMALL.shape)
    assert check_depth(depth, SMALL) is depth
    check_depth(np.full(SMALL.shape, np.float32(0.5)), SMALL)  # the ends of the range are in it
    check_depth(np.full(SMALL.shape, np.float32(0.4)), SMALL)
    with pytest.raises(BadImage, match="goal: has 9x12 pixels; the camera makes 12x9"):
        check_depth(depth.T, SMALL, "goal")
    with pytest.raises(BadImage, match="no pixel"):
        check_depth(depth * np.nan, SMALL)
    stray = np.full(D435_BAZAR.shape, 4.5)
    stray[0, :9] = 0.45
    with pytest.raises(BadImage, match="0.1 times"):
        check_depth(stray, D435_BAZAR)


@settings(max_examples=50)
@given(
    hnp.arrays(
        np.uint16,
        hnp.array_shapes(min_dims=2, max_dims=2, max_side=20),
        elements=st.sampled_from([0, 1, 33_000, 65_534]) | st.integers(33_000, 65_534),
    )
)
def test_counts_survive_the_disk(tmp_path_factory, counts):
    path = tmp_path_factory.getbasetemp() / "counts.png"
    images.write_counts_png(path, counts)
    counts = only_readings(counts)  # a far code is none: a 1 that is there 16 times
    if counts.any():
        np.testing.assert_array_equal(read_counts(path), counts)
    else:
        with pytest.raises(BadImage):
            read_counts(path)


def test_write_depth_png(tmp_path, rng):
    depth = rng.uniform(0.3, 3.0, (9, 12))
    depth[0, :4] = 0, np.nan, np.inf, -1
    path = images.write_depth_png(tmp_path / "new" / "a.png", depth, 1e-4)
    found = read_depth(path, depth_unit=1e-4)
    assert np.isnan(found[0, :4]).all()
    np.testing.assert_allclose(found.ravel()[4:], depth.ravel()[4:], atol=0.5001e-4)


@pytest.mark.parametrize(
    "depth, match",
    [
        (np.full((3, 4), 6.6), "66000 counts"),
        (np.full((3, 4), 6.5535), "65535 counts .* at most 65534"),
        (np.full((3, 4), 1e-6), "less than half a count"),
        (np.full((3, 4, 1), 0.5), "shape"),
        (np.zeros((0, 4)), "shape"),
        (np.full((3, 4), "a"), "type"),
    ],
)
def test_what_16_bits_cannot_hold_is_not_written(tmp_path, depth, match):
    with pytest.raises(BadImage, match=match):
        images.write_depth_png(tmp_path / "a.png", depth, 1e-4)
    assert os.listdir(tmp_path) == []


def test_frames_are_16_bit(tmp_path):
    path = put(tmp_path, "a.png", encoded(".png", np.full((9, 12), 9, np.uint8)))
    with pytest.raises(BadImage, match="holds uint8; a frame is 16-bit"):
        read_counts(path)


def test_measured_frames(shared_data):
    raw = np.load(shared_data / "real/sand/kinect_v2_raw.npy")
    depth = read_depth(shared_data / "real/sand/kinect_v2_raw.npy")
    assert depth.shape == (424, 512)
    np.testing.assert_array_equal(np.isnan(depth), raw == 0)
    depth = read_depth(shared_data / "real/realsense_sr300/input-0.depth.png", depth_unit=1e-4)
    assert depth.shape == (480, 640) and 0.3 < np.isnan(depth).mean() < 0.4
    assert 0.5 < np.nanmedian(depth) < 1.0
    for path in sorted(shared_data.glob("real/sand/*.npz"))[:1]:
        with pytest.raises(BadImage, match="NPZ"):
            read_depth(path)


def test_frames_of_sequences(shared_data):
    for folder in sorted(shared_data.glob("mpm/seqs*/*")):
        depth = read_depth(folder / "0.png", depth_unit=1e-4, camera=PAPER_BOX)
        assert depth.shape == PAPER_BOX.shape


def test_a_frame_is_read_as_its_camera_stored_it(tmp_path, counts):
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(counts).save(tmp_path / "a.png", exif=exif)
    np.testing.assert_array_equal(read_array(tmp_path / "a.png"), counts)


@pytest.mark.parametrize(("magic", "said"), [(b"\x1f\x8b", "gzip"), (b"\x28\xb5\x2f\xfd", "Zst")])
def test_a_packed_file_is_named(tmp_path, magic, said):
    (tmp_path / "a.png").write_bytes(magic + bytes(30))
    with pytest.raises(BadImage, match=f"packed by {said}.*; unpack it; allowed: PNG"):
        read_depth(tmp_path / "a.png")


@pytest.mark.parametrize(
    "raw, unit, said",
    [
        (
            np.full(SMALL.shape, 4500, np.uint16),
            1e-3,
            "depth_unit 0.0001 instead of 0.001 would fit",
        ),
        (np.full(SMALL.shape, 450.0), 1e-3, "0.001 times those numbers .* millimetres"),
        (np.full(SMALL.shape, 0.00045), 1e-3, "1000 times those numbers would fit"),
    ],
)
def test_a_wrong_unit_is_named_where_depths_may_leave_the_range(raw, unit, said):
    with pytest.raises(BadImage, match=said):
        read_depth("image", raw=raw, depth_unit=unit, camera=SMALL, check_range=False)


@pytest.mark.parametrize("metres", [0.15, 0.45, 1.4, 2.0])
def test_a_bed_at_another_distance_has_no_wrong_unit(metres):
    raw = np.full(SMALL.shape, metres)
    assert (
        read_depth("image", raw=raw, camera=SMALL, check_range=False) == np.float32(metres)
    ).all()


def test_a_painting_of_16_bits_is_not_cut_to_8(tmp_path):
    grey = np.arange(108, dtype=np.uint16).reshape(9, 12) * 600
    path = put(tmp_path, "a.png", encoded(".png", np.dstack([grey, grey, grey])))
    with pytest.raises(BadImage, match="colour PNG of 16 bits; a painting has 8"):
        read_drawing(path)
    found = read_drawing(put(tmp_path, "b.png", encoded(".png", grey)))
    np.testing.assert_array_equal(found, grey)
