"""Steps and whole plans of f_D and f_P, at the sizes of the paper's experiments."""

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jshape
from benchmarks.report import Report
from benchmarks.timing import in_turns, seconds
from jshape.actions import PAPER_ROIS
from jshape.data.simulate import ROIS
from jshape.learn.networks import changed_most
from jshape.models import unet
from jshape.models.bank import Bank
from jshape.models.difference import Difference
from jshape.models.network import Network
from jshape.models.refined import Refined
from jshape.planning.candidates import dense_positions
from jshape.planning.evaluate import Candidates, candidates_at, sweep
from jshape.planning.options import DEFAULT_BANK
from jshape.planning.search import greedy
from jshape.planning.search.base import SearchLimits
from jshape.planning.state import SearchState, search_state

GOALS = 64
"""Planned at once."""


def smooth_bank(rois: dict[str, tuple[int, int]], camera: jshape.Camera = jshape.PAPER_BOX) -> Bank:
    """A bank of smooth craters with these ROI sizes (w, h)."""

    def crater(w: int, h: int) -> Difference:
        x, y = np.linspace(-2.5, 2.5, w), np.linspace(-2.5, 2.5, h)
        return Difference(jnp.asarray(-0.2 * np.exp(-(x**2) - y[:, None] ** 2), jnp.float32))

    return Bank(camera, tuple(crater(*r) for r in rois.values()), tuple(rois))


def network_bank(rois: dict[str, tuple[int, int]], kind: str, width: int = 8) -> Bank:
    """f_C whose U-Nets level their ROI to I = 0.45, or f_CR of those with smooth craters.

    Random parameters but for the last layer's, which do not depend on what comes before: such a
    network takes as long as any, and its plans are known.
    """
    craters = smooth_bank(rois)
    found = []
    for number, crater in enumerate(craters.predictors):
        params = unet.init(jax.random.key(number), width)
        output = params["output"]
        kernel = jnp.zeros_like(output["kernel"])
        params["output"] = {
            "kernel": kernel,
            "bias": jnp.arctanh(jnp.full_like(output["bias"], 0.45)),
        }
        network = Network(params, crater.roi)
        if kind == "CR":
            mask = changed_most(np.asarray(crater.delta), "erode")
            network = Refined(network, crater, jnp.asarray(mask, jnp.float32), jnp.float32(0))
        found.append(network)
    return replace(craters, predictors=tuple(found), kind=kind)


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
    _on_a_grid(report, bank, now, goal, dict.fromkeys(bank.actions, positions))
    _dense(report, bank, now, goal)
    _networks(report)

    three = smooth_bank(PAPER_ROIS)
    applied = [("grasp", 0), ("knock", 4), ("poke", 10), ("knock", 12)]
    now, goal, positions = problem(three, (5, 3), applied)
    found = jshape.plan(
        now, goal, **jshape.options(jshape.PAPER, bank=three, positions=positions, max_steps=4)
    )
    assert len(found) == 4, found.actions
    time = seconds(
        lambda: (
            jshape.plan(
                now,
                goal,
                **jshape.options(jshape.PAPER, bank=three, positions=positions, max_steps=4),
            ).status
        )
    )
    report.add("jshape.plan, 45 candidates, 4 steps", 1e3 * time, "ms", goal=5)
    time = seconds(
        lambda: (
            jshape.plan(
                now, goal, **jshape.options(jshape.PAPER, bank=bank, positions="21x15", max_steps=4)
            ).status
        )
    )
    report.add("jshape.plan, 5 actions at 21x15 places, at most 4 steps", 1e3 * time, "ms")
    moving = jshape.load_bank("moving-flour-robot")
    level = np.full(moving.camera.shape, 0.5, np.float32)
    heap = 0.1 * np.exp(-(np.linspace(-3, 3, level.shape[1]) ** 2)).astype(np.float32)
    how = jshape.options(bank=moving, stride=12, yaws=6, max_steps=1)
    evaluations = jshape.plan(level + heap, level, **how).evaluations
    time = seconds(lambda: jshape.plan(level + heap, level, **how).status, repeats=3)
    report.add(f"jshape.plan, actions that move material: {evaluations} candidates, 1 step",
               1e3 * time, "ms", goal=2000)  # fmt: skip
    _many_goals(report, three, now, goal, positions)


def _on_a_grid(report: Report, bank: Bank, now, goal, at: dict[str, np.ndarray]) -> None:
    """One sweep and a few steps at given places: f_D, then f_P."""
    image = search_state(bank, now, goal)
    candidates = candidates_at(image, bank, at)
    count = len(candidates)
    time = seconds(lambda: sweep(image, candidates))
    report.add(f"predict {count} candidates on 395x480 (one sweep)", 1e3 * time, "ms", goal=3)
    report.add(f"{count} candidates, one sweep against copying as many floats",
               time / _copying(candidates), "times")  # fmt: skip
    for steps in (1, 3):
        time = seconds(
            lambda s=steps: greedy.run(image, candidates, SearchLimits(), max_steps=s).status
        )
        report.add(f"greedy, {count} candidates, {steps} steps: per step", 1e3 * time / steps, "ms",
                   goal=3)  # fmt: skip
    found = greedy.run(image, candidates, SearchLimits(), max_steps=3)
    later = (int(found.evaluations) - count) / int(found.steps) / count
    report.add("candidates evaluated again after a step, of all", later, "", tolerance=1.001)

    pressed = jshape.load_bank(DEFAULT_BANK)
    ground = jax.jit(search_state)(pressed, now, goal)
    time = seconds(lambda: jax.jit(search_state)(pressed, now, goal), repeats=5)
    report.add("f_P, the ground of image and goal seen from above", 1e3 * time, "ms")
    places = candidates_at(ground, pressed, at)
    time = seconds(lambda: sweep(ground, places))
    report.add(f"f_P, {count} candidates, one sweep", 1e3 * time, "ms", goal=500)
    report.add("f_P, nodes of its windows against pixels of f_D's",
               _pixels(ground, places) / _pixels(image, candidates), "times",
               tolerance=1.001)  # fmt: skip
    every = candidates_at(ground, pressed, dense_positions(pressed, 8), (0.25, 0.5, 1.0, 1.6))
    time = seconds(lambda: sweep(ground, every), repeats=5)
    report.add(f"f_P, every 8th pixel, 4 strengths: {len(every)} candidates, one sweep",
               1e3 * time, "ms")  # fmt: skip


def _dense(report: Report, bank: Bank, now, goal) -> None:
    """Sweeps of all places, at several strides."""
    pressed = jshape.load_bank(DEFAULT_BANK)
    image, ground = search_state(bank, now, goal), jax.jit(search_state)(pressed, now, goal)
    rows = []
    for stride in (4, 8, 12, 16):
        cells = []
        for model, state in ((bank, image), (pressed, ground)):
            every = candidates_at(state, model, dense_positions(model, stride))
            time = seconds(lambda t=state, c=every: sweep(t, c), least=0.3, repeats=3)
            cells += [f"{1e3 * time:.3g}", f"{1e9 * time / _pixels(state, every):.2g}"]
            if stride == 4 and model is bank:
                report.add(f"f_D, every 4th pixel: {len(every)} candidates, one sweep", 1e3 * time,
                           "ms", goal=500)  # fmt: skip
                report.add("every 4th pixel, one sweep against copying as many floats",
                           time / _copying(every), "times")  # fmt: skip
                report.add("every 4th pixel, pixels of image and goal compared",
                           2 * _pixels(state, every), "", tolerance=1.001)  # fmt: skip
        rows.append((f"{stride}", f"{len(every)}", *cells))
    head = ("every ... pixel", "candidates", "f_D, ms", "ns a pixel", "f_P, ms", "ns a node")
    report.table("All places in one sweep, five actions, one strength.", head, rows)


def _networks(report: Report) -> None:
    """A sweep of the paper's U-Nets beside as many of their forward passes alone."""
    bank = network_bank(PAPER_ROIS, "C", 32)
    now, goal, positions = problem(bank, (5, 3), [("grasp", 0), ("knock", 4)])
    state = search_state(bank, now, goal)
    candidates = candidates_at(state, bank, dict.fromkeys(bank.actions, positions))
    forward = jax.jit(lambda network, roi: network(roi, jnp.zeros(2, jnp.int32)))
    windows = [jnp.full((h, w), 0.6) for w, h in bank.rois.values()]

    def alone():
        passes = zip(bank.predictors, windows, candidates.counts, strict=True)
        return [forward(f, roi) for f, roi, count in passes for _ in range(count)]

    calls = {"sweep": lambda: sweep(state, candidates), "alone": alone}
    took = in_turns(calls, rounds=3)
    report.add("f_C (width 32), 45 candidates, one sweep", 1e3 * took["sweep"], "ms")
    report.add("the same against 45 forward passes alone", took["sweep"] / took["alone"], "times",
               tolerance=1.5)  # fmt: skip


def _many_goals(report: Report, bank: Bank, now, goal, positions: np.ndarray) -> None:
    """Plans of several goals, one by one and at once."""
    how = jshape.options(jshape.PAPER, bank=bank, positions=positions, max_steps=4)
    goals = np.stack([np.roll(goal, k, 0) for k in range(GOALS)])
    calls = {
        "one by one": lambda: [jshape.plan(now, one, **how) for one in goals],
        "at once": lambda: jshape.plan_batch(now, goals, **how),
    }
    for name, taken in (times := in_turns(calls)).items():
        report.add(f"{GOALS} goals, {name}: per goal", 1e3 * taken / GOALS, "ms")
    ratio = times["at once"] / times["one by one"]
    report.add(f"{GOALS} goals, at once against one by one", ratio, "times", goal=1)
    plans = zip(*(call() for call in calls.values()), strict=True)
    same = sum(
        one.actions == other.actions and np.array_equal(one.positions, other.positions)
        for one, other in plans
    )
    report.add(f"{GOALS} goals, at once: plans as each alone", same, "", more=True, tolerance=1)


def _pixels(state: SearchState, candidates: Candidates) -> int:
    """Pixels, or nodes, of the windows of all candidates."""
    sizes = [np.prod(move.shape) for move in state.moves]
    places = sum(n * size for n, size in zip(candidates.counts, sizes, strict=True))
    return int(places) * int(candidates.num_strengths)


def _copying(candidates: Candidates) -> float:
    """Seconds to copy as many floats as a sweep of these candidates reads pixels.

    Each ROI pixel of each candidate is read twice (image, goal), each effect stays in cache.
    """
    pixels = sum(
        count * w * h for count, (w, h) in zip(candidates.counts, ROIS.values(), strict=True)
    )
    source = np.ones(min(pixels, 2**26), np.float32)
    copied = np.empty_like(source)
    return seconds(lambda: np.copyto(copied, source), repeats=5) * pixels / source.size
