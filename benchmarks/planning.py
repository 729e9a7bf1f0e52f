"""Steps and whole plans of f_D and f_P, at the sizes of the paper's experiments."""

import jax
import jax.numpy as jnp
import numpy as np

import jshape
from benchmarks.timing import Report, seconds
from jshape.actions import PAPER_ROIS
from jshape.data.simulate import ROIS
from jshape.planners import PLANNERS
from jshape.planners.base import Limits
from jshape.planning import DEFAULT_BANK
from jshape.predict.bank import Bank
from jshape.predict.difference import Difference
from jshape.predict.sweep import candidates_at, sweep


def smooth_bank(rois: dict[str, tuple[int, int]]) -> Bank:
    """A bank of smooth craters with these ROI sizes (w, h)."""

    def crater(w: int, h: int) -> Difference:
        x, y = np.linspace(-2.5, 2.5, w), np.linspace(-2.5, 2.5, h)
        return Difference(jnp.asarray(-0.2 * np.exp(-(x**2) - y[:, None] ** 2), jnp.float32))

    return Bank(jshape.PAPER_BOX, tuple(crater(*r) for r in rois.values()), tuple(rois))


def problem(bank: Bank, grid: tuple[int, int], applied: list[tuple[str, int]]):
    """A flat image, the image after the applied actions, and the positions."""
    positions = jshape.grid(bank.camera, *grid)
    now = np.full(bank.camera.shape, 0.6, np.float32)
    goal = now.copy()
    for name, place in applied:
        (u, v), (w, h) = positions[place], bank.roi(name)
        window = np.s_[v - h // 2 : v - h // 2 + h, u - w // 2 : u - w // 2 + w]
        goal[window] = bank.predict(name, goal[window])
    return now, goal, positions


def run(report: Report) -> None:
    bank = smooth_bank(ROIS)
    now, goal, positions = problem(bank, (7, 3), [("grasp", 4), ("knock", 0), ("press", 20)])
    candidates = candidates_at(bank, dict.fromkeys(bank.actions, positions))
    i, g = jnp.asarray(now), jnp.asarray(goal)
    count = len(candidates)
    time = seconds(lambda: sweep(bank, i, g, candidates))
    report.add(f"predict {count} candidates on 395x480 (one sweep)", 1e3 * time, "ms", goal=3)
    # Each ROI pixel of each candidate is read twice (image, goal), each effect stays in cache.
    pixels = sum(len(f) * np.prod(bank.roi(n)) for n, f in zip(ROIS, candidates.first, strict=True))
    copied = np.empty(int(pixels), np.float32)
    source = np.ones(int(pixels), np.float32)
    copy = seconds(lambda: np.copyto(copied, source))
    report.add("the same against copying as many floats", time / copy, "times")

    search = PLANNERS["greedy"]
    for steps in (1, 3):
        time = seconds(lambda s=steps: search(bank, i, g, candidates, Limits(), max_steps=s).status)
        report.add(f"greedy, {count} candidates, {steps} steps: per step", 1e3 * time / steps, "ms",
                   goal=3)  # fmt: skip

    pressed = jshape.load_bank(DEFAULT_BANK)
    places = candidates_at(pressed, dict.fromkeys(pressed.actions, positions))
    time = seconds(lambda: sweep(pressed, i, g, places))
    report.add(f"f_P, {count} candidates, first step", 1e3 * time, "ms", goal=500)
    steps = [
        seconds(lambda s=s: search(pressed, i, g, places, Limits(), max_steps=s).status, repeats=3)
        for s in (1, 3)
    ]
    report.add("f_P, a later step", 1e3 * (steps[1] - steps[0]) / 2, "ms", goal=150)

    three = smooth_bank(PAPER_ROIS)
    applied = [("grasp", 0), ("knock", 4), ("poke", 10), ("knock", 12)]
    now, goal, positions = problem(three, (5, 3), applied)
    found = jshape.plan(now, goal, bank=three, positions=positions, max_steps=4)
    assert len(found) == 4, found.actions
    time = seconds(
        lambda: jshape.plan(now, goal, bank=three, positions=positions, max_steps=4).status
    )
    report.add("jshape.plan, 45 candidates, 4 steps", 1e3 * time, "ms", goal=5)

    dense = smooth_bank(ROIS)
    time = seconds(
        lambda: jshape.plan(now, goal, bank=dense, positions="21x15", max_steps=4).status
    )
    report.add("jshape.plan, 5 actions at 21x15 places, at most 4 steps", 1e3 * time, "ms")

    goals = jnp.stack([jnp.roll(jnp.asarray(goal), k, 0) for k in range(16)])
    where = candidates_at(three, dict.fromkeys(three.actions, positions))

    @jax.jit
    def many(goals):
        def one(goal):
            return search(three, jnp.asarray(now), goal, where, Limits(), max_steps=4).chosen

        return jax.vmap(one)(goals)

    time = seconds(lambda: many(goals), repeats=3)
    report.add("16 goals in one vmapped search: per goal", 1e3 * time / 16, "ms")
