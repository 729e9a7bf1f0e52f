"""Bags as ROS 1, ROS 2 and MCAP record them, written for a test."""

import struct
from pathlib import Path

import cv2
import numpy as np
from rosbags import rosbag1, rosbag2
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import Stores, get_typestore

from jshape.camera import Camera

TOPIC = "/camera/depth/image_rect_raw"
INFO = "/camera/depth/camera_info"
FORMATS = ("ros1", "ros2", "mcap")

QUANTISATION = 100.0
FARTHEST = 10.0


def write_bag(path: Path, how: str, topics) -> Path:
    """A bag of one of `FORMATS`; `topics` is (topic, [message makers]) pairs, taken in turn.

    A maker is called with (types, seconds, ros1) and returns a message.  Returns what to open.
    """
    ros1 = how == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    if ros1:
        path = path.with_suffix(".bag")
        writer = rosbag1.Writer(path)
    else:
        plugin = StoragePlugin.MCAP if how == "mcap" else StoragePlugin.SQLITE3
        writer = rosbag2.Writer(path, version=9, storage_plugin=plugin)
    pack = store.serialize_ros1 if ros1 else store.serialize_cdr
    with writer as bag:
        connections = {}
        for topic, makers in topics:
            for k, make in enumerate(makers):
                message = make(store.types, k, ros1)
                kind = message.__msgtype__
                if topic not in connections:
                    connections[topic] = bag.add_connection(topic, kind, typestore=store)
                bag.write(connections[topic], 10**9 * (1 + k), pack(message, kind))
    return path


def header(types, k, ros1):
    stamp = types["builtin_interfaces/msg/Time"](sec=1 + k, nanosec=0)
    more = {"seq": k} if ros1 else {}
    return types["std_msgs/msg/Header"](stamp=stamp, frame_id="depth", **more)


def image(array, encoding=None, big=False, pad=0):
    """A maker of a sensor_msgs/Image, its rows padded by some bytes."""
    name = encoding or {"u2": "16UC1", "f4": "32FC1"}[array.dtype.str[1:]]

    def make(types, k, ros1):
        stored = array.astype(array.dtype.newbyteorder(">" if big else "<"))
        rows = stored.view(np.uint8).reshape(len(array), -1)
        rows = np.pad(rows, ((0, 0), (0, pad)))
        return types["sensor_msgs/msg/Image"](
            header=header(types, k, ros1), height=array.shape[0], width=array.shape[1],
            encoding=name, is_bigendian=int(big), step=rows.shape[1], data=rows.reshape(-1).copy(),
        )  # fmt: skip

    return make


def packed(array, quality="; compressedDepth png", rvl=False):
    """A maker of what compressed_depth_image_transport sends: counts, or metres as 1/z."""
    if array.dtype == np.uint16:
        name, a, b, counts = "16UC1", 0.0, 0.0, array
    else:
        name, a = "32FC1", QUANTISATION * (QUANTISATION + 1)
        b = 1.0 - a / FARTHEST
        good = np.isfinite(array) & (array > 0) & (array < FARTHEST)
        inverse = a / np.where(good, array, 1.0) + b
        counts = np.where(good, np.rint(inverse), 0).astype(np.uint16)
    data = struct.pack("<iff", 0, a, b)
    data += encode_rvl(counts) if rvl else cv2.imencode(".png", counts)[1].tobytes()

    def make(types, k, ros1):
        return types["sensor_msgs/msg/CompressedImage"](
            header=header(types, k, ros1), format=name + quality,
            data=np.frombuffer(data, np.uint8),
        )  # fmt: skip

    return make


def rvl(array):
    """The same, packed by RVL."""
    return packed(array, "; compressedDepth rvl", rvl=True)


def encode_rvl(counts: np.ndarray) -> bytes:
    """Counts (H, W) as image_transport packs them: its loop over the pixels, written out."""
    nibbles, before, at = [], 0, 0
    flat = [int(count) for count in counts.reshape(-1)]

    def number(value):
        while True:
            nibbles.append(value & 7 | (8 if value > 7 else 0))
            value >>= 3
            if not value:
                return

    while at < len(flat):
        zeros = next((k for k, count in enumerate(flat[at:]) if count), len(flat) - at)
        at += zeros
        there = next((k for k, count in enumerate(flat[at:]) if not count), len(flat) - at)
        number(zeros)
        number(there)
        for count in flat[at : at + there]:
            difference, before = count - before, count
            number(2 * difference if difference >= 0 else -2 * difference - 1)
        at += there
    nibbles += [0] * (-len(nibbles) % 8)
    text = "".join(f"{nibble:x}" for nibble in nibbles)
    words = [int(text[k : k + 8], 16) for k in range(0, len(text), 8)]
    return struct.pack(f"<II{len(words)}I", *counts.shape[::-1], *words)


def png(array, form="16UC1; png compressed "):
    """A maker of what compressed_image_transport sends of counts."""
    data = np.frombuffer(cv2.imencode(".png", array)[1].tobytes(), np.uint8)

    def make(types, k, ros1):
        return types["sensor_msgs/msg/CompressedImage"](
            header=header(types, k, ros1), format=form, data=data
        )

    return make


def without_index(path: Path) -> Path:
    """An MCAP without its summary, as a recorder that was killed leaves it."""
    data = path.read_bytes()
    at = 8
    while data[at] != 0x0F:  # the end of the data
        at += 9 + struct.unpack("<Q", data[at + 1 : at + 9])[0]
    end = at + 9 + struct.unpack("<Q", data[at + 1 : at + 9])[0]
    path.write_bytes(data[:end] + b"\x02" + struct.pack("<QQQI", 20, 0, 0, 0) + data[:8])
    return path


def info(camera: Camera, distortion=(0.0,) * 5, size=None, p=None, roi=(), binning=0, **wrong):
    """A maker of the CameraInfo of a camera; `wrong` replaces fx, fy, u0 or v0 of K and P.

    `p` holds other numbers for P (fx, fy, u0, v0), `roi` left, top, width, height and do_rectify.
    """
    model = wrong.pop("model", "plumb_bob")
    n = {f: float(wrong.get(f, getattr(camera, f))) for f in ("fx", "fy", "u0", "v0")}
    width, height = size or (camera.width, camera.height)
    k9 = np.array([n["fx"], 0, n["u0"], 0, n["fy"], n["v0"], 0, 0, 1], float)
    fx, fy, u0, v0 = (n["fx"], n["fy"], n["u0"], n["v0"]) if p is None else p
    p12 = np.array([fx, 0, u0, 0, 0, fy, v0, 0, 0, 0, 1, 0], float) * (fx != 0)
    left, top, w, h, distinct = (*roi, 0, 0, 0, 0, 0)[:5]

    def make(types, k, ros1):
        region = types["sensor_msgs/msg/RegionOfInterest"](
            x_offset=left, y_offset=top, height=h, width=w, do_rectify=bool(distinct)
        )
        return types["sensor_msgs/msg/CameraInfo"](
            header(types, k, ros1), height, width, model, np.array(distortion, float), k9,
            np.eye(3).reshape(-1), p12, binning, binning, region,
        )  # fmt: skip

    return make


def depth_bag(path: Path, how: str, camera: Camera, frames, make=image) -> Path:
    """The usual bag: depth frames and their CameraInfo."""
    topics = [(TOPIC, [make(f) for f in frames]), (INFO, [info(camera)] * len(frames))]
    return write_bag(path, how, topics)
