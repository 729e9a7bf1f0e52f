"""Where a search works: a map of the bed, the same wanted, and what each move does to a window.

Banks of f_D and networks are searched on the image itself: a node is a pixel.  Banks of f_P are
searched on the ground seen from above, which is looked at once instead of once per candidate: what
a move does there is the same at every place, and a window has a quarter of the pixels.  Arrays are
`[v, u]`; places are (v, u) here, since they index arrays.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jshape import metric
from jshape._typing import Array, Float, Int
from jshape.camera import STATIC, Camera
from jshape.models.bank import Bank
from jshape.models.imprint import Press
from jshape.models.orthographic import Ground

MARGIN = 4
"""Nodes beyond the image's edge: windows of the ground are up to a node larger than their ROI."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Move:
    """One action with one direction of the hand, as it changes a field."""

    effect: Any
    """A predictor of ROIs, or the `Press` of one."""
    yaw: float | Array
    """Turn of the hand from u towards v, radians."""
    action: int = field(metadata=STATIC)
    """Number of the action in the bank."""
    shape: tuple[int, int] = field(metadata=STATIC)
    """Rows and columns of its window; the place is node (rows // 2, columns // 2) of it."""
    roi: tuple[int, int] = field(metadata=STATIC)
    """ROI (w, h) in the image, pixels."""

    @property
    def middle(self) -> np.ndarray:
        """(2,) the place's node in the window."""
        return np.array(self.shape, np.int32) // 2

    def __call__(
        self, window: Float[Array, "n m"], first: Int[Array, "2"], strength: float | Array
    ) -> Float[Array, "n m"]:
        """The window after the move, before it is limited to what the camera can see."""
        if isinstance(self.effect, Press):
            return window + self.effect.change(window, strength)
        return self.effect(window, first, strength)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Terrain:
    """A map, the map wanted, and the moves.  A distance d is Σ weight·|now - goal|."""

    now: Float[Array, "R C"]
    goal: Float[Array, "R C"]
    weight: Float[Array, "R C"] | None
    """Of each node; None: all count alike, 1 / (R·C)."""
    moves: tuple[Move, ...]
    limits: Float[Array, "2"]
    """Least and greatest value that the camera can see."""
    origin: Float[Array, "2"]
    """Pixel (v, u) of the node (0, 0)."""
    pitch: Float[Array, "2"]
    """Pixels per node along v and u."""

    @property
    def distance(self) -> Float[Array, ""]:
        """D between the map and the map wanted."""
        return self.distance_of(self.now)

    def distance_of(self, now: Float[Array, "R C"]) -> Float[Array, ""]:
        """D of another map.  Columns first: on a CPU faster than both axes at once."""
        apart = jnp.abs(now - self.goal)
        return (apart if self.weight is None else apart * self.weight).sum(0).sum() / self.size

    @property
    def size(self) -> int | float:
        """What sums over nodes are divided by."""
        return self.now.size if self.weight is None else 1.0

    def after(
        self, move: Move, now: Float[Array, "R C"], first: Int[Array, "2"], strength: float | Array
    ) -> Float[Array, "n m"]:
        """The window at `first` after a move, as the camera can see it.  Eq. predStep2."""
        window = lax.dynamic_slice(now, first, move.shape)
        return jnp.clip(move(window, first, strength), self.limits[0], self.limits[1])

    def act(
        self, move: Move, now: Float[Array, "R C"], first: Int[Array, "2"], strength: float | Array
    ) -> Float[Array, "R C"]:
        """The map after a move.  Eq. predStep3."""
        return lax.dynamic_update_slice(now, self.after(move, now, first, strength), first)

    def change(
        self,
        move: Move,
        now: Float[Array, "R C"],
        first: Int[Array, "2"],
        strengths: Float[Array, "S"],
    ) -> Float[Array, "S"]:
        """Change of d by a move at one place, for each strength, from its window alone."""
        before = lax.dynamic_slice(now, first, move.shape)
        goal = lax.dynamic_slice(self.goal, first, move.shape)

        def one(strength):
            after = jnp.clip(move(before, first, strength), self.limits[0], self.limits[1])
            if self.weight is None:
                return metric.roi_change(before, after, goal)
            closer = jnp.abs(after - goal) - jnp.abs(before - goal)
            weight = lax.dynamic_slice(self.weight, first, move.shape)
            # A product with ones sums the rows in the CPU's vector units.
            return jnp.dot(jnp.ones(move.shape[0], closer.dtype), closer * weight).sum()

        return lax.map(one, strengths) / self.size

    def node(self, pixel: np.ndarray) -> np.ndarray:
        """Nodes (N, 2) nearest to pixels (N, 2), both (v, u) (host)."""
        return np.rint((pixel - np.asarray(self.origin)) / np.asarray(self.pitch)).astype(np.int32)

    def pixel(self, node: np.ndarray) -> np.ndarray:
        """Pixels (N, 2) of nodes (N, 2), both (v, u), not rounded (host)."""
        return np.asarray(self.origin) + np.asarray(self.pitch) * node


def terrain_of(
    bank: Bank,
    image: Float[Array, "H W"],
    goal: Float[Array, "H W"],
    moves: Sequence[tuple[int, float | Array | None]] | None = None,
) -> Terrain:
    """The field that a bank is searched on; traceable in the images and the bank's numbers.

    Args:
      bank: of any kind.
      image: I now.
      goal: I wanted.
      moves: (action number, yaw) of each, yaw None for a hand that is not turned; None: every
        action, not turned.
    """
    if moves is None:
        moves = [(a, None) for a in range(len(bank.actions))]
    hands = [
        (a, 0.0, bank.predictors[a]) if yaw is None else (a, yaw, bank.predictors[a].turned(yaw))
        for a, yaw in moves
    ]
    grounds = [hand.ground for *_, hand in hands if hasattr(hand, "ground")]
    if len(grounds) < len(hands) or not grounds:
        made = tuple(Move(h, yaw, a, (h.roi[1], h.roi[0]), h.roi) for a, yaw, h in hands)
        return Terrain(
            now=jnp.asarray(image, jnp.float32),
            goal=jnp.asarray(goal, jnp.float32),
            weight=None,
            moves=made,
            limits=jnp.array([0.0, 1.0], jnp.float32),
            origin=jnp.zeros(2, jnp.float32),
            pitch=jnp.ones(2, jnp.float32),
        )
    made = tuple(Move(h.ready(), yaw, a, h.ground.shape, h.roi) for a, yaw, h in hands)
    return _on_ground(bank.camera, grounds[0], image, goal, made)


def _on_ground(camera: Camera, ground: Ground, image, goal, moves: tuple[Move, ...]) -> Terrain:
    """The whole view as one grid of the ground, at the pitch of the bank's own."""
    height, width = camera.shape
    # The grid's size is static, and so is taken from the ROI of an action and its grid.
    rows, columns = (
        round(n * g / r) + 2 * MARGIN
        for n, g, r in zip(camera.shape, ground.shape, ground.roi[::-1], strict=True)
    )
    whole = Ground(camera, ground.depth, ground.pitch, (rows, columns), (width, height))
    first = jnp.zeros(2, jnp.int32)
    per_metre = whole.per_metre(first)
    now, wanted = (whole.from_roi(camera.z_max - i / per_metre, first) for i in (image, goal))
    pitch = ground.pitch * jnp.stack([jnp.asarray(f, jnp.float32) for f in (camera.fy, camera.fx)])
    pitch = pitch / ground.depth
    middle = [jnp.array(size, jnp.float32) // 2 for size in ((height, width), (rows, columns))]
    origin = middle[0] - middle[1] * pitch
    return Terrain(
        now=now,
        goal=wanted,
        weight=_weight(camera, whole, (now + wanted) / 2),
        moves=moves,
        limits=jnp.stack([jnp.asarray(z, jnp.float32) for z in (camera.z_min, camera.z_max)]),
        origin=origin,
        pitch=pitch,
    )


def _weight(camera: Camera, whole: Ground, depth: Array) -> Array:
    """By how much d changes per metre at each node: how many pixels see it, and their weight."""
    x, y = whole.nodes(jnp.zeros(2, jnp.int32))
    x, y = x[None, :], y[:, None]
    u, v = camera.fx * x / depth + camera.u0, camera.fy * y / depth + camera.v0
    height, width = camera.shape
    seen = (u >= -0.5) & (u <= width - 0.5) & (v >= -0.5) & (v <= height - 0.5)
    pixels = camera.fx * camera.fy * (whole.pitch / depth) ** 2
    ray = jnp.sqrt(1.0 + (x**2 + y**2) / depth**2) / metric.max_ray_length(camera)
    return seen * pixels * ray / ((camera.z_max - camera.z_min) * height * width)
