"""Problems of planning: what they promise of their goals, whoever made them."""

import jax
import numpy as np
import pytest

from benchmarks.experiments import shapes
from benchmarks.experiments.problems import OVERLAPPING, applied_problems, shape_problems
from benchmarks.experiments.recorded import mpm_problems
from jshape import PAPER_BOX, metric, sim
from jshape.data.simulate import ROIS
from jshape.errors import BadDataset, BadImage
from jshape.models.bank import Bank
from jshape.models.difference import Difference
from jshape.robot.simulated import SimulatedWorld

EDGE = 40
"""Pixels of `PAPER_BOX` that stay flat around a shape."""


@pytest.fixture(scope="module")
def five():
    """A bank of the five actions whose effects do not matter: problems need its ROIs only."""
    nothing = tuple(Difference(jax.numpy.zeros((h, w))) for w, h in ROIS.values())
    return Bank(PAPER_BOX, nothing, tuple(ROIS))


@pytest.fixture(scope="module")
def applied(five):
    return applied_problems(5, 10, five, frames=2)


@pytest.fixture(scope="module")
def drawn():
    return shape_problems(5, 8, frames=2)


def depth_of(image):
    return np.asarray(PAPER_BOX.depth(metric.unweigh(image, PAPER_BOX)))


def corners(action):
    """First and one past the last pixel (u, v) of an applied action's ROI."""
    first = np.array(action.position) - np.array(ROIS[action.action]) // 2
    return first, first + ROIS[action.action]


def share(a, b):
    """Of the smaller ROI that lies in the other, counted pixel by pixel."""
    masks = np.zeros((2, *PAPER_BOX.shape), bool)
    for mask, action in zip(masks, (a, b), strict=True):
        (left, top), (right, bottom) = corners(action)
        mask[top:bottom, left:right] = True
    return (masks[0] & masks[1]).sum() / min(m.sum() for m in masks)


def check_images(problem):
    for image in (problem.start, problem.goal):
        assert image.shape == problem.camera.shape and np.isfinite(image).all()
        assert image.min() >= 0 and image.max() <= 1
    assert problem.start_mm > 0.3
    if problem.bed is not None:
        check_truth(problem)


def check_truth(problem):
    """The goal without noise is near to the one that is seen, and at no distance from itself."""
    apart = metric.to_mm(metric.distance(problem.truth, problem.goal), problem.camera)
    assert apart == 0 if problem.kind == "shape" else 0.05 < apart < 0.5
    assert 0.1 < problem.distance_mm(problem.bed) < problem.start_mm + 0.1


@pytest.mark.full
def test_applied_goals_are_images_far_from_their_start(applied):
    for problem in applied:
        check_images(problem)
        assert problem.kind == "applied" and isinstance(problem.bed, sim.Bed)
        # All but craters is in the camera's range.
        level = depth_of(problem.goal)
        assert np.mean((level > 0.4201) & (level < 0.4699)) > 0.9
    assert {problem.agent for problem in applied} == {"human", "robot"}


@pytest.mark.full
def test_applied_actions_are_in_the_image_and_overlap_where_they_say(applied):
    for k, problem in enumerate(applied):
        for action in problem.applied:
            first, last = corners(action)
            assert (first >= 0).all() and (last <= (480, 395)).all()
        if k % 5 == 4:
            assert problem.name == "deep knock" and len(problem.applied) == 1
            assert problem.applied[0].action == "knock"
            assert 2.0 <= problem.applied[0].strength <= 2.5
            continue
        assert 2 <= len(problem.applied) <= 4
        pairs = [share(a, b) for a, b in zip(problem.applied, problem.applied[1:], strict=False)]
        assert problem.name.endswith("overlapping") == (k in OVERLAPPING)
        assert any(0.2 <= s <= 0.5 for s in pairs) if k in OVERLAPPING else max(pairs) == 0
    every = [action for problem in applied for action in problem.applied]
    assert np.mean([1 <= action.strength <= 2.5 for action in every]) > 0.5
    assert any(action.yaw != 0 for action in every)


@pytest.mark.full
def test_goals_come_from_their_own_record(applied):
    """Another repetition of what is written down ends up nearer to the goal than the start is,
    measured by the bed as by its image."""
    for problem in applied[1:6:2]:  # of the robot's hand, which varies little
        again = SimulatedWorld(jax.random.key(1), problem.bed, agent=problem.agent)
        for action in problem.applied:
            again.act(*action)
        depth = np.asarray(sim.render(again.bed, PAPER_BOX))
        image = metric.weigh(PAPER_BOX.luminance(depth, quantize=False), PAPER_BOX)
        left_mm = metric.to_mm(metric.distance(np.asarray(image), problem.truth), PAPER_BOX)
        assert left_mm == pytest.approx(problem.distance_mm(again.bed), rel=1e-5)
        assert left_mm < 0.5 * problem.distance_mm(problem.bed)


def test_problems_are_the_same_for_the_same_seed(five, applied, drawn):
    for again, before in (
        (applied_problems(5, 3, five, frames=2), applied),
        (shape_problems(5, 3, frames=2), drawn),
    ):
        for a, b in zip(again, before, strict=False):
            assert (a.name, a.applied) == (b.name, b.applied)
            np.testing.assert_array_equal(a.start, b.start)
            np.testing.assert_array_equal(a.goal, b.goal)
            np.testing.assert_array_equal(a.truth, b.truth)
    other = applied_problems(6, 1, five, frames=2)[0]
    assert other.applied != applied[0].applied


def test_shapes_are_wanted_of_a_levelled_bed(drawn):
    for problem in drawn:
        depth = np.asarray(sim.render(problem.bed, PAPER_BOX))
        np.testing.assert_allclose(depth, sim.SURFACE, atol=1e-6)
    # The camera's noise is its own in every look.
    assert len({problem.start.tobytes() for problem in drawn}) == len(drawn)


def test_drawn_goals_are_at_the_height_of_their_bed(drawn):
    assert [p.name.split()[0] for p in drawn[:4:3]] == ["letter", "ridge"]
    for problem in drawn:
        check_images(problem)
        assert problem.kind == "shape" and not problem.applied
        level = np.asarray(sim.render(problem.bed, PAPER_BOX)).mean()
        goal = depth_of(problem.goal)
        np.testing.assert_allclose(goal[:EDGE], level, atol=2e-5)
        assert goal.min() > 0.42 and goal.max() < 0.47


@pytest.mark.parametrize("kind", shapes.DRAWN)
def test_drawn_shapes_can_be_held_by_flour(kind):
    pixel = 0.445 / 433
    for seed in range(8):
        name, relief = shapes.DRAWN[kind](np.random.default_rng(seed))
        assert kind in name and relief.shape == PAPER_BOX.shape and relief.dtype == np.float32
        flat = relief.copy()
        flat[EDGE:-EDGE, EDGE:-EDGE] = 0
        assert not flat.any()
        slope = np.hypot(*np.gradient(relief.astype(float), pixel)).max()
        assert 0.1 < slope < 1.05 * shapes.STEEPEST < float(sim.KINETIC_SAND.steepest)
        if kind == "ridge":
            assert abs(relief.mean()) < 1e-7 and -0.018 <= relief.min() <= -0.0075
            assert 0 < relief.max() < -relief.min()
        else:
            assert relief.min() == 0 and 0.0075 < relief.max() <= 0.018


def test_every_letter_is_one_piece_of_thick_stroke():
    for name, lines in shapes.LETTERS.items():
        points = np.concatenate(lines)
        assert np.abs(points).max() <= 1.01, name
    wide = [
        (shapes.letter(np.random.default_rng(seed)).relief > 0.004).sum() * (0.445 / 433) ** 2
        for seed in range(8)
    ]
    assert min(wide) > 0.004  # m²: a stroke 30 mm wide where it is 4 mm deep, 13 cm long


def test_measured_maps_are_laid_into_the_middle():
    x, y = np.meshgrid(np.linspace(-1, 1, 90), np.linspace(-1, 1, 60))
    relief = shapes.sand(40 * np.exp(-5 * (x**2 + y**2)) - 3)
    assert abs(relief.mean()) < 1e-7 and np.isclose(np.abs(relief).max(), shapes.HEIGHT)
    assert not relief[:EDGE].any() and not relief[:, -EDGE:].any()
    assert relief[197, 240] == relief.max()
    for wrong in (
        np.zeros((5, 5)),
        np.full((5, 5), np.nan),
        np.zeros(5),
        np.array([["a"] * 3] * 3),
    ):
        with pytest.raises(BadImage):
            shapes.sand(wrong)


def test_a_cloud_of_dough_becomes_a_piece_on_a_bed(rng):
    points = rng.uniform((0, 0, 0), (0.15, 0.15, 0.001), (4000, 3))
    piece = np.hypot(points[:, 0] - 0.06, points[:, 1] - 0.08) < 0.03
    points[piece, 2] += 0.03
    points = np.concatenate([points, [[0.14, 0.14, 0.03]]])  # a speck is no piece
    relief = shapes.dough(points.astype(np.float32))
    assert abs(relief.mean()) < 1e-7 and not relief[:EDGE].any()
    assert np.isclose(relief.max() - relief.min(), shapes.HEIGHT, rtol=0.1)
    raised = relief < relief.min() / 2
    v, u = np.argwhere(raised).mean(0)
    assert np.hypot(u - 240, v - 197) < 5 and raised[195, 240]
    with pytest.raises(BadImage, match="no piece"):
        shapes.dough(np.zeros((9, 3), np.float32))


def test_absent_measurements_are_left_out(tmp_path, drawn):
    names = [p.name for p in shape_problems(5, 5, tmp_path, frames=2)]
    assert names == [p.name for p in drawn[:5]]
    with pytest.raises(BadDataset, match="holds no seqs"):
        mpm_problems(tmp_path)


def test_real_sand_and_dough_are_goals(shared_data):
    problems = shape_problems(0, 12, shared_data / "real", frames=2)
    names = [p.name.split()[0] for p in problems]
    assert names.count("sand") == names.count("dough") == 2
    for problem in problems[4:6] + problems[10:]:
        check_images(problem)
        goal = depth_of(problem.goal)
        assert abs(goal.mean() - np.asarray(sim.render(problem.bed, PAPER_BOX)).mean()) < 1e-5
        assert goal[200, 240] != goal[0, 0] and 0.43 < goal.min() < goal.max() < 0.47


@pytest.mark.parametrize("noisy", [False, True])
def test_recorded_sequences_are_problems_without_a_bed(shared_data, noisy):
    problems = mpm_problems(shared_data / "mpm", noisy=noisy)
    assert len(problems) == 4
    for problem in problems:
        check_images(problem)
        assert problem.bed is None and len(problem.applied) == 3
        with pytest.raises(BadImage, match="noise only"):
            problem.distance_mm(sim.flat_bed())
        places = problem.places.tolist()
        assert all(list(action.position) in places for action in problem.applied)


def test_a_relief_fills_the_view_at_its_scale(rng):
    slope = np.linspace(-10, 10, 50)[None, :] * np.ones((40, 1))
    depth = shapes.depth_of_relief(slope, PAPER_BOX, scale=1e-3)
    assert depth.shape == PAPER_BOX.shape
    np.testing.assert_allclose(depth.mean(), 0.445, atol=1e-5)
    np.testing.assert_allclose(depth[:, [0, -1]], [[0.435, 0.455]] * 395, atol=1e-4)
    assert np.diff(depth[100]).min() >= 0
    slope[3, 4] = np.nan
    assert 0 < np.isnan(shapes.depth_of_relief(slope, PAPER_BOX)).mean() < 0.01


@pytest.mark.parametrize("relief", [np.zeros(5), np.zeros((1, 9)), np.zeros((4, 4), complex)])
def test_other_arrays_are_refused(relief):
    with pytest.raises(BadImage, match="relief"):
        shapes.depth_of_relief(relief, PAPER_BOX)
