"""Simulated recordings: a camera looks at a bed while a hand comes in, acts, and goes out again.

What a person who records pairs has on disk: frames at a steady rate, most of them with an arm in
them.  Frames are `[v, u]`, uint16 counts of `DEPTH_UNIT` metres, 0 = no reading; boxes are
`(left, top, width, height)` in pixels; frame ranges are `[start, stop)`.
"""

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jshape import sim
from jshape._typing import Array, Key
from jshape.camera import PAPER_BOX, Camera
from jshape.data.annotate import Box, box_of
from jshape.data.simulate import ALL_ROIS, DEPTH_UNIT, random_bed, random_place
from jshape.errors import UnknownName

EFFECT_MM = 0.5
"""What counts as changed in a true box: without noise, the depth differs by more than this."""
LEVELLED_STD = 0.0015
"""Unevenness of a bed that somebody has just levelled by hand, metres."""

_HOVER = 0.06
"""Height of the fingertips above the bed while the hand comes and rests, metres."""
_NEAREST = 0.05
"""Depth up to which a forearm is drawn, metres."""
_BASELINE = 0.05
"""Distance of the D435's two infrared cameras, metres: the hand hides a strip from one of them."""


@dataclass
class Truth:
    """What really happened in a simulated recording.  Filled while its frames are made."""

    frames: int = 0
    """How many frames there will be."""
    still: list[tuple[int, int]] = field(default_factory=list)
    """Frame ranges in which the bed lies open and still."""
    beds: list[sim.Bed] = field(default_factory=list)
    """The bed in each of them."""
    changes: list[dict[str, Any]] = field(default_factory=list)
    """What the hand did between two of them: kind ("action", "idle", "level"), action, position,
    box, and the frame at which the bed changed."""


def simulate_recording(
    key: Key[Array, ""],
    actions: Sequence[str],
    *,
    agent: str = "human",
    material: str | sim.Material = "flour",
    bed: str = "flat",
    camera: Camera = PAPER_BOX,
    still: int = 10,
    move: int = 4,
    rest: int = 6,
    idle: int = 0,
    level_every: int = 0,
    noise: float = 0.00045,
    holes: float = 0.002,
) -> tuple[Truth, Iterator[np.ndarray]]:
    """Frames of a bed on which actions are applied one after another, each at a random place.

    Args:
      key: consumed; cameras of one key, each with a pose, record one bed at once.
      actions: names of simulated actions, in order.
      agent: whose hand.
      material: a simulated material, or its name.
      bed: kind of bed at the start.
      camera: looks straight down, or from its `pose` in the frame of `sim.render`; one with a
        pose sees what happens at the places that `PAPER_BOX` would see.
      still: frames of the open bed between two visits of the hand.
      move: frames in which the hand comes in, and again in which it leaves.
      rest: frames in which it rests motionless above the bed, before and after it acts.
      idle: visits without a touch, before the first action and then after every one until they
        are used up.
      level_every: the bed is levelled after every this many actions (not after the last); 0 never.
      noise: standard deviation of one frame at 0.45 m, metres.
      holes: share of pixels without a reading.

    Returns:
      The truth, which is complete when the last frame has been taken; and the frames, (H, W)
      uint16, made one at a time.

    Raises:
      UnknownName: no such action, agent, material or kind of bed.
    """
    known = [("action", name, tuple(ALL_ROIS)) for name in actions] + [("agent", agent, sim.AGENTS)]
    for what, name, allowed in known:
        if name not in allowed:
            raise UnknownName(what, name, allowed)
    material = sim.read_material(material)
    straight = camera if camera.pose is None else PAPER_BOX
    own = zlib.crc32(np.array(camera.pose or (), np.float64).tobytes())
    for_bed, key = jax.random.split(key)
    start = random_bed(for_bed, bed)
    untouched = ("idle", "")
    visits = [untouched] * bool(idle)
    for number, action in enumerate(actions, 1):
        visits += [("action", action)] + [untouched] * (visits.count(untouched) < idle)
        if level_every and number % level_every == 0 and number < len(actions):
            visits += [("level", "")]
    hidden = [len(_path(move, rest, touches=visit != untouched)) for visit in visits]
    truth = Truth(frames=still * (len(visits) + 1) + sum(hidden))

    def frames() -> Iterator[np.ndarray]:
        nonlocal key
        now = start
        depth = np.asarray(sim.render(now, camera))
        count = 0

        def shot(hand: np.ndarray | None) -> np.ndarray:
            nonlocal key, count
            key, for_rim, for_sensor = jax.random.split(key, 3)
            if camera.pose is not None:  # cameras of one key see one bed, each with its own noise
                for_sensor = jax.random.fold_in(for_sensor, own)
            count += 1
            seen = depth if hand is None else _with_hand(for_rim, depth, hand, camera)
            return np.asarray(sim.to_uint16(sim.sensor(for_sensor, seen, noise, holes), DEPTH_UNIT))

        def open_bed() -> Iterator[np.ndarray]:
            truth.still.append((count, count + still))
            truth.beds.append(now)
            for _ in range(still):
                yield shot(None)

        yield from open_bed()
        for kind, action in visits:
            key, for_place, for_arm, for_act = jax.random.split(key, 4)
            place = random_place(for_place, ALL_ROIS[action or "grasp"], straight)
            xy = np.asarray(sim.position_to_xy(straight, place))
            angle = np.pi / 2 + float(jax.random.uniform(for_arm, (), jnp.float32, -0.9, 0.9))
            path = _path(move, rest, touches=kind != "idle")
            contact = next((k for k, p in enumerate(path) if p == (0.0, 0.0)), -1)
            changed_at = count + contact
            if camera.pose is not None:
                back = np.linalg.inv(np.array(camera.pose))
                at = camera.pixel(*(back @ [*xy, sim.SURFACE, 1.0])[:3])
                place = int(np.rint(at[0])), int(np.rint(at[1]))
            pose, before = None, depth
            for step, (away, lift) in enumerate(path):
                if step == contact:
                    now = _change(for_act, now, kind, action, agent, material, xy, bed)
                    depth = np.asarray(sim.render(now, camera))
                if pose is None or path[step - 1] != (away, lift):
                    pose = _hand(camera, xy, angle, away, lift)
                yield shot(pose)
            if kind != "idle":
                truth.changes.append({
                    "kind": kind, "action": action, "frame": changed_at,
                    "position": place if action else None, "box": changed_box(before, depth),
                })  # fmt: skip
            else:
                truth.changes.append({"kind": kind, "action": "", "frame": None})
            yield from open_bed()

    return truth, frames()


def changed_box(before: np.ndarray, after: np.ndarray, least_mm: float = EFFECT_MM) -> Box | None:
    """The true box of a change: all pixels of two noise-free frames that differ by `least_mm`.

    Frames are (H, W) metres; 0 and NaN are no reading and have not changed.
    """
    with np.errstate(invalid="ignore"):
        changed = (np.abs(after - before) > 1e-3 * least_mm) & (before > 0) & (after > 0)
    return box_of(changed)


def _change(key, bed: sim.Bed, kind, action, agent, material, xy, bed_kind) -> sim.Bed:
    if kind == "action":
        return sim.apply_action(key, bed, material, (action, agent), xy)
    if kind == "level":
        if bed_kind == "flat":
            return sim.irregular_bed(key, LEVELLED_STD)
        return random_bed(key, bed_kind)
    return bed


def _path(move: int, rest: int, *, touches: bool) -> list[tuple[float, float]]:
    """(metres away along the arm, metres of the fingertips above the bed), frame by frame."""
    hover = (0.0, _HOVER)
    far = 0.40
    coming = [(far * (1 - (k + 1) / (move + 1)), _HOVER) for k in range(move)]
    acting = [(0.0, _HOVER / 2), (0.0, 0.0), (0.0, 0.0), (0.0, _HOVER / 2)] if touches else []
    return [*coming, *[hover] * rest, *acting, *[hover] * rest, *reversed(coming)]


def _hand(camera: Camera, xy, angle: float, away: float, lift: float) -> np.ndarray:
    """Depth image of a hand and forearm alone, metres; infinite beside them."""
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-along[1], along[0]])
    tip = np.asarray(xy) + away * along
    surface = sim.SURFACE - lift

    def point(out, side, up):
        return [*(tip + out * along + side * across), surface - up]

    parts = [
        (point(0.02, 0.0, 0.055), point(0.10, 0.0, 0.075), 0.035),  # palm
        (point(0.10, 0.0, 0.080), point(0.60, 0.0, 0.160), 0.042),  # forearm
    ]
    for side in (-0.030, -0.010, 0.010, 0.030):
        parts.append((point(0.02, side, 0.055), point(-0.03, 1.2 * side, 0.010), 0.010))
    parts.append((point(0.03, 0.035, 0.05), point(-0.01, 0.06, 0.012), 0.011))  # thumb
    start, stop, radius = (np.array(x, np.float32) for x in zip(*parts, strict=True))
    if camera.pose is not None:
        pose = np.array(camera.pose, np.float32)
        start, stop = ((at - pose[:3, 3]) @ pose[:3, :3] for at in (start, stop))
        # Up to the image plane: a forearm may reach past the camera.
        inside = (start[:, 2] - _NEAREST) / np.maximum(start[:, 2] - stop[:, 2], 1e-6)
        stop = np.where(stop[:, 2:] < _NEAREST, start + inside[:, None] * (stop - start), stop)
    return np.asarray(_capsules(camera, start, stop, radius))


@jax.jit
def _capsules(camera: Camera, start, stop, radius):
    """Nearest depth (H, W) of rounded rods, metres, infinite where there is none.

    Each rod is drawn where its axis is, at its axis' depth: a rod at a slant is off by less than
    its radius, which does not matter to a hand that only has to be in the way.
    """
    x, y = camera.rays()

    def one(start, stop, radius):
        first, last = start[:2] / start[2], stop[:2] / stop[2]
        line = last - first
        share = ((x - first[0]) * line[0] + (y - first[1]) * line[1]) / (line @ line + 1e-12)
        share = jnp.clip(share, 0.0, 1.0)
        z = 1.0 / ((1.0 - share) / start[2] + share / stop[2])
        off = z * jnp.hypot(x - first[0] - share * line[0], y - first[1] - share * line[1])
        return jnp.where(off < radius, z - jnp.sqrt(jnp.maximum(radius**2 - off**2, 0.0)), jnp.inf)

    return jax.vmap(one)(start, stop, radius).min(0)


def _with_hand(key, bed: np.ndarray, hand: np.ndarray, camera: Camera) -> np.ndarray:
    """The bed with a hand before it: flying pixels at its rim, a strip without depth beside it."""
    covered = hand < np.where(bed > 0, bed, np.inf)  # beyond the box's walls it has no depth
    if not covered.any():
        return bed
    seen = np.where(covered, hand, bed)
    gap = 1.0 / float(np.median(hand[covered])) - 1.0 / float(np.median(bed[bed > 0]))
    hidden = covered.copy()
    for shift in range(1, max(1, round(_BASELINE * float(camera.fx) * gap)) + 1):
        hidden[:, :-shift] |= covered[:, shift:]
    rng = np.random.default_rng(np.asarray(jax.random.key_data(key)))
    rim = np.zeros_like(covered)
    for axis in (0, 1):
        edge = np.diff(covered, axis=axis, append=covered.take([-1], axis)).astype(bool)
        rim |= edge | np.roll(edge, 1, axis) | np.roll(edge, -1, axis)
    flies = rim & (bed > 0) & (rng.random(bed.shape) < 0.3)
    nearest = np.where(covered, hand, np.median(hand[covered]))
    share = rng.random(bed.shape).astype(np.float32)
    seen = np.where(flies, share * nearest + (1 - share) * bed, seen)
    return np.where(hidden & ~covered & ~flies, 0.0, seen).astype(np.float32)
