"""Intel RealSense cameras through their SDK: live, or from what the SDK has recorded.

What a device says of itself is taken from it: intrinsics, metres per count, name.  The filters are
the SDK's own.
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jshape.data.intrinsics import bent, pinhole, same_frames
from jshape.errors import BadCamera, BadFile, JShapeError, one_line
from jshape.robot.cameras.base import TIMEOUT, CameraLost, CameraSettings, EndOfFrames
from jshape.robot.cameras.played import Played, calls

SIZE, FPS = (848, 480), 30
"""Of a device's frames: (width, height), and how many a second."""
SUFFIXES = (".db3", ".bag")
"""Recordings of the SDK: .db3 since 2.58, .bag before."""
ALPHA = 0.4
"""Weight of the newest frame in the SDK's temporal filter (its default)."""
REACH = 0.01
"""Metres by which a pixel must change to be taken as it is instead of being smoothed: more than
noise.  The SDK counts in depth units, 1 to 100 of them."""
PERSISTENCE = 3
"""A missing pixel keeps its last depth if two of the last four frames had one (SDK default)."""

_POLL_MS = 200


class FrameSource(NamedTuple):
    """Where depth frames of the SDK come from."""

    name: str
    profile: Any
    """The SDK's video stream profile of the depth stream."""
    unit: float
    """Metres per count."""
    wait: Callable[[int], Any]
    """The next depth frame within so many milliseconds, or None."""
    ended: Callable[[], bool]
    """Whether none will ever come, since a recording is at its end."""
    stop: Callable[[], None]
    live: bool


def realsense_camera(
    source: FrameSource, *, temporal: bool = True, holes: bool = False, timeout: float = TIMEOUT
) -> Played:
    """A camera over the frames of a device (`connected`) or of a recording (`played`).

    Args:
      source: of the frames; stopped as the camera is closed.
      temporal: smooth over time and bridge short gaps, by the SDK's filter.  Not for recordings
        that are averaged later: a hand that leaves stays for some frames where nothing is read.
      holes: fill what has no reading from its farthest neighbour.  Off: jshape counts missing
        readings, and fills better where they are few.
      timeout: seconds after which it counts as lost.

    Raises:
      BadCamera: intrinsics that make no sense, or a lens of another model than Brown-Conrady.
    """
    rs = sdk()
    # A float32 as the shortest decimal that gives it back: 0.0001, not 0.00009999999747.
    unit, filters = float(str(np.float32(source.unit))), []
    try:
        lens = source.profile.get_intrinsics()
        focal, centre = (lens.fx, lens.fy), (lens.ppx, lens.ppy)
        pixels = (lens.width, lens.height)
        if bent(lens.coeffs) and lens.model != rs.distortion.brown_conrady:
            raise BadCamera(
                f"{source.name}: the lens distorts by the model {one_line(lens.model, 60)}, "
                "of which none but brown_conrady is read; rectify the frames first"
            )
        camera = pinhole(source.name, pixels, focal, centre, lens.coeffs)
        if temporal:
            near = float(np.clip(REACH / unit, 1, 100))
            filters.append(rs.temporal_filter(ALPHA, near, PERSISTENCE))
        if holes:
            filters.append(rs.hole_filling_filter())
    except BaseException:
        source.stop()
        raise

    def frame() -> np.ndarray:
        now = _next(source, timeout)
        for each in filters:
            now = each.process(now)
        return np.array(now.as_depth_frame().get_data())

    return Played(source.name, camera, unit, calls(frame), live=source.live, close=source.stop)


def _next(source: FrameSource, timeout: float) -> Any:
    until = time.monotonic() + timeout
    while True:
        ended = source.ended()  # asked before: a last frame may have come before the end
        left = until - time.monotonic()
        try:
            frame = source.wait(max(1, min(_POLL_MS, round(1000 * left))))
        except RuntimeError as problem:
            raise CameraLost(f"{source.name}: is lost: {one_line(problem)}") from None
        if frame is not None:
            return frame
        if ended:
            raise EndOfFrames(f"{source.name}: has no more frames")
        if left <= 0:
            lost = f"has sent nothing for {timeout:g} s; is it unplugged?"
            raise CameraLost(f"{source.name}: {lost}")


def open_realsense(address: str, settings: CameraSettings) -> Played:
    """The only one for "", one of several by its serial number, or a recording by its path."""
    settings.check_own(f"realsense:{address}" if address else "realsense", unit_only=True)
    recorded = Path(address).suffix.lower() in SUFFIXES
    source = played(address) if recorded else connected(address)
    opened = realsense_camera(source, temporal=settings.temporal, holes=settings.holes)
    if settings.camera is not None:  # its unit is the device's all the same
        try:
            size = (opened.camera.width, opened.camera.height)
            opened.camera = same_frames(settings.camera[0], size, opened.name)
        except BaseException:
            opened.close()
            raise
    return opened


class Device(NamedTuple):
    """A connected camera."""

    name: str
    serial: str


def devices() -> list[Device]:
    """The RealSense cameras that are connected; JShapeError: the SDK is not installed."""
    rs = sdk()
    both = (rs.camera_info.name, rs.camera_info.serial_number)
    try:
        return [Device(*map(one.get_info, both)) for one in rs.context().query_devices()]
    except RuntimeError as problem:
        raise CameraLost(f"RealSense cameras cannot be listed: {one_line(problem)}") from None


def sdk() -> Any:
    """The SDK's module; JShapeError: it is not installed, or cannot be loaded."""
    try:
        import pyrealsense2 as rs
    except ImportError as problem:
        raise JShapeError(
            "RealSense cameras need the SDK: pip install 'jshape[realsense]', and on Debian "
            f"apt install libusb-1.0-0 ({one_line(problem, 100)})"
        ) from None
    return rs


def connected(serial: str = "") -> FrameSource:
    """Frames of a device that is plugged in: that of a serial number, else the first.

    Raises CameraLost if it is not, or does not start.
    """
    rs = sdk()
    found = devices()  # the pipeline would wait a quarter of a minute for one to come
    if not found:
        raise CameraLost("no RealSense camera is connected")
    if serial and serial not in [d.serial for d in found]:
        names = ", ".join(f"{d.name} {d.serial}" for d in found)
        raise CameraLost(f"no RealSense camera {serial} is connected; there is {names}")
    pipe, config = rs.pipeline(), rs.config()
    if serial:
        config.enable_device(serial)
    config.enable_stream(rs.stream.depth, *SIZE, rs.format.z16, FPS)
    try:
        started = pipe.start(config)
    except RuntimeError as problem:
        raise CameraLost(
            f"RealSense {serial or found[0].serial} does not start with {SIZE[0]}x{SIZE[1]} at "
            f"{FPS} frames/s: {one_line(problem)}"
        ) from None
    return _piped(rs, pipe, started, live=True)


def played(file: str | Path) -> FrameSource:
    """Every frame of a recording of the SDK.  Raises BadFile if it cannot be played."""
    rs = sdk()
    file = Path(file)
    if not file.is_file():
        raise BadFile(f"{file}: {'is not a file' if file.exists() else 'no such file'}")
    if file.suffix.lower() not in SUFFIXES:
        raise BadFile(f"{file}: the SDK's recordings are {' or '.join(SUFFIXES)}")
    pipe, config = rs.pipeline(), rs.config()
    try:
        config.enable_device_from_file(str(file), repeat_playback=False)
        config.enable_stream(rs.stream.depth)
        # Before it starts: in real time, frames that are not asked for in time are dropped.
        ready = config.resolve(rs.pipeline_wrapper(pipe)).get_device().as_playback()
        ready.set_real_time(False)
        started = pipe.start(config)
    except RuntimeError as problem:
        reason = str(problem).rpartition("Reason: ")[2]
        raise BadFile(
            f"{file}: not a recording of the RealSense SDK with depth, or damaged: "
            f"{one_line(reason, 120)}"
        ) from None
    return _piped(rs, pipe, started, live=False)


def _piped(rs: Any, pipe: Any, started: Any, *, live: bool) -> FrameSource:
    def wait(milliseconds: int) -> Any:
        there, frames = pipe.try_wait_for_frames(milliseconds)
        frame = frames.get_depth_frame() if there else None
        return frame or None

    device = started.get_device()
    player = None if live else device.as_playback()

    def ended() -> bool:
        return player is not None and player.current_status() == rs.playback_status.stopped

    try:
        name = device.get_info(rs.camera_info.name)
        if device.supports(rs.camera_info.serial_number):
            name += f" {device.get_info(rs.camera_info.serial_number)}"
        profile = started.get_stream(rs.stream.depth).as_video_stream_profile()
        unit = device.first_depth_sensor().get_depth_scale()
        return FrameSource(name, profile, unit, wait, ended, pipe.stop, live)
    except RuntimeError as problem:
        pipe.stop()
        raise CameraLost(f"RealSense: says nothing of itself: {one_line(problem)}") from None
