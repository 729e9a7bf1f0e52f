"""A RealSense without a cable: the SDK's software device, into which frames are pushed."""

import numpy as np
import pyrealsense2 as rs

from jshape.camera import Camera
from jshape.robot.cameras.realsense import FrameSource

SERIAL = "000000000001"


class Virtual:
    """A virtual D435; with `path`, the SDK's own recorder writes what is pushed to a .db3."""

    def __init__(self, camera: Camera, unit: float, path=None, coeffs=(0.0,) * 5, model=None):
        self.camera, self.unit, self.count = camera, unit, 0
        lens = rs.intrinsics()
        lens.width, lens.height = camera.width, camera.height
        lens.fx, lens.fy = float(camera.fx), float(camera.fy)
        lens.ppx, lens.ppy = float(camera.u0), float(camera.v0)
        lens.model, lens.coeffs = model or rs.distortion.brown_conrady, list(coeffs)
        self.device = rs.software_device()
        self.device.register_info(rs.camera_info.name, "virtual D435")
        self.device.register_info(rs.camera_info.serial_number, SERIAL)
        self.sensor = self.device.add_sensor("Stereo Module")
        stream = rs.video_stream()
        stream.type, stream.index, stream.uid = rs.stream.depth, 0, 0
        stream.width, stream.height = camera.width, camera.height
        stream.fps, stream.bpp, stream.fmt = 30, 2, rs.format.z16
        stream.intrinsics = lens
        self.profile = self.sensor.add_video_stream(stream)
        self.sensor.add_read_only_option(rs.option.depth_units, unit)
        self.sensor.add_read_only_option(rs.option.stereo_baseline, 50.0)
        self.queue = rs.frame_queue(64, keep_frames=True)
        self.recorder = None if path is None else rs.recorder(str(path), self.device)
        self.started = self.recorder.query_sensors()[0] if self.recorder else self.sensor
        self.started.open(self.profile)
        self.started.start(self.queue)

    def push(self, counts: np.ndarray) -> None:
        self.count += 1
        frame = rs.software_video_frame()
        frame.stride, frame.bpp = self.camera.width * 2, 2
        frame.timestamp, frame.frame_number = self.count * 1e3 / 30, self.count
        frame.domain = rs.timestamp_domain.hardware_clock
        frame.profile = self.profile.as_video_stream_profile()
        frame.depth_units = self.unit
        frame.pixels = np.ascontiguousarray(counts)
        self.sensor.on_video_frame(frame)

    def source(self):
        """For `realsense_camera(...)`."""

        def wait(milliseconds):
            there, frame = self.queue.try_wait_for_frame(milliseconds)
            return frame if there else None

        video, name = self.profile.as_video_stream_profile(), f"virtual D435 {SERIAL}"
        return FrameSource(name, video, self.unit, wait, lambda: False, lambda: None, True)

    def stop(self) -> None:
        self.started.stop()
        self.started.close()
        self.started = self.recorder = None  # the recording is complete when the recorder is gone


def record(path, camera: Camera, unit: float, frames) -> None:
    """A .db3 of the SDK with these frames."""
    device = Virtual(camera, unit, path)
    for counts in frames:
        device.push(counts)
        device.queue.wait_for_frame(5000)  # not faster than the recorder writes
    device.stop()
