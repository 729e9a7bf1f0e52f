"""The depth camera on the twin's wrist, drawn by MuJoCo."""

import weakref
from contextlib import AbstractContextManager
from typing import Any

import jax
import numpy as np

from jshape import sim
from jshape._typing import Array, Float, Key, Num
from jshape.robot.cameras.base import CameraLost
from jshape.robot.twin.engine import mujoco, renderer
from jshape.robot.twin.world import Twin

DEPTH_UNIT = 1e-4
"""Metres per count: tenths of a millimetre, which a D435 can be set to."""


class MuJoCoCamera(AbstractContextManager):
    """Sees what stands before the twin's wrist camera now; implements `DepthCamera`."""

    name = "D435 on the wrist (MuJoCo)"

    def __init__(
        self,
        twin: Twin,
        *,
        key: Key[Array, ""] | None = None,
        depth_unit: float = DEPTH_UNIT,
        noise: float = 0.00045,
    ):
        """The camera of a twin; `noise` at 0.45 m in metres (0: no holes either), `key` for it."""
        self.camera = twin.camera
        self.depth_unit = depth_unit
        self.still = noise == 0
        """Without noise the same bed gives the same frame."""
        self._twin, self._noise = twin, noise
        self._key = jax.random.key(1) if key is None else key
        self._renderer: Any = None
        self._shown = -1
        self._closed = False

    def frame(self) -> Num[np.ndarray, "H W"]:
        """A frame: counts of `depth_unit`, 0 = no reading; raises as `depth`."""
        depth = self.depth()
        if self._noise:
            self._key, key = jax.random.split(self._key)
            depth = np.asarray(sim.sensor(key, depth, self._noise))
        return np.array(sim.to_uint16(depth, self.depth_unit))

    def depth(self) -> Float[np.ndarray, "H W"]:
        """Depth along the optical axis without noise, metres; 0 where there is nothing.

        Raises:
          CameraLost: it was closed.
          NoPicture: MuJoCo cannot draw here.
        """
        if self._closed:
            raise CameraLost(f"{self.name}: closed")
        twin, engine = self._twin, mujoco()
        if self._renderer is None:
            self._renderer = renderer(twin.model, self.camera.width, self.camera.height)
            self._renderer.enable_depth_rendering()
            # At the interpreter's exit it would come too late, with a traceback.
            self._end = weakref.finalize(self, self._renderer.close)
        if self._shown != twin.shown:  # or the picture would keep the bed of before
            upload_bed(self._renderer, twin)
            self._shown = twin.shown
        engine.mj_forward(twin.model, twin.data)
        self._renderer.update_scene(twin.data, camera="depth")
        depth = np.array(self._renderer.render(), np.float32)
        far = twin.model.vis.map.zfar * twin.model.stat.extent
        return np.where(depth < 0.99 * far, depth, 0.0).astype(np.float32)

    def close(self) -> None:
        """Let go of the renderer; a second time does nothing."""
        self._closed = True
        if self._renderer is not None:
            self._end()
            self._renderer = None

    def __exit__(self, *problem: object) -> None:
        self.close()


def upload_bed(renderer: Any, twin: Twin) -> None:
    """Give a `mujoco.Renderer` the bed as it is now.

    The context is private in MuJoCo 3 and 4, and there is no other way to it.
    """
    if renderer._gl_context:
        renderer._gl_context.make_current()
    mujoco().mjr_uploadHField(twin.model, renderer._mjr_context, twin.model.hfield("bed").id)
