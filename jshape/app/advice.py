"""What a newcomer is told: what to do next, how large a stroke may be, why a plan is empty."""

import cv2
import numpy as np

from jshape import metric
from jshape.app.editor_state import EditorState
from jshape.models.bank import Bank
from jshape.planning.api import rollout
from jshape.planning.limit import Limit
from jshape.planning.options import YAWS, SearchSpace
from jshape.planning.plan import Plan

STROKE_MM = 15.0
"""Depth of the first stroke: a poke of the bundled banks digs 10 to 20 mm."""


def next_step(editor: EditorState) -> str:
    """What to do now, in one sentence or two."""
    if editor.locked:
        return "A run goes on: answer its questions under Carry out. STOP and Escape stop the arm."
    if editor.bed is None:
        return "1. Load a depth image of your bed, or look with the camera (Bed and goal)."
    if not editor.changed:
        return "2. Draw a trench: drag over the image. Or write a text, or load a goal. Then plan."
    if editor.plan is None:
        return "3. Press plan: it searches for actions that lead from the bed to this goal."
    if not len(editor.plan):
        return "The plan is empty: read why below it, change the drawing, and press plan again."
    return (
        "4. Step through the predicted images (left and right, or press a line of the plan); then "
        "start it under Carry out."
    )


def first_stroke(bank: Bank, pixels_per_mm: float) -> tuple[float, float]:
    """Width and depth, mm, of a stroke that some action of the bank can make.

    As wide as the smallest ROI, as deep as `STROKE_MM`, or a third of the camera's range.
    """
    narrow = min(min(roi) for roi in bank.rois.values()) / pixels_per_mm
    deepest = 1e3 * float(bank.camera.z_max - bank.camera.z_min) / 3
    return max(round(narrow / 5) * 5.0, 5.0), max(min(STROKE_MM, round(deepest)), 1.0)


def how_near(found: Limit | str) -> str:
    """How near any plan can come, of an answer of `GoalLimit.ask`; "": not known."""
    if isinstance(found, str):
        return f"How near a plan can come is not known: {found}" if found else ""
    said = f"{found.words}; even fractions of actions leave {found.fractions:.0%}"
    return said[0].upper() + said[1:]


def how_good(plan: Plan, found: Limit | str) -> str:
    """What a plan leaves, beside what any plan must leave."""
    left = float(plan.distances[-1] / plan.distances[0])
    if isinstance(found, str) or len(plan) > found.max_steps or not found.left <= left < 1:
        return f"{left:.0%} left"
    return f"{left:.0%} left, at least {found.efficiency(left):.0%} of what any plan can cover"


def why_empty(editor: EditorState) -> str:
    """Why no action helps, with what the smallest one would do where the goal asks for the most.

    "" where the plan has actions.
    """
    if editor.plan is None or len(editor.plan) or not editor.changed:
        return ""
    bed, goal = editor.both()
    bank, before = editor.bank, editor.depth_of(bed)
    asked = 1e3 * np.abs(editor.depth_of(goal) - before)
    name = min(bank.actions, key=lambda action: int(np.prod(bank.roi(action))))
    w, h = bank.roi(name)
    v, u = np.unravel_index(np.argmax(cv2.blur(asked, (w, h))), asked.shape)
    gentle = min(SearchSpace().strengths)
    one = rollout(bed, goal, [name], [(u, v)], strengths=[gentle], bank=bank)
    moved = 1e3 * np.abs(editor.depth_of(one.images[1]) - before)
    own = float(metric.to_mm(metric.distance(one.images[0], one.images[1]), bank.camera))
    left = float(one.distances_mm[1] - one.distances_mm[0])
    width, deep = first_stroke(bank, editor.pixels_per_mm)
    helps = f"{left:.3f} mm farther" if left > 0 else f"only {-left:.3f} mm nearer"
    out, into = editor.to_move_cm3
    ways = [f"draw wider or deeper (the bank can make {width:.0f} mm wide, {deep:.0f} mm deep)"]
    if into > out:
        ways.append("ask for less to be raised: actions push material down and aside")
    if bank.turns and editor.yaws < YAWS:
        ways.append(f"try {YAWS} yaw angles instead of {editor.yaws}")
    ways.append("choose another bank")
    return (
        "No action brings the bed nearer by more than noise and its own error may feign. "
        f"The goal differs from it by {editor.distance_mm:.3f} mm on average, {asked.max():.1f} mm "
        f"at most. The smallest "
        f"action, {name} x{gentle:g}, moves {own:.3f} mm on average, {moved.max():.1f} mm at most: "
        f"at ({u}, {v}) it would end {helps}. What helps: {'; '.join(ways)}."
    )
