"""A plan: what to do, what is predicted to come out, and how to keep it."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jshape import actions as places
from jshape import metric
from jshape.actions import PlacedAction, linked
from jshape.camera import Camera, matrix
from jshape.data.view import View
from jshape.errors import JShapeError
from jshape.height_map import HeightMap, map_of, places_on
from jshape.planning import intervals, plan_file
from jshape.planning.search.base import Status

if TYPE_CHECKING:
    from matplotlib.figure import Figure


ROWS = (
    "positions", "rois", "strengths", "yaws", "offsets", "lengths", "strokes", "clipped", "spreads",
)  # fmt: skip
"""Fields of a plan that are arrays with a row for each action."""


@dataclass(frozen=True, eq=False, repr=False)
class Plan:
    """Which actions to apply, where, in which order, and what is predicted to come out.

    A sequence of `PlacedAction`s: `plan[k]` is the k-th action with all that is said of it.
    """

    camera: Camera
    """The camera of the images."""
    actions: tuple[str, ...]
    """K names, in the order to apply them."""
    positions: np.ndarray
    """(K, 2) of (u, v) pixels: ROI centres; the ROI starts at (u - w // 2, v - h // 2)."""
    rois: np.ndarray
    """(K, 2) ROI sizes (w, h), pixels.  A turned hand's are squares."""
    distances: np.ndarray
    """(K+1,) predicted d to the goal before and after each action, recomputed on whole images."""
    status: Status
    """Why the plan ends."""
    evaluations: int = 0
    """Predictions made by the search."""
    seconds: float = 0.0
    """Time of the search; compiling is not counted."""
    strengths: np.ndarray = field(default_factory=lambda: np.zeros(0, np.float32))
    """(K,) how many times as deep as the trained action; 1 for all unless given."""
    yaws: np.ndarray = field(default_factory=lambda: np.zeros(0, np.float32))
    """(K,) turn of the hand from u towards v, radians; 0 for all unless given."""
    lengths: np.ndarray = field(default_factory=lambda: np.zeros(0, np.float32))
    """(K,) how many times as long as the trained action the hand's path is; 1 unless given."""
    strokes: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), np.float32))
    """(K, 2) displacement (u, v), pixels: of an action that moves along a line, from the start of
    its path to its end, the place in the middle; of one that takes material out, to where the next
    action brings it; 0 for all others."""
    offsets: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), np.float32))
    """(K, 2) of (u, v): exact places minus `positions`, pixels; 0 for all unless given."""
    clipped: np.ndarray = field(default_factory=lambda: np.zeros(0, np.float32))
    """(K,) share of each predicted ROI that had to be clipped to [0, 1]."""
    spreads: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), np.float32))
    """(K, 2) of (mm, share): the law of the 80 % interval of each predicted ROI, as
    `Bank.intervals` has it; NaN, as for all unless given: not known."""
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
    seen: np.ndarray | None = None
    """(H, W) pixels that distances count: what was seen of the bed; None: all."""
    notes: tuple[str, ...] = ()
    """What of the two beds the bundled banks were not trained on, in words."""

    def __post_init__(self) -> None:
        count, fill = len(self.actions), object.__setattr__
        for name, shape, value in (
            ("strengths", (count,), 1.0), ("yaws", (count,), 0.0), ("offsets", (count, 2), 0.0),
            ("lengths", (count,), 1.0), ("strokes", (count, 2), 0.0),
            ("spreads", (count, 2), np.nan),
        ):  # fmt: skip
            if len(getattr(self, name)) != count:
                fill(self, name, np.full(shape, value, np.float32))

    def __len__(self) -> int:
        return len(self.actions)

    def __getitem__(self, k: int) -> PlacedAction:
        return self._placed[k]

    def __iter__(self) -> Iterator[PlacedAction]:
        return iter(self._placed)

    @cached_property
    def _placed(self) -> tuple[PlacedAction, ...]:
        how = self.strengths, self.yaws, self.lengths, self.exact_positions, self.strokes
        rows = zip(self.actions, *(of.tolist() for of in (*how, self.rois)), strict=True)
        return linked(
            PlacedAction(action, (u, v), strength, yaw, length, (du, dv), (w, h))
            for action, strength, yaw, length, (u, v), (du, dv), (w, h) in rows
        )

    def columns(self) -> dict[str, list[str]]:
        """A table of the actions, by column; one that would hold zeros or ones only is left out.

        Places are (u, v) pixels of the camera that took the frames; on height maps (x, y) in mm
        too.
        """
        found = {"action": list(self.actions)}
        found |= {"uv"[axis]: [str(x) for x in self.camera_positions[:, axis]] for axis in (0, 1)}
        along, axes = [act.stroke_mm(self.camera) for act in self], "(u, v)"
        if self.view is None and self.camera.orthographic:
            at = 1e3 * places_on(self.camera, self.exact_positions)
            ends = 1e3 * places_on(self.camera, self.exact_positions + self.strokes)
            found |= {f"{'xy'[axis]} (mm)": [f"{x:.1f}" for x in at[:, axis]] for axis in (0, 1)}
            along, axes = list(ends - at), "(x, y)"
        found["strength"] = [f"{act.strength:.2f}" for act in self]
        if self.yaws.any():
            found["yaw (°)"] = [f"{np.degrees(act.yaw):.0f}" for act in self]
        if (self.lengths != 1).any():
            found["length"] = [f"{act.length:.2f}" for act in self]
        if self.strokes.any():
            said = ["({:+.0f}, {:+.0f})".format(*mm) if mm.any() else "" for mm in along]
            found[f"by {axes} (mm)"] = said
        found["to the goal (mm)"] = [f"{mm:.3f}" for mm in self.distances_mm[1:]]
        found["gain (mm)"] = [f"{mm:.3f}" for mm in -np.diff(self.distances_mm)]
        if (halves := self.distance_half_widths_mm) is not None and np.isfinite(halves).any():
            found["80 % (mm)"] = [f"±{mm:.2f}" if mm == mm else "" for mm in halves[1:]]
        return found

    def __repr__(self) -> str:
        actions = "1 action" if len(self) == 1 else f"{len(self)} actions"
        mm = self.distances_mm
        return f"Plan({actions}, {mm[0]:.3f} -> {mm[-1]:.3f} mm, {self.status.name})"

    def _repr_html_(self) -> str | None:
        """What a notebook shows: the summary, the figure and the actions; None: `repr`."""
        try:
            from jshape.viz.display import plan_html
        except JShapeError:  # without matplotlib
            return None
        return plan_html(self)

    def show(self) -> "Figure | None":
        """Show the plan's figure: in the notebook, or in a window.

        Returns:
          None; or the figure, where there is no notebook and no display.

        Raises:
          JShapeError: the plan was stored without its images, or there is no matplotlib.
        """
        from jshape.viz.display import shown
        from jshape.viz.pictures import plan_figure

        return shown(plan_figure(self))

    @property
    def distances_mm(self) -> np.ndarray:
        """`distances` as the mean 3-D distance of matched points, mm."""
        return np.asarray(metric.to_mm(self.distances, self.camera))

    @property
    def exact_positions(self) -> np.ndarray:
        """(K, 2) of (u, v): `positions` with their offsets, whole numbers where there are none."""
        return self.positions + self.offsets if self.offsets.any() else self.positions

    def rest(self, done: int) -> "Plan":
        """What is left of the plan after its first `done` actions."""
        return replace(
            self,
            actions=self.actions[done:],
            distances=self.distances[done:],
            initial=None if self.initial is None else self.images[min(done, len(self))],
            patches=self.patches[done:],
            **{name: getattr(self, name)[done:] for name in ROWS},
        )

    @property
    def camera_positions(self) -> np.ndarray:
        """(K, 2) of (u, v): `positions` in the own pixels of the camera that took the frames."""
        if self.view is None:
            return self.positions
        return self.view.pixels(self.positions, self._surface)

    @property
    def points(self) -> np.ndarray:
        """(K, 3) where the exact places are on the bed now, metres.

        In the frame that the cameras share: of a camera without a pose its own, of a map its own.
        """
        z, (u, v) = self._surface, np.asarray(self.exact_positions, float).T
        x, y = self.camera.at(u, v, z)
        points = np.stack(np.broadcast_arrays(x, y, z, 1.0), -1)
        own = self.camera if self.view is None or self.view.window is None else self.view.source
        return (points @ matrix(own.pose).T)[:, :3]

    @property
    def _surface(self) -> np.ndarray | float:
        """(K,) depth of the bed now at the positions, metres; of the bed's middle if not known."""
        if self.initial is None:
            return (float(self.camera.z_min) + float(self.camera.z_max)) / 2
        depth = np.asarray(self.camera.depth(metric.unweigh(self.initial, self.camera)))
        u, v = self.positions.T
        return depth[v, u]

    @cached_property
    def images(self) -> np.ndarray:
        """(K+1, H, W) predicted I: I0, then the image after each action.  Eq. predStep3."""
        if self.initial is None:
            raise JShapeError("this plan was stored without its images")
        firsts = places.first_pixels(self.positions, self.rois)
        return np.stack([i.copy() for i in successive(self.initial, self.patches, firsts)])

    @cached_property
    def _halves_mm(self) -> list[tuple[np.ndarray, np.ndarray]] | None:
        """First pixel and half widths (h, w) of each action's ROI; None: not known of any."""
        if self.initial is None or not np.isfinite(self.spreads).any():
            return None
        firsts, found = places.first_pixels(self.positions, self.rois), []
        for k, ((left, top), after) in enumerate(zip(firsts, self.patches, strict=True)):
            h, w = after.shape
            before = self.images[k, top : top + h, left : left + w]
            half = intervals.of_action(before, after, self.spreads[k], self.camera)
            found.append((firsts[k], half))
        return found

    def half_widths_after(self, done: int) -> np.ndarray | None:
        """(H, W) half of the 80 % interval of each pixel of `images[done]`, mm.

        0 where no ROI was predicted, NaN where one has no interval; None: none has, or the plan was
        stored without its images.
        """
        halves = self._halves_mm
        return None if halves is None else intervals.added(self.camera.shape, halves[:done])

    @property
    def half_widths_mm(self) -> np.ndarray | None:
        """`half_widths_after` all actions: of the final image."""
        return self.half_widths_after(len(self))

    @cached_property
    def distance_half_widths_mm(self) -> np.ndarray | None:
        """(K+1,) half of the 80 % interval of each of `distances_mm`; NaN, None as for pixels."""
        halves, shape = self._halves_mm, self.camera.shape
        return None if halves is None else intervals.of_distances(shape, halves, self.seen)

    def interval_after(self, done: int) -> str:
        """The interval of d after `done` actions, in words that follow it; "" where not known."""
        halves = self.distance_half_widths_mm
        if halves is None or not halves[done] > 0:
            return ""
        return f", 80 %: ±{halves[done]:.2f}"

    @cached_property
    def volumes_cm3(self) -> np.ndarray:
        """(K,) by how much each action is predicted to change the bed's volume, cm³.

        What is packed counts as lost, what lies loosely as gained.
        """
        depths = [
            np.asarray(self.camera.depth(metric.unweigh(image, self.camera)))
            for image in self.images
        ]
        changes = []
        for before, after in pairwise(depths):
            across, along = self.camera.scale((before + after) / 2)
            changes.append(1e6 * float(((before - after) / (across * along)).sum()))
        return np.array(changes, np.float32)

    @cached_property
    def height_maps(self) -> tuple[HeightMap, ...]:
        """K+1 predicted maps of the bed: the first, then the map after each action.

        Raises:
          JShapeError: the plan was not made on height maps, or stored without its images.
        """
        if not self.camera.orthographic:
            raise JShapeError("this plan was made on depth images: it has images, no height maps")
        depths = (self.camera.depth(metric.unweigh(image, self.camera)) for image in self.images)
        seen = True if self.seen is None else self.seen
        return tuple(map_of(np.where(seen, np.asarray(z), np.nan), self.camera) for z in depths)

    def to_json(self, path: str | Path, *, images: bool = True) -> None:
        """Write the plan to a file, with I0 and the predicted ROIs unless `images` is False.

        Raises:
          BadFile: the file cannot be written.
        """
        plan_file.write_plan(path, self, images=images)

    @staticmethod
    def from_json(path: str | Path) -> "Plan":
        """Read a plan that `to_json` wrote.

        Raises:
          BadFile: the file is not a plan.
        """
        return Plan(**plan_file.read_plan(path))


def successive(
    initial: np.ndarray, patches: tuple[np.ndarray, ...], firsts: np.ndarray
) -> Iterator[np.ndarray]:
    """I0 and the image after each patch; one buffer, so copy what you keep."""
    image = np.array(initial)
    yield image
    for (left, top), patch in zip(firsts, patches, strict=True):
        h, w = patch.shape
        image[top : top + h, left : left + w] = patch
        yield image
