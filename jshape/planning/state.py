"""Where a search works: a map of the bed, the same wanted, and what each move does to a window.

Banks of f_D and networks are searched on the image itself: a node is a pixel.  Banks of f_P are
searched on the ground seen from above, which is looked at once instead of once per candidate: what
a move does there is the same at every place, and a window has a quarter of the pixels.  Arrays are
`[v, u]`; places are (v, u) here, since they index arrays.

Moves with one window size share one compiled kernel: their effects are stacked along a leading
axis, and the kernel gathers the one it needs.
"""

import math
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
from jshape.models.orthographic import OrthographicGrid
from jshape.models.turn import namespace

MARGIN = 4
"""Nodes beyond the image's edge: windows of the ground are up to a node larger than their ROI."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Move:
    """One action with one direction of the hand."""

    yaw: float | Array | np.floating
    """Turn of the hand from u towards v, radians."""
    action: int = field(metadata=STATIC)
    """Number of the action in the bank."""
    shape: tuple[int, int] = field(metadata=STATIC)
    """Rows and columns of its window; the place is node (rows // 2, columns // 2) of it."""
    roi: tuple[int, int] = field(metadata=STATIC)
    """ROI (w, h) in the image, pixels."""
    kernel: int = field(metadata=STATIC)
    """Number of its kernel among the state's."""
    member: int = field(metadata=STATIC)
    """Number of its effect in the kernel's stack."""

    @property
    def middle(self) -> np.ndarray:
        """(2,) the place's node in the window."""
        return np.array(self.shape, np.int32) // 2


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Kernel:
    """What the moves of one window size do: called on a window, once a member is gathered."""

    numbers: Float[Array, "G P"]
    """All numbers of each move's effect in one row: gathered with one copy."""
    form: tuple[Any, str, tuple[tuple[int, ...], ...]] = field(metadata=STATIC)
    """The effects' tree, the same in words, and the shapes of its leaves.

    In words too: for JAX 0.10 the trees of two dataclasses with as many fields are equal.
    """
    shape: tuple[int, int] = field(metadata=STATIC)
    """Rows and columns of the window."""

    def member(self, number: int | Int[Array, ""]) -> Any:
        """The effect of one move: (window, first node (u, v), strength) -> window after."""
        row = lax.dynamic_index_in_dim(self.numbers, number, 0, False)
        structure, _, shapes = self.form
        ends = np.cumsum([math.prod(shape) for shape in shapes])
        parts = [
            row[end - math.prod(shape) : end].reshape(shape)
            for shape, end in zip(shapes, ends.tolist(), strict=True)
        ]
        return jax.tree.unflatten(structure, parts)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class SearchState:
    """A map, the map wanted, and the moves.  A distance d is Σ weight·|now - goal|."""

    now: Float[Array, "R C"]
    goal: Float[Array, "R C"]
    weight: Float[Array, "R C"] | None
    """Of each node; None: all count alike, 1 / (R·C)."""
    moves: tuple[Move, ...]
    kernels: tuple[Kernel, ...]
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

    @property
    def shapes(self) -> Int[np.ndarray, "A 2"]:
        """Rows and columns of every move's window."""
        return np.array([move.shape for move in self.moves], np.int32).reshape(-1, 2)

    @property
    def actions(self) -> Int[np.ndarray, "A"]:
        """Every move's action."""
        return np.array([move.action for move in self.moves], np.int32)

    def with_kernel(self, number: int | Int[Array, ""], function, *operands: Any) -> Any:
        """`function(kernel, effect, *operands)` of one move: a branch per kernel, not per move."""
        kernels = np.array([move.kernel for move in self.moves], np.int32)
        member = jnp.asarray([move.member for move in self.moves], jnp.int32)[number]

        def branch(kernel: Kernel):
            return lambda member, *rest: function(kernel, kernel.member(member), *rest)

        branches = [branch(kernel) for kernel in self.kernels]
        return lax.switch(jnp.asarray(kernels)[number], branches, member, *operands)

    def act(
        self,
        number: int | Int[Array, ""],
        now: Float[Array, "R C"],
        first: Int[Array, "2"],
        strength: float | Array,
    ) -> Float[Array, "R C"]:
        """The map after a move, as the camera can see it.  Eq. predStep2 and predStep3."""

        def one(kernel, effect, now, first, strength):
            window = lax.dynamic_slice(now, first, kernel.shape)
            after = self.seen(effect(window, first[::-1], strength))
            return lax.dynamic_update_slice(now, after, first)

        strength = jnp.asarray(strength, jnp.float32)
        return self.with_kernel(number, one, now, jnp.asarray(first), strength)

    def seen(self, window: Float[Array, "n m"]) -> Float[Array, "n m"]:
        """A window limited to what the camera can see."""
        return jnp.clip(window, self.limits[0], self.limits[1])

    def change(
        self,
        kernel: Kernel,
        effect: Any,
        now: Float[Array, "R C"],
        first: Int[Array, "2"],
        strengths: Float[Array, "S"],
        count: int | Int[Array, ""],
    ) -> Float[Array, "S"]:
        """Change of d by an effect at one place, for the first `count` strengths; 0 for the rest.

        From its window alone.
        """
        before = lax.dynamic_slice(now, first, kernel.shape)
        goal = lax.dynamic_slice(self.goal, first, kernel.shape)

        def one(s, changes):
            after = self.seen(effect(before, first[::-1], strengths[s]))
            if self.weight is None:
                return changes.at[s].set(metric.roi_change(before, after, goal))
            closer = jnp.abs(after - goal) - jnp.abs(before - goal)
            weight = lax.dynamic_slice(self.weight, first, kernel.shape)
            # A product with ones sums the rows in the CPU's vector units.
            ones = jnp.ones(kernel.shape[0], closer.dtype)
            return changes.at[s].set(jnp.dot(ones, closer * weight).sum())

        changes = lax.fori_loop(0, count, one, jnp.zeros(strengths.shape, now.dtype))
        return changes / jnp.asarray(self.size, now.dtype)

    def node(self, pixel: np.ndarray) -> np.ndarray:
        """Nodes (N, 2) nearest to pixels (N, 2), both (v, u) (host)."""
        return np.rint((pixel - np.asarray(self.origin)) / np.asarray(self.pitch)).astype(np.int32)

    def pixel(self, node: np.ndarray) -> np.ndarray:
        """Pixels (N, 2) of nodes (N, 2), both (v, u), not rounded (host)."""
        return np.asarray(self.origin) + np.asarray(self.pitch) * node


def search_state(
    bank: Bank,
    image: Float[Any, "H W"],
    goal: Float[Any, "H W"],
    moves: Sequence[tuple[int, float | Array | None]] | None = None,
) -> SearchState:
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
    return on_images(bank, image, goal, *prepared(bank, moves))


def on_images(
    bank: Bank,
    image: Float[Any, "H W"],
    goal: Float[Any, "H W"],
    moves: tuple[Move, ...],
    kernels: tuple[Kernel, ...],
) -> SearchState:
    """The field with moves that are already prepared."""
    grid = _grid_of(bank)
    if grid is not None:
        return _on_grid(bank.camera, grid, image, goal, moves, kernels)
    return SearchState(
        now=jnp.asarray(image, jnp.float32),
        goal=jnp.asarray(goal, jnp.float32),
        weight=None,
        moves=moves,
        kernels=kernels,
        limits=jnp.array([0.0, 1.0], jnp.float32),
        origin=jnp.zeros(2, jnp.float32),
        pitch=jnp.ones(2, jnp.float32),
    )


def prepared(
    bank: Bank, moves: Sequence[tuple[int, float | Array | np.floating | None]]
) -> tuple[tuple[Move, ...], tuple[Kernel, ...]]:
    """The moves, and kernels that hold the effects of all with one window size.

    Called outside of `jit`, as in a plan, it compiles nothing.
    """
    on_grid = _grid_of(bank) is not None
    stacks: dict[Any, list[Array]] = {}
    made = []
    for action, yaw in moves:
        hand = bank.predictors[action]
        hand = hand if yaw is None else hand.turned(yaw)
        grid = hand.search_grid() if on_grid else None
        shape = hand.roi[::-1] if grid is None else grid.shape
        leaves, structure = jax.tree.flatten(hand if grid is None else hand.on_grid())
        key = (structure, str(structure), tuple(np.shape(leaf) for leaf in leaves)), shape
        xp = namespace(leaves)
        row = xp.concatenate([xp.asarray(leaf, np.float32).reshape(-1) for leaf in leaves])
        stack = stacks.setdefault(key, [])
        made.append(
            Move(
                yaw=0.0 if yaw is None else yaw, action=action, shape=shape, roi=hand.roi,
                kernel=list(stacks).index(key), member=len(stack),
            )
        )  # fmt: skip
        stack.append(row)
    kernels = tuple(
        Kernel(jnp.asarray(namespace(stack).stack(stack)), form, shape)
        for (form, shape), stack in stacks.items()
    )
    return tuple(made), kernels


def _grid_of(bank: Bank) -> OrthographicGrid | None:
    """The grid of the ground that the bank works on; None: on the image."""
    grids = [predictor.search_grid() for predictor in bank.predictors]
    return grids[0] if grids and all(g is not None for g in grids) else None


def _on_grid(
    camera: Camera,
    grid: OrthographicGrid,
    image: Array,
    goal: Array,
    moves: tuple[Move, ...],
    kernels: tuple[Kernel, ...],
) -> SearchState:
    """The whole view as one grid of the ground, at the pitch of the bank's own."""
    height, width = camera.shape
    # The grid's size is static, and so is taken from the ROI of an action and its grid.
    rows, columns = (
        round(n * g / r) + 2 * MARGIN
        for n, g, r in zip(camera.shape, grid.shape, grid.roi[::-1], strict=True)
    )
    whole = OrthographicGrid(camera, grid.depth, grid.pitch, (rows, columns), (width, height))
    first = jnp.zeros(2, jnp.int32)
    per_metre = whole.per_metre(first)
    depths = camera.z_max - jnp.stack([image, goal]) / per_metre[None]
    now, wanted = jax.vmap(lambda depth: whole.from_roi(depth, first))(depths)
    pitch = grid.pitch * jnp.stack([jnp.asarray(f, jnp.float32) for f in (camera.fy, camera.fx)])
    pitch = pitch / grid.depth
    middle = [jnp.array(size, jnp.float32) // 2 for size in ((height, width), (rows, columns))]
    origin = middle[0] - middle[1] * pitch
    return SearchState(
        now=now,
        goal=wanted,
        weight=_weight(camera, whole, (now + wanted) / 2),
        moves=moves,
        kernels=kernels,
        limits=jnp.stack([jnp.asarray(z, jnp.float32) for z in (camera.z_min, camera.z_max)]),
        origin=origin,
        pitch=pitch,
    )


def _weight(camera: Camera, whole: OrthographicGrid, depth: Array) -> Array:
    """By how much d changes per metre at each node: how many pixels see it, and their weight."""
    x, y = whole.nodes(jnp.zeros(2, jnp.int32))
    x, y = x[None, :], y[:, None]
    u, v = camera.fx * x / depth + camera.u0, camera.fy * y / depth + camera.v0
    height, width = camera.shape
    seen = (u >= -0.5) & (u <= width - 0.5) & (v >= -0.5) & (v <= height - 0.5)
    pixels = camera.fx * camera.fy * (whole.pitch / depth) ** 2
    ray = jnp.sqrt(1.0 + (x**2 + y**2) / depth**2) / metric.max_ray_length(camera)
    unit = (camera.z_max - camera.z_min) * height * width
    return jnp.where(seen, pixels * ray, 0.0) / unit
