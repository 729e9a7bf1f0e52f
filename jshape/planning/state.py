"""Where a search works: a map of the bed, the same wanted, and what each move does to a window.

Banks of f_D and networks are searched on the image itself: a node is a pixel.  Banks of f_P are
searched on the height map, which is resampled once instead of once per candidate: what
a move does there is the same at every place, and a window has a quarter of the pixels.  Arrays are
`[v, u]`; places are (v, u) here, since they index arrays.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jshape import metric
from jshape._typing import Array, Bool, Float, Int
from jshape.camera import STATIC, Camera, in_memory, namespace
from jshape.models.bank import Bank
from jshape.models.orthographic import OrthographicGrid
from jshape.planning.kernels import Kernel, Move, grid_of, prepared

TOGETHER = 65_536
"""Nodes of windows that are evaluated together."""
MARGIN = 4
"""Nodes beyond the image's edge: windows of nodes are up to a node larger than their ROI."""


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
    node_m: Float[Array, ""] | None = None
    """Side of a node's square, metres; None: the map is an image."""
    carry_over: float | None = field(default=None, metadata=STATIC)
    """The predictors' own (see `Predictor.carry_over`), the greatest."""
    carries: tuple[tuple[int, int], ...] = field(default=(), metadata=STATIC)
    """Actions tried in pairs: (takes material out, brings it elsewhere)."""
    price: Float[Any, ""] | None = None
    """What a search pays for Σ weight·now to rise by 1 (see `problem.price`); None: nothing."""

    @property
    def distance(self) -> Float[Array, ""]:
        """The distance d between the map and the map wanted."""
        return self.distance_of(self.now)

    def distance_of(self, now: Float[Array, "R C"]) -> Float[Array, ""]:
        """D of another map.  Columns first: on a CPU faster than both axes at once."""
        apart = jnp.abs(now - self.goal)
        return (apart if self.weight is None else apart * self.weight).sum(0).sum() / self.size

    def objective(self, now: Float[Array, "R C"]) -> Float[Array, ""]:
        """What a search lowers: d, and the price of what was lost."""
        if self.price is None:
            return self.distance_of(now)
        lost = now - self.goal
        lost = lost if self.weight is None else lost * self.weight
        return self.distance_of(now) + self.price * lost.sum(0).sum() / self.size

    @property
    def lower(self) -> float:
        """1 where the map's numbers grow as the bed is dug; -1 for images I."""
        return -1.0 if self.node_m is None else 1.0

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

    def with_kernel(
        self, number: int | Int[Array, ""], function, *operands: Any, apply: bool = False
    ) -> Any:
        """`function(kernel, effect, before, *operands)` of one move: a branch per kernel.

        `before` is how many nodes its kernel's window begins before the move's own.  Kernels are
        those that evaluate moves, or those that apply them.
        """
        places = [move.applied if apply else move.evaluated for move in self.moves]
        kernels = sorted({kernel for kernel, _ in places})
        chosen = np.array([[kernels.index(kernel), member] for kernel, member in places], np.int32)
        windows = np.array([self.kernels[kernel].shape for kernel, _ in places], np.int32)
        branch, member = jnp.asarray(chosen)[number]
        before = jnp.asarray(windows // 2 - self.shapes // 2)[number]

        def of(kernel: Kernel):
            return lambda member, *rest: function(kernel, kernel.member(member), *rest)

        branches = [of(self.kernels[kernel]) for kernel in kernels]
        return lax.switch(branch, branches, member, before, *operands)

    def act(
        self,
        number: int | Int[Array, ""],
        now: Float[Array, "R C"],
        first: Int[Array, "2"],
        strength: float | Array,
    ) -> Float[Array, "R C"]:
        """The map after a move, as the camera can see it.  Eq. predStep2 and predStep3."""

        def one(kernel, effect, before, now, first, strength):
            window = lax.dynamic_slice(now, first - before, kernel.shape)
            after = self.seen(effect(window, first[::-1], strength))
            return lax.dynamic_update_slice(now, after, first - before)

        strength = jnp.asarray(strength, jnp.float32)
        return self.with_kernel(
            number, one, now, jnp.asarray(first, jnp.int32), strength, apply=True
        )

    def seen(self, window: Float[Array, "*B n m"]) -> Float[Array, "*B n m"]:
        """A window limited to what the camera can see."""
        return jnp.clip(window, self.limits[0], self.limits[1])

    def windows(
        self, kernel: Kernel, now: Float[Array, "R C"], first: Int[Array, "K 2"]
    ) -> list[Float[Array, "*K n m"]]:
        """A kernel's windows that begin there: of the map, the goal and the weights, if any."""
        maps = [now, self.goal] if self.weight is None else [now, self.goal, self.weight]

        def cut(k: int | Array) -> list[Array]:
            return [lax.dynamic_slice(whole, first[k], kernel.shape) for whole in maps]

        def cut_next(k: Array, windows: list[Array]) -> list[Array]:
            return [some.at[k].set(new) for some, new in zip(windows, cut(k), strict=True)]

        if len(first) == 1:  # an axis of length 1 would cost time
            return cut(0)
        none = jnp.zeros((len(first), *kernel.shape), now.dtype)
        return lax.fori_loop(0, len(first), cut_next, [none] * len(maps))

    def change(
        self,
        effect: Any,
        windows: list[Float[Array, "*K n m"]],
        first: Int[Array, "K 2"],
        strength: Float[Array, ""],
    ) -> Float[Array, "K"]:
        """Change of the objective by an effect in a few windows, whose first nodes are given."""
        before, goal, *weight = windows
        at = first[0, ::-1] if before.ndim == 2 else first[:, ::-1]
        after = self.seen(effect(before, at, strength))
        closer = jnp.abs(after - goal) - jnp.abs(before - goal)
        closer = closer if self.price is None else closer + self.price * (after - before)
        closer = closer * weight[0] if weight else closer
        return _sums(closer) / jnp.asarray(self.size, before.dtype)

    def together(self, kernel: Kernel) -> int:
        """How many places are evaluated together on a CPU: as many as stay in its caches.

        On images one: a window of f_D is read once, and larger.
        """
        if self.weight is None:
            return 1
        return int(np.clip(TOGETHER // math.prod(kernel.shape), 1, 8))

    def most_gain(
        self,
        before: Float[Array, "R C"],
        after: Float[Array, "R C"],
        first: Int[Array, "N 2"],
        shapes: Int[Array, "N 2"],
    ) -> Float[Array, "N"]:
        """By how much windows' gains can grow at most when the map changes.

        A gain is Σ weight·(|e| - |f|) with e = now - goal before the action and f after it.  If e
        becomes e + x, and f becomes f + s·x with s in [0, 1], no node's term grows by more than
        |e + x| - |e| + |x|: by nothing where the map came nearer to the goal without passing it.
        With a price by p·(1 - s)·x more.
        """
        near = jnp.abs(after - self.goal) - jnp.abs(before - self.goal)
        reach = 1.0 + (self.carry_over or 0.0)
        reach = reach if self.price is None else reach + jnp.abs(self.price)
        return self._within(near + reach * jnp.abs(after - before), first, shapes)

    def most_left(
        self, now: Float[Array, "R C"], first: Int[Array, "N 2"], shapes: Int[Array, "N 2"]
    ) -> Float[Array, "N"]:
        """What windows can gain at most: how far they are from the goal, and that at the price."""
        reach = 1.0 if self.price is None else 1.0 + jnp.abs(self.price)
        return self._within(reach * jnp.abs(now - self.goal), first, shapes)

    def _within(self, more: Array, first: Array, shapes: Array) -> Float[Array, "N"]:
        """The parts in windows of a weighted sum over the map; never too little by rounding."""
        more = (more if self.weight is None else more * self.weight) / self.size
        # Sums of windows as differences of sums from the corner, by products with triangles.
        rows, columns = (np.tri(n + 1, n, k=-1, dtype=np.float32) for n in more.shape)
        table = jnp.matmul(rows, more, precision="highest")
        table = jnp.matmul(table, columns.T, precision="highest")
        (top, left), (bottom, right) = first.T, (first + shapes).T
        sums = table[bottom, right] - table[top, right] - table[bottom, left] + table[top, left]
        return jnp.maximum(sums, 0.0) + 1e-5 * table[-1, -1]  # rounding

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
    moves: Sequence[tuple[int, float | Array | None, float]] | None = None,
) -> SearchState:
    """The field that a bank is searched on; traceable in the images and the bank's numbers.

    Args:
      bank: of any kind.
      image: I now.
      goal: I wanted.
      moves: (action number, yaw, length) of each, yaw None for a hand that is not turned; None:
        every action as it was trained.
    """
    if moves is None:
        moves = [(a, None, 1.0) for a in range(len(bank.actions))]
    return on_images(bank, image, goal, *prepared(bank, moves))


def on_images(
    bank: Bank,
    image: Float[Any, "H W"],
    goal: Float[Any, "H W"],
    moves: tuple[Move, ...],
    kernels: tuple[Kernel, ...],
    seen: Bool[np.ndarray, "H W"] | None = None,
) -> SearchState:
    """The field with moves that are already prepared; pixels that were not `seen` count nothing."""
    known = [predictor.carry_over for predictor in bank.predictors]
    carry_over = None if None in known else max(known, default=None)
    grid = grid_of(bank)
    if grid is not None:
        state = _on_grid(bank.camera, grid, image, goal, moves, kernels, seen)
        return replace(state, carry_over=carry_over)
    xp = namespace(image, goal, kernels)
    numbers = {
        "now": xp.asarray(image, np.float32),
        "goal": xp.asarray(goal, np.float32),
        "weight": None if seen is None else np.asarray(seen / seen.sum(), np.float32),
        "limits": np.array([0.0, 1.0], np.float32),
        "origin": np.zeros(2, np.float32),
        "pitch": np.ones(2, np.float32),
    }
    numbers, kernels = _sent((numbers, kernels))
    return SearchState(**numbers, moves=moves, kernels=kernels, carry_over=carry_over)


def _sent(numbers: Any) -> Any:
    """Arrays in the device's memory, all in one transfer: one by one they take 0.2 ms each."""
    known = namespace(numbers) is np
    return jax.device_put(numbers) if known else jax.tree.map(jnp.asarray, numbers)


def _sums(windows: Float[Array, "*B n m"]) -> Float[Array, "K"]:
    """The sum of each window, as products with ones: a CPU computes those in its vector units."""
    if windows.ndim == 2:
        ones = np.ones((1, len(windows)), np.float32)
        return jnp.matmul(ones, windows, precision="highest").sum(-1)
    flat = windows.reshape(len(windows), -1)
    return jnp.matmul(flat, np.ones(flat.shape[1], np.float32), precision="highest")


def _on_grid(
    camera: Camera,
    grid: OrthographicGrid,
    image: Any,
    goal: Any,
    moves: tuple[Move, ...],
    kernels: tuple[Kernel, ...],
    seen: Bool[np.ndarray, "H W"] | None,
) -> SearchState:
    """The whole view as one height map, at the pitch of the bank's own."""
    height, width = camera.shape
    # The grid's size is static, and so is taken from the ROI of an action and its grid.
    rows, columns = (
        round(n * g / r) + 2 * MARGIN
        for n, g, r in zip(camera.shape, grid.shape, grid.roi[::-1], strict=True)
    )
    xp = namespace(camera, grid, image, goal)
    if xp is np:
        camera, grid, image, goal = in_memory((camera, grid, image, goal))
    whole = OrthographicGrid(camera, grid.depth, grid.pitch, (rows, columns), (width, height))
    first = np.zeros(2, np.int32)
    per_metre = whole.per_metre(first)
    now, wanted = (whole.from_roi(camera.z_max - one / per_metre, first) for one in (image, goal))
    weight = _weight(camera, whole, (now + wanted) / 2, seen)
    pitch = xp.stack([xp.asarray(f, np.float32) for f in camera.scale(grid.depth)[::-1]])
    pitch = pitch * grid.pitch
    # Windows of kernels may reach beyond the map: by nodes that count for nothing.
    far = max(
        (
            (w - n + 1) // 2
            for move in moves
            for w, n in zip(kernels[move.applied[0]].shape, move.shape, strict=True)
        ),
        default=0,
    )
    middle = np.array([height // 2, width // 2], np.float32)
    origin = middle - np.array([rows // 2 + far, columns // 2 + far], np.float32) * pitch
    numbers = {
        "now": xp.pad(now, far, mode="edge"),
        "goal": xp.pad(wanted, far, mode="edge"),
        "weight": xp.pad(weight, far),
        "limits": xp.stack([xp.asarray(z, np.float32) for z in (camera.z_min, camera.z_max)]),
        "origin": origin,
        "pitch": pitch,
        "node_m": grid.pitch,
    }
    numbers = {name: xp.asarray(one, np.float32) for name, one in numbers.items()}
    numbers, kernels = _sent((numbers, kernels))
    return SearchState(**numbers, moves=moves, kernels=kernels)


def _weight(
    camera: Camera, whole: OrthographicGrid, depth: Any, known: Bool[np.ndarray, "H W"] | None
) -> Any:
    """By how much d changes per metre at each node: how many pixels see it, and their weight."""
    xp = namespace(camera, whole, depth)
    x, y = whole.nodes(np.zeros(2, np.int32))
    x, y = x[None, :], y[:, None]
    u, v = camera.pixel(x, y, depth)
    height, width = camera.shape
    seen = (u >= -0.5) & (u <= width - 0.5) & (v >= -0.5) & (v <= height - 0.5)
    across, along = camera.scale(depth)
    pixels = across * along * whole.pitch**2
    ray = metric.slant(camera, x / depth, y / depth) / xp.asarray(metric.max_ray_length(camera))
    unit = (camera.z_max - camera.z_min) * height * width
    if known is not None:
        row, column = (
            xp.clip(xp.round(at), 0, n - 1).astype(np.int32) for at, n in ((v, height), (u, width))
        )
        seen, unit = seen & xp.asarray(known)[row, column], unit * np.float32(known.mean())
    return xp.where(seen, pixels * ray, 0.0) / unit
