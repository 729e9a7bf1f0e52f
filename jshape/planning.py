"""The main job: an image and a goal in, a plan out.

Thin host wrappers: they check what came, turn names into arrays, call one compiled search and
read its answer.  Nothing is compiled anew for another image, goal, place, least gain or tolerance;
another `max_steps`, or another number of places, is another shape.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jshape import actions as places
from jshape import metric
from jshape._typing import ArrayLike
from jshape.camera import Camera
from jshape.data.depth import to_metres
from jshape.data.view import View, image_of_depth, view_of
from jshape.errors import BadBank, BadImage, BadPosition, JShapeError, UnknownName
from jshape.planners import PLANNERS
from jshape.planners.base import Limits, Status
from jshape.predict.bank import Bank
from jshape.predict.sweep import candidates_at

DEFAULT_BANK = "pressed-flour-robot"
MAX_STEPS = 1000
"""Most actions of a plan: the predicted ROI of each has its place in memory from the start."""


@dataclass(frozen=True, eq=False)
class Plan:
    """Which actions to apply, where, in which order, and what is predicted to come out."""

    camera: Camera
    """The camera of the images."""
    actions: tuple[str, ...]
    """K names, in the order to apply them."""
    positions: np.ndarray
    """(K, 2) of (u, v) pixels: ROI centres; the ROI starts at (u - w // 2, v - h // 2)."""
    rois: np.ndarray
    """(K, 2) ROI sizes (w, h), pixels."""
    distances: np.ndarray
    """(K+1,) predicted d to the goal before and after each action, recomputed on whole images."""
    status: Status
    """Why the plan ends."""
    evaluations: int = 0
    """ROI predictions made."""
    clipped: np.ndarray = field(default_factory=lambda: np.zeros(0, np.float32))
    """(K,) share of each predicted ROI that had to be clipped to [0, 1]."""
    filled: tuple[int, int] = (0, 0)
    """Pixels without a depth reading that were filled: in the initial image, in the goal."""
    clamped: tuple[int, int] = (0, 0)
    """Pixels beyond the camera's depth range, taken for its end: likewise."""
    view: View | None = None
    """How the camera's frames became those of `camera`; None: they were its own."""
    initial: np.ndarray | None = None
    """(H, W) the image I0 that was planned from."""
    goal: np.ndarray | None = None
    """(H, W) the image wanted."""
    patches: tuple[np.ndarray, ...] = ()
    """K predicted ROIs (h, w) of I, one per action."""

    def __len__(self) -> int:
        return len(self.actions)

    @property
    def distances_mm(self) -> np.ndarray:
        """`distances` as the mean 3-D distance of matched points, mm."""
        return np.asarray(metric.to_mm(self.distances, self.camera))

    @property
    def camera_positions(self) -> np.ndarray:
        """(K, 2) of (u, v): `positions` in the own pixels of the camera that took the frames."""
        if self.view is None:
            return self.positions
        return self.view.pixels(self.positions)

    @cached_property
    def images(self) -> np.ndarray:
        """(K+1, H, W) predicted I: I0, then the image after each action.  Eq. predStep3."""
        if self.initial is None:
            raise JShapeError("this plan was stored without its images")
        firsts = places.first_pixels(self.positions, self.rois)
        return np.stack([i.copy() for i in _successive(self.initial, self.patches, firsts)])

    def to_json(self, path: str | Path, *, images: bool = True) -> None:
        """Write the plan to a file, with I0 and the predicted ROIs unless `images` is False.

        Raises:
          BadFile: the file cannot be written.
        """
        from jshape.store.plans import write_plan

        write_plan(path, self, images=images)

    @staticmethod
    def from_json(path: str | Path) -> "Plan":
        """Read a plan that `to_json` wrote.

        Raises:
          BadFile: the file is not a plan.
        """
        from jshape.store.plans import read_plan

        return read_plan(path)


def plan(
    I0: ArrayLike,
    Istar: ArrayLike,
    *,
    bank: Bank | str | Path | None = None,
    planner: str = "greedy",
    positions: ArrayLike | Mapping[str, ArrayLike] | str | None = None,
    max_steps: int = 16,
    min_gain: float = 0.0,
    tolerance: float = 0.0,
    clip: str = "refuse",
) -> Plan:
    """The sequence of actions that molds image I0 into Istar, as the bank predicts it.

    Args:
      I0: (H, W) weighed image I of the bed now (see `jshape.weigh`), floats in [0, 1].
      Istar: (H, W) the image wanted.
      bank: a `Bank`, the name of a bundled one or a folder; None is the bundled default.
      planner: which search.
      positions: (N, 2) of (u, v) ROI centres for all actions, a mapping of action to such, or a
        grid "21x15" (columns x rows) that spans the image for each action; None is the paper's
        grid of 15, the same for all actions.
      max_steps: most actions in the plan.
      min_gain: an action must lower d by more than this.
      tolerance: stop when d is at most this.
      clip: what to do with given positions whose ROI leaves the image: "refuse", "shift", "drop".

    Raises:
      BadImage: wrong shape, type, range, or pixels without a reading.
      BadPosition: a ROI leaves the image.
      UnknownName: no such planner, bank or action.
    """
    bank = _as_bank(bank)
    first = check_image(I0, bank.camera, "I0")
    goal = check_image(Istar, bank.camera, "Istar")
    if planner not in tuple(PLANNERS):
        raise UnknownName("planner", planner, PLANNERS)
    if not isinstance(max_steps, int | np.integer) or not 0 <= max_steps <= MAX_STEPS:
        raise JShapeError(f"max_steps is {max_steps!r}; it must be a whole number to {MAX_STEPS}")
    for name, value in (("min_gain", min_gain), ("tolerance", tolerance)):
        if not isinstance(value, int | float | np.number) or not 0 <= value < np.inf:
            raise JShapeError(f"{name} is {value!r}; it must be a number of d from 0")
    where = placed_positions(bank, positions, clip)
    candidates = candidates_at(bank, where)
    limits = Limits(float(min_gain), float(tolerance))
    found = jax.device_get(
        PLANNERS[planner](bank, first, goal, candidates, limits, max_steps=int(max_steps))
    )

    steps = int(found.steps)
    chosen = [candidates.locate(int(index)) for index in found.chosen[:steps]]
    names = tuple(bank.actions[action] for action, _ in chosen)
    centres = [where[bank.actions[action]][index] for action, index in chosen]
    positions = np.array(centres, np.int32).reshape(-1, 2)
    rois = np.array([bank.roi(name) for name in names], np.int32).reshape(-1, 2)
    patches = tuple(found.patches[k, :h, :w] for k, (w, h) in enumerate(rois))
    # The search adds up changes of ROIs, which drifts by rounding: measure again on whole images.
    images = _successive(first, patches, places.first_pixels(positions, rois))
    distances = np.array([metric.distance(image, goal) for image in images], np.float32)
    return Plan(
        camera=bank.camera,
        actions=names,
        positions=positions,
        rois=rois,
        distances=distances,
        status=Status.CONVERGED if distances[-1] <= tolerance else Status(int(found.status)),
        evaluations=int(found.evaluations),
        clipped=found.clipped[:steps],
        initial=first,
        goal=goal,
        patches=patches,
    )


def _successive(
    initial: np.ndarray, patches: tuple[np.ndarray, ...], firsts: np.ndarray
) -> Iterator[np.ndarray]:
    """I0 and the image after each patch; one buffer, so copy what you keep."""
    image = np.array(initial)
    yield image
    for (left, top), patch in zip(firsts, patches, strict=True):
        h, w = patch.shape
        image[top : top + h, left : left + w] = patch
        yield image


def plan_depth(
    z0: ArrayLike,
    zstar: ArrayLike,
    *,
    bank: Bank | str | Path | None = None,
    camera: Camera | None = None,
    reproject: bool = False,
    depth_unit: float = 0.001,
    max_missing: float = 0.1,
    names: tuple[str, str] = ("z0", "zstar"),
    **options: Any,
) -> Plan:
    """`plan` from raw depth images: metres as floats, or uint16 counts of `depth_unit` metres.

    Depth 0, NaN or infinity is "no reading": such pixels are filled from their surroundings, and
    the plan's `filled` says how many.  The luminance keeps fractions of a level, so that a bed
    seen in 16 bits is not rounded to the 256 levels of the paper's camera.

    Args:
      z0: (H, W) depth of the bed now.
      zstar: (H, W) the depth wanted.
      bank: as for `plan`.
      camera: that took the frames; None is the bank's own.  If the bank's image is a window of
        this camera's, it is cut out.
      reproject: see the frames of another camera, or from another distance, as the bank's camera
        would.  `plan.camera_positions` are the places in the camera's own pixels.
      depth_unit: metres per count of integer images.
      max_missing: largest share of pixels without a reading that may be filled.
      names: what to call the two images in errors.
      **options: passed on to `plan`.

    Raises:
      MissingDepth: too many pixels without a reading.
      BadCamera: the bank is for another camera.
      BadImage: wrong shape or type, or too much of it beyond the camera's depth range.
    """
    bank = _as_bank(bank)
    view = None
    if camera is not None:
        first = to_metres(np.asarray(z0), depth_unit, names[0])
        view = view_of(camera, bank.camera, first, reproject=reproject)
    now, wanted = (
        image_of_depth(
            depth,
            bank.camera,
            view=view,
            depth_unit=depth_unit,
            max_missing=max_missing,
            where=name,
        )
        for name, depth in zip(names, (z0, zstar), strict=True)
    )
    return replace(
        plan(now.image, wanted.image, bank=bank, **options),
        filled=(now.filled, wanted.filled),
        clamped=(now.clamped, wanted.clamped),
        view=view,
    )


def check_image(image: ArrayLike, camera: Camera, where: str) -> np.ndarray:
    """`image` as (H, W) float32 if it is a weighed image of the camera (a host check).

    Raises:
      BadImage: naming what came and what is allowed.
    """
    array = np.asarray(image)
    if array.dtype.kind != "f":
        raise BadImage(
            f"{where} has type {array.dtype}; a weighed image I has floats in [0, 1] "
            "(see jshape.weigh; for raw depth call jshape.plan_depth)"
        )
    if array.shape != camera.shape:
        raise BadImage(
            f"{where} has shape {array.shape}; the bank's camera makes {camera.shape} "
            "(rows, columns)"
        )
    bad = int(np.count_nonzero(~np.isfinite(array)))
    if bad:
        raise BadImage(
            f"{where} has {bad} pixels that are NaN or infinite; fill them first "
            "(jshape.plan_depth does)"
        )
    low, high = float(array.min()), float(array.max())
    if low < 0 or high > 1 + 1e-5:
        raise BadImage(f"{where} has values from {low:g} to {high:g}; a weighed image is in [0, 1]")
    return np.ascontiguousarray(array, np.float32)


def placed_positions(
    bank: Bank, positions: ArrayLike | Mapping[str, ArrayLike] | str | None, clip: str = "refuse"
) -> dict[str, np.ndarray]:
    """Positions (N_a, 2) per action of a bank, all ROIs inside the image (host).

    None is the paper's 5 x 3 grid, laid so that the bank's largest ROI fits everywhere; "21x15"
    is a grid as wide as each action's own ROI allows.
    """
    rois = bank.rois
    if positions is None:
        per_action = dict.fromkeys(bank.actions, places.grid(bank.camera, margin=bank.largest_roi))
    elif isinstance(positions, str):
        size = re.fullmatch(r"([1-9]\d{0,3})x([1-9]\d{0,3})", positions)
        if not size:
            raise BadPosition(f"positions {positions!r}: a grid is written COLUMNSxROWS")
        columns, rows = int(size[1]), int(size[2])
        per_action = {
            name: places.grid(bank.camera, columns, rows, margin=roi) for name, roi in rois.items()
        }
    elif isinstance(positions, Mapping):
        unknown = [name for name in positions if name not in bank.actions]
        if unknown:
            raise UnknownName("action", unknown[0], bank.actions)
        per_action = {name: _as_positions(where) for name, where in positions.items()}
    else:
        per_action = dict.fromkeys(bank.actions, _as_positions(positions))
    return places.place(bank.camera, per_action, rois, clip)


def _as_positions(positions: ArrayLike) -> np.ndarray:
    try:
        array = np.asarray(positions)
    except ValueError:
        raise BadPosition("positions are not (N, 2): they have rows of different length") from None
    if array.size == 0:
        return np.zeros((0, 2), np.int32)
    whole = array.dtype.kind in "iuf" and np.all(np.abs(array) < 2**31)
    if array.ndim != 2 or array.shape[1] != 2 or not whole or np.any(array != np.rint(array)):
        raise BadPosition(
            f"positions have shape {array.shape} and type {array.dtype}; "
            "they must be (N, 2) whole pixels (u, v)"
        )
    return array.astype(np.int32)


def _as_bank(bank: Bank | str | Path | None) -> Bank:
    if isinstance(bank, Bank):
        if not bank.actions or len(bank.actions) != len(bank.predictors):
            raise BadBank(
                f"the bank has {len(bank.actions)} actions and {len(bank.predictors)} predictors; "
                "it must have one per action"
            )
        return bank
    from jshape.store.banks import load_bank

    return load_bank(DEFAULT_BANK if bank is None else bank)
