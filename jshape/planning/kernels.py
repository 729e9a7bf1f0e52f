"""Moves of a search, and the compiled kernels that they share.

Moves with one window size share one kernel: their effects are stacked along a leading axis, and the
kernel gathers the one it needs.  On the height map, zeros around an effect change nothing: all
directions of a hand share the window of its turned ones, and all moves the kernel that applies
them.  Arrays are `[v, u]`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np
from jax import lax

from jshape._typing import Array, Float, Int
from jshape.camera import STATIC, namespace
from jshape.models.bank import Bank
from jshape.models.orthographic import OrthographicGrid

ALIKE = 0.7
"""Windows at least this share of a larger one use its kernel: what is compiled takes longer than
what is evaluated."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Move:
    """One action with one direction of the hand."""

    yaw: float | Array | np.floating
    """Turn of the hand from u towards v, radians."""
    length: float | Array | np.floating
    """How many times as long as the trained action the hand's path is."""
    path_m: float | Array | np.floating
    """From end to end of that path, metres; 0 without one."""
    action: int = field(metadata=STATIC)
    """Number of the action in the bank."""
    shape: tuple[int, int] = field(metadata=STATIC)
    """Rows and columns of its window; the place is node (rows // 2, columns // 2) of it."""
    roi: tuple[int, int] = field(metadata=STATIC)
    """ROI (w, h) in the image, pixels."""
    evaluated: tuple[int, int] = field(metadata=STATIC)
    """Numbers of the kernel that evaluates it, and of its effect in the kernel's stack."""
    applied: tuple[int, int] = field(metadata=STATIC)
    """Likewise of the kernel that applies it."""

    @property
    def middle(self) -> np.ndarray:
        """(2,) the place's node in the window."""
        return np.array(self.shape, np.int32) // 2


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Kernel:
    """What the moves of one window do: called on a window, once a member is gathered."""

    numbers: Float[Any, "G P"]
    """All numbers of each move's effect in one row: gathered with one copy."""
    form: tuple[Any, str, tuple[tuple[int, ...], ...]] = field(metadata=STATIC)
    """The effects' tree, the same in words, and the shapes of its leaves.

    In words too: for JAX 0.10 the trees of two dataclasses with as many fields are equal.
    """
    shape: tuple[int, int] = field(metadata=STATIC)
    """Rows and columns of the window."""

    def member(self, number: int | Int[Array, ""]) -> Any:
        """The effect of one move: (windows, first nodes (u, v), strength) -> windows after."""
        row = lax.dynamic_index_in_dim(self.numbers, number, 0, False)
        structure, _, shapes = self.form
        ends = np.cumsum([math.prod(shape) for shape in shapes])
        parts = [
            row[end - math.prod(shape) : end].reshape(shape)
            for shape, end in zip(shapes, ends.tolist(), strict=True)
        ]
        return jax.tree.unflatten(structure, parts)


def prepared(
    bank: Bank, moves: Sequence[tuple[int, float | Array | np.floating | None, float]]
) -> tuple[tuple[Move, ...], tuple[Kernel, ...]]:
    """The moves, and kernels that hold the effects of all with one window.

    Called outside of `jit`, as in a plan, it compiles nothing.
    """
    on_grid = grid_of(bank) is not None
    hands, shapes = [], []
    for action, yaw, length in moves:
        hand = bank.placed(action, yaw, length)
        grid = hand.search_grid() if on_grid else None
        hands.append(hand)
        shapes.append(hand.roi[::-1] if grid is None else grid.shape)
    stacks: dict[Any, list[Array]] = {}

    def stacked(hand: Any, shape: tuple[int, int], window: tuple[int, int]) -> tuple[int, int]:
        leaves, structure = jax.tree.flatten(hand.on_grid() if on_grid else hand)
        xp = namespace(leaves)
        ahead = [w // 2 - n // 2 for w, n in zip(window, shape, strict=True)]
        frame = [(a, w - n - a) for a, w, n in zip(ahead, window, shape, strict=True)]
        leaves = [xp.asarray(leaf, np.float32) for leaf in leaves]
        leaves = [
            xp.pad(leaf, frame) if window != shape and leaf.shape == shape else leaf
            for leaf in leaves
        ]
        key = (structure, str(structure), tuple(leaf.shape for leaf in leaves)), window
        stack = stacks.setdefault(key, [])
        stack.append(xp.concatenate([leaf.reshape(-1) for leaf in leaves]))
        return list(stacks).index(key), len(stack) - 1

    windows = _windows([(a, length) for a, _, length in moves], shapes) if on_grid else shapes
    whole = _union(shapes) if on_grid else None
    made = []
    for move, hand, shape, window in zip(moves, hands, shapes, windows, strict=True):
        action, yaw, length = move
        evaluated = stacked(hand, shape, window)
        made.append(
            Move(
                yaw=0.0 if yaw is None else yaw,
                length=np.float32(length),
                path_m=np.float32(1e-3 * bank.predictors[action].path_mm * length),
                action=action,
                shape=shape,
                roi=hand.roi,
                evaluated=evaluated,
                applied=evaluated if whole in (None, window) else stacked(hand, shape, whole),
            )
        )
    kernels = tuple(
        Kernel(namespace(stack).stack(stack), form, shape)
        for (form, shape), stack in stacks.items()
    )
    return tuple(made), kernels


def _windows(
    hands: Sequence[tuple[int, float]], shapes: Sequence[tuple[int, int]]
) -> list[tuple[int, int]]:
    """Windows of kernels: all yaws of a hand (action, length) share one, as hands of a size do."""
    own = [_union([s for b, s in zip(hands, shapes, strict=True) if b == a]) for a in hands]
    shared: dict[tuple[int, int], tuple[int, int]] = {}
    for window in sorted(set(own), key=math.prod, reverse=True):
        hold = [w for w in shared.values() if _union([w, window]) == w]
        near = [w for w in hold if math.prod(window) >= ALIKE * math.prod(w)]
        shared[window] = min(near, key=math.prod, default=window)
    return [shared[window] for window in own]


def _union(shapes: Sequence[tuple[int, int]]) -> tuple[int, int]:
    return max(rows for rows, _ in shapes), max(columns for _, columns in shapes)


def grid_of(bank: Bank) -> OrthographicGrid | None:
    """The height-map grid that the bank works on; None: on the image."""
    grids = [predictor.search_grid() for predictor in bank.predictors]
    return grids[0] if grids and all(g is not None for g in grids) else None
