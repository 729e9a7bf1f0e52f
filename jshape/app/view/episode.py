"""A plan or a run as an episode: what was seen and predicted, step by step."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from jshape._typing import Float
from jshape.actions import PlacedAction, linked
from jshape.app import pictures
from jshape.app.pictures import Scale
from jshape.camera import Camera
from jshape.data.missing import missing

MARGIN_MM = 1.0
"""A box reaches so far above and below the surface that it holds."""


@dataclass(frozen=True, eq=False)
class EpisodeStep:
    """The bed at the start, or after an action."""

    seen: np.ndarray | None = None
    """(H, W) depth that the camera saw, metres, NaN = no reading; None: it did not look."""
    predicted: np.ndarray | None = None
    """(H, W) depth predicted, metres; None: not known."""
    action: PlacedAction | None = None
    """The action before it; None at the start."""
    before_mm: float | None = None
    """Distance to the goal before the action."""
    predicted_mm: float | None = None
    """Distance to the goal that was predicted after it."""
    seen_mm: float | None = None
    """Distance to the goal that was seen."""
    effort_nm: float | None = None
    """The arm's greatest effort during the action."""
    seconds: float | None = None
    """Since the run began."""

    @property
    def bed(self) -> np.ndarray | None:
        """(H, W) depth that was seen, or else predicted."""
        return self.predicted if self.seen is None else self.seen


@dataclass(frozen=True, eq=False)
class Episode:
    """A plan or a run: where it was seen from, what was wanted, and what happened."""

    title: str
    camera: Camera
    goal: np.ndarray | None
    """(H, W) depth wanted, metres; None: not known."""
    steps: tuple[EpisodeStep, ...]
    """The start, and one after each action."""
    notes: tuple[str, ...] = ()
    """Why it ended, and what could not be shown."""

    def __len__(self) -> int:
        return len(self.steps) - 1

    @cached_property
    def _placed(self) -> tuple[PlacedAction, ...]:
        """All actions; runs round places to a pixel."""
        return linked((one.action for one in self.steps if one.action is not None), within=1.01)

    def actions(self, step: int = 0) -> tuple[PlacedAction, ...]:
        """The actions up to a step; at the start, all of them."""
        return self._placed[: step or len(self)]

    def words(self, step: int) -> str:
        """What happened at a step and what came of it."""
        one, acted = self.steps[step], step > 0
        numbers = (
            (one.before_mm if acted else None, "{:.3f} mm before"),
            (one.predicted_mm, "{:.3f} mm predicted"),
            (one.seen_mm, "{:.3f} mm obtained" if acted else "{:.3f} mm to the goal"),
            (one.effort_nm, "at most {:.1f} Nm"),
            (one.seconds, "after {:.1f} s"),
        )
        told = [words.format(number) for number, words in numbers if number is not None]
        if acted and one.predicted_mm is None and one.seen_mm is None:
            told.append("not looked at")
        name = self._placed[step - 1].words(self.camera) if acted else "the start"
        return f"{name}: {', '.join(told)}" if told else name

    @property
    def is_run(self) -> bool:
        """Something was seen after an action: predicted and obtained can be compared."""
        return any(step.seen is not None for step in self.steps[1:])

    def last(self, step: int) -> np.ndarray | None:
        """(H, W) depth of the bed at a step, or the latest before it that is known."""
        known = (one.bed for one in reversed(self.steps[: step + 1]))
        return next((depth for depth in known if depth is not None), None)

    @cached_property
    def level(self) -> float:
        """Depth of the bed, metres: the median of the first look."""
        depths = [d for d in (*(step.bed for step in self.steps), self.goal) if d is not None]
        seen = [d[~missing(d)] for d in depths]
        return float(np.median(next(d for d in seen if d.size)))

    def heights_mm(self, depth: np.ndarray) -> Float[np.ndarray, "H W"]:
        """Above the bed's level; NaN where there is no reading."""
        return 1e3 * (self.level - np.where(missing(depth), np.nan, depth))

    @cached_property
    def heights(self) -> Scale:
        """Colours of heights: of the start, the end and the goal."""
        depths = [self.steps[0].bed, self.steps[-1].bed, self.goal]
        return pictures.height_scale(*(self.heights_mm(d) for d in depths if d is not None))

    @cached_property
    def differences(self) -> Scale:
        """Colours of differences to the goal: those of the start."""
        gap = self.too_high_mm(self.last(0), self.goal)
        return pictures.difference_scale(np.zeros((1, 1)) if gap is None else gap)

    @staticmethod
    def too_high_mm(depth: np.ndarray | None, wanted: np.ndarray | None) -> np.ndarray | None:
        """(H, W) how much higher than wanted a bed is, mm; NaN where either has no reading."""
        if depth is None or wanted is None:
            return None
        gap = 1000.0 * (wanted - depth)
        return np.where(missing(depth) | missing(wanted), np.nan, gap).astype(np.float32)

    def box(self, step: int) -> Float[np.ndarray, "8 3"] | None:
        """Corners of the box around what the action of a step met and left, turned as the hand is.

        They are in the camera's frame, metres; None if the action's ROI is not known.
        """
        action = self.steps[step].action
        if action is None or action.roi is None:
            return None
        camera, corners = self.camera, action.outline
        left, top = np.clip(np.floor(corners.min(0)), 0, [camera.width - 1, camera.height - 1])
        right, bottom = np.clip(np.ceil(corners.max(0)), [left + 1, top + 1], camera.shape[::-1])
        window = np.s_[int(top) : int(bottom), int(left) : int(right)]
        depths = [self.last(step - 1), self.steps[step].bed]
        inside = [d[window][~missing(d[window])] for d in depths if d is not None]
        known = np.concatenate([*inside, np.zeros(0)])
        near, far = (known.min(), known.max()) if known.size else (self.level, self.level)
        near, far = near - MARGIN_MM / 1000, far + MARGIN_MM / 1000
        middle = (near + far) / 2
        at = [float(x) for x in camera.at(*action.position, middle)]
        size = np.array(action.roi) / [float(per_metre) for per_metre in camera.scale(middle)]
        half = np.array([*size / 2, (far - near) / 2])
        signs = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)])
        cos, sin = np.cos(action.yaw), np.sin(action.yaw)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        return np.array([*at, middle]) + (signs * half) @ turn.T
