"""The depth camera on the twin's wrist, drawn by MuJoCo."""

import weakref
from typing import Any

import jax
import numpy as np

from jshape import sim
from jshape._typing import Array, Float, Key
from jshape.robot.cameras.played import Played, calls
from jshape.robot.cameras.simulated import NOISE
from jshape.robot.twin.engine import mujoco, renderer
from jshape.robot.twin.world import Twin

DEPTH_UNIT = 1e-4
"""Metres per count: tenths of a millimetre, which a D435 can be set to."""


class MuJoCoCamera(Played):
    """Sees what stands before the twin's wrist camera now."""

    def __init__(self, twin: Twin, key: Key[Array, ""], noise: float = NOISE):
        """The camera of a twin; `noise` at 0.45 m in metres (0: no holes either), `key` for it."""
        name, frames = "D435 on the wrist (MuJoCo)", calls(self._counts)
        still = noise == 0  # the same bed gives the same frame
        super().__init__(name, twin.camera, DEPTH_UNIT, frames, still=still, close=self._let_go)
        self._twin, self._noise, self._key = twin, noise, key
        self._renderer: Any = None
        self._shown = -1

    def _counts(self) -> np.ndarray:
        depth = self.depth()
        if self._noise:
            self._key, key = jax.random.split(self._key)
            depth = np.asarray(sim.sensor(key, depth, self._noise))
        return np.array(sim.to_uint16(depth, self.depth_unit))

    def depth(self) -> Float[np.ndarray, "H W"]:
        """Depth along the optical axis without noise, metres; 0 where there is nothing.

        Raises:
          NoPicture: MuJoCo cannot draw here.
        """
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

    def _let_go(self) -> None:
        if self._renderer is not None:
            self._end()
            self._renderer = None


def upload_bed(renderer: Any, twin: Twin) -> None:
    """Give a `mujoco.Renderer` the bed as it is now.

    The context is private in MuJoCo 3 and 4, and there is no other way to it.
    """
    if renderer._gl_context:
        renderer._gl_context.make_current()
    mujoco().mjr_uploadHField(twin.model, renderer._mjr_context, twin.model.hfield("bed").id)
