"""What a plan or a run tells, step by step, whatever it was read from."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from jshape._typing import Float
from jshape.camera import Camera
from jshape.data.missing import missing

MARGIN_MM = 1.0
"""A box reaches so far above and below the surface that it holds."""
LEAST_REACH_MM = 1.0
"""Least difference to the goal that is drawn in full colour: noise is no relief."""


class Act(NamedTuple):
    """One action."""

    name: str
    position: tuple[float, float]
    """(u, v) pixels."""
    strength: float
    """How many times as deep as the trained action."""
    yaw: float
    """Turn of the hand from u towards v, radians."""
    roi: tuple[int, int] | None
    """(w, h) pixels of what it changes, before the turn; None: not known."""

    def __str__(self) -> str:
        u, v = self.position
        turned = f", turned {np.degrees(self.yaw):.0f}°" if self.yaw else ""
        return f"{self.name} x{self.strength:.2f} at ({u:.0f}, {v:.0f}){turned}"


class Box(NamedTuple):
    """A box around the material that an action meets, turned about the optical axis."""

    centre: np.ndarray
    """(3,) camera frame, metres."""
    half: np.ndarray
    """(3,) half of its size, metres."""
    yaw: float
    """Turn from X towards Y, radians."""

    @property
    def corners(self) -> Float[np.ndarray, "8 3"]:
        """Camera frame, metres."""
        signs = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)])
        cos, sin = np.cos(self.yaw), np.sin(self.yaw)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        return self.centre + (signs * self.half) @ turn.T


@dataclass(frozen=True, eq=False)
class Moment:
    """The bed at the start, or after an action."""

    seen: np.ndarray | None = None
    """(H, W) depth that the camera saw, metres, NaN = no reading; None: it did not look."""
    predicted: np.ndarray | None = None
    """(H, W) depth predicted, metres; None: not known."""
    act: Act | None = None
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

    @property
    def words(self) -> str:
        """What happened and what came of it."""
        told = ["the start" if self.act is None else str(self.act)]
        if self.act is not None and self.before_mm is not None:
            told.append(f"{self.before_mm:.3f} mm before")
        if self.predicted_mm is not None:
            told.append(f"{self.predicted_mm:.3f} mm predicted")
        if self.seen_mm is not None:
            told.append(f"{self.seen_mm:.3f} mm {'obtained' if self.act else 'to the goal'}")
        elif self.act is not None and self.predicted_mm is None:
            told.append("not looked at")
        if self.effort_nm is not None:
            told.append(f"at most {self.effort_nm:.1f} Nm")
        if self.seconds is not None:
            told.append(f"after {self.seconds:.1f} s")
        return f"{told[0]}: {', '.join(told[1:])}" if told[1:] else told[0]


@dataclass(frozen=True, eq=False)
class Story:
    """A plan or a run: where it was seen from, what was wanted, and what happened."""

    title: str
    camera: Camera
    goal: np.ndarray | None
    """(H, W) depth wanted, metres; None: not known."""
    moments: tuple[Moment, ...]
    """The start, and one after each action."""
    notes: tuple[str, ...] = ()
    """Why it ended, and what could not be shown."""

    def __len__(self) -> int:
        """How many actions there are."""
        return len(self.moments) - 1

    @property
    def acts(self) -> tuple[Act, ...]:
        """All actions, in their order."""
        return tuple(moment.act for moment in self.moments if moment.act is not None)

    @property
    def is_run(self) -> bool:
        """Something was seen after an action: predicted and obtained can be compared."""
        return any(moment.seen is not None for moment in self.moments[1:])

    def last(self, step: int) -> np.ndarray | None:
        """(H, W) depth of the bed at a step, or the latest before it that is known."""
        known = (moment.bed for moment in reversed(self.moments[: step + 1]))
        return next((depth for depth in known if depth is not None), None)

    @cached_property
    def level(self) -> float:
        """Depth of the bed, metres: the median of the first look."""
        depths = [d for d in (*(m.bed for m in self.moments), self.goal) if d is not None]
        seen = [d[~missing(d)] for d in depths]
        return float(np.median(next(d for d in seen if d.size)))

    @cached_property
    def range_m(self) -> tuple[float, float]:
        """Nearest and farthest depth to colour, metres: all but outliers."""
        depths = [m.bed for m in (self.moments[0], self.moments[-1])] + [self.goal]
        known = np.concatenate([d[~missing(d)] for d in depths if d is not None] or [np.zeros(0)])
        near, far = np.percentile(known, (0.5, 99.5)) if known.size else (self.level, self.level)
        more = max(LEAST_REACH_MM / 1000 - (far - near), 0.0) / 2
        return float(near - more), float(far + more)

    @cached_property
    def reach_mm(self) -> float:
        """Difference to the goal that is drawn in full colour."""
        gap = self.too_high_mm(self.last(0), self.goal)
        known = np.zeros(0) if gap is None else np.abs(gap[np.isfinite(gap)])
        most = float(np.percentile(known, 99.5)) if known.size else 0.0
        return max(most, LEAST_REACH_MM)

    @staticmethod
    def too_high_mm(depth: np.ndarray | None, wanted: np.ndarray | None) -> np.ndarray | None:
        """(H, W) how much higher than wanted a bed is, mm; NaN where either has no reading."""
        if depth is None or wanted is None:
            return None
        gap = 1000.0 * (wanted - depth)
        return np.where(missing(depth) | missing(wanted), np.nan, gap).astype(np.float32)

    def outline(self, act: Act) -> Float[np.ndarray, "4 2"] | None:
        """Corners (u, v) of what an action changes on the image; None if its ROI is not known."""
        if act.roi is None:
            return None
        w, h = act.roi
        corners = np.array([[-w, -h], [w, -h], [w, h], [-w, h]]) / 2
        cos, sin = np.cos(act.yaw), np.sin(act.yaw)
        return corners @ np.array([[cos, sin], [-sin, cos]]) + act.position

    def box(self, step: int) -> Box | None:
        """The box around what the action of a step met and left; None if its ROI is not known."""
        act = self.moments[step].act
        corners = None if act is None else self.outline(act)
        if act is None or act.roi is None or corners is None:
            return None
        camera = self.camera
        left, top = np.clip(np.floor(corners.min(0)), 0, [camera.width - 1, camera.height - 1])
        right, bottom = np.clip(np.ceil(corners.max(0)), [left + 1, top + 1], camera.shape[::-1])
        window = np.s_[int(top) : int(bottom), int(left) : int(right)]
        depths = [self.last(step - 1), self.moments[step].bed]
        inside = [d[window][~missing(d[window])] for d in depths if d is not None]
        known = np.concatenate([*inside, np.zeros(0)])
        near, far = (known.min(), known.max()) if known.size else (self.level, self.level)
        near, far = near - MARGIN_MM / 1000, far + MARGIN_MM / 1000
        middle = (near + far) / 2
        focal = np.array([float(camera.fx), float(camera.fy)])
        at = (np.array(act.position) - [float(camera.u0), float(camera.v0)]) / focal * middle
        size = np.array(act.roi) / focal * middle
        half = np.array([*size / 2, (far - near) / 2])
        return Box(np.array([*at, middle]), half, act.yaw)
