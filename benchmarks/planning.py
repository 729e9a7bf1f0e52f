"""Steps and whole plans of f_D and f_P, at the sizes of the paper's experiments."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jshape
from benchmarks.report import Report
from benchmarks.timing import seconds
from jshape.actions import PAPER_ROIS
from jshape.data.simulate import ROIS
from jshape.places import dense_positions
from jshape.planners import greedy
from jshape.planners.base import Limits
from jshape.planning import DEFAULT_BANK
from jshape.predict.bank import Bank
from jshape.predict.difference import Difference
from jshape.predict.sweep import Candidates, candidates_at, sweep
from jshape.predict.terrain import terrain_of


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


def run(report: Report, out: Path) -> None:
    bank = smooth_bank(ROIS)
    now, goal, positions = problem(bank, (7, 3), [("grasp", 4), ("knock", 0), ("press", 20)])
    at = dict.fromkeys(bank.actions, positions)
    image = terrain_of(bank, now, goal)
    candidates = candidates_at(image, bank, at)
    count = len(candidates)
    time = seconds(lambda: sweep(image, candidates))
    report.add(f"predict {count} candidates on 395x480 (one sweep)", 1e3 * time, "ms", goal=3)
    report.add("the same against copying as many floats", time / _copying(candidates), "times")
    for steps in (1, 3):
        time = seconds(lambda s=steps: greedy.run(image, candidates, Limits(), max_steps=s).status)
        report.add(f"greedy, {count} candidates, {steps} steps: per step", 1e3 * time / steps, "ms",
                   goal=3)  # fmt: skip

    every = candidates_at(image, bank, dense_positions(bank, 4))
    time = seconds(lambda: sweep(image, every), repeats=5)
    report.add(f"f_D, every 4th pixel: {len(every)} candidates, one sweep", 1e3 * time, "ms",
               goal=500)  # fmt: skip
    report.add("the same against copying as many floats", time / _copying(every), "times")

    pressed = jshape.load_bank(DEFAULT_BANK)
    ground = jax.jit(terrain_of)(pressed, now, goal)
    time = seconds(lambda: jax.jit(terrain_of)(pressed, now, goal), repeats=5)
    report.add("f_P, the ground of image and goal seen from above", 1e3 * time, "ms")
    places = candidates_at(ground, pressed, at)
    time = seconds(lambda: sweep(ground, places))
    report.add(f"f_P, {count} candidates, one sweep", 1e3 * time, "ms", goal=500)
    every = candidates_at(ground, pressed, dense_positions(pressed, 8), (0.25, 0.5, 1.0, 1.6))
    time = seconds(lambda: sweep(ground, every), repeats=5)
    report.add(f"f_P, every 8th pixel, 4 strengths: {len(every)} candidates, one sweep",
               1e3 * time, "ms")  # fmt: skip

    three = smooth_bank(PAPER_ROIS)
    applied = [("grasp", 0), ("knock", 4), ("poke", 10), ("knock", 12)]
    now, goal, positions = problem(three, (5, 3), applied)
    found = jshape.plan(now, goal, bank=three, positions=positions, max_steps=4)
    assert len(found) == 4, found.actions
    time = seconds(
        lambda: jshape.plan(now, goal, bank=three, positions=positions, max_steps=4).status
    )
    report.add("jshape.plan, 45 candidates, 4 steps", 1e3 * time, "ms", goal=5)

    time = seconds(lambda: jshape.plan(now, goal, bank=bank, positions="21x15", max_steps=4).status)
    report.add("jshape.plan, 5 actions at 21x15 places, at most 4 steps", 1e3 * time, "ms")

    goals = jnp.stack([jnp.roll(jnp.asarray(goal), k, 0) for k in range(16)])
    where = candidates_at(
        terrain_of(three, now, goal), three, dict.fromkeys(three.actions, positions)
    )

    def one(goal):
        return greedy.run(terrain_of(three, now, goal), where, Limits(), max_steps=4).steps

    for name, mapped in (("vmapped", jax.vmap(one)), ("in a loop", lambda g: jax.lax.map(one, g))):
        many = jax.jit(mapped)
        time = seconds(lambda: many(goals), repeats=3)  # noqa: B023
        report.add(f"16 goals in one call, {name}: per goal", 1e3 * time / 16, "ms")


def _copying(candidates: Candidates) -> float:
    """Seconds to copy as many floats as a sweep of these candidates reads pixels.

    Each ROI pixel of each candidate is read twice (image, goal), each effect stays in cache.
    """
    pixels = sum(
        len(first) * w * h for first, (w, h) in zip(candidates.first, ROIS.values(), strict=True)
    )
    source = np.ones(min(pixels, 2**26), np.float32)
    copied = np.empty_like(source)
    return seconds(lambda: np.copyto(copied, source), repeats=5) * pixels / source.size
