"""Where a search works: distances and places of images and of the ground, turned hands."""

from dataclasses import dataclass, replace
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from jshape import PAPER_BOX, Camera, distance, load_bank, metric, sim
from jshape.models.bank import Bank
from jshape.models.base import Predictor
from jshape.models.difference import Difference
from jshape.models.turn import turn
from jshape.planning.apply import after_action, shift
from jshape.planning.candidates import placed_positions
from jshape.planning.evaluate import candidates_at, sweep
from jshape.planning.search import greedy, refine
from jshape.planning.search.base import SearchLimits, SearchProblem
from jshape.planning.search.sequence import Pose, act_between, measured
from jshape.planning.state import search_state

CAMERA = Camera(24, 18, 30.0, 30.0, 12.0, 9.0, 0.42, 0.47)
QUARTER = replace(PAPER_BOX, width=120, height=98, fx=433 / 4, fy=433 / 4, u0=240 / 4, v0=197 / 4)


def difference(seed, w, h):
    return Difference(jnp.asarray(np.random.default_rng(seed).normal(0, 0.1, (h, w)), jnp.float32))


def image_of(seed, camera=CAMERA):
    rough = gaussian_filter(np.random.default_rng(seed).normal(size=camera.shape), 2)
    return jnp.asarray(0.5 + 0.1 * rough / rough.std(), jnp.float32)


def differences(*sizes):
    predictors = tuple(difference(k, *size) for k, size in enumerate(sizes))
    return Bank(CAMERA, predictors, tuple(f"a{k}" for k in range(len(sizes))))


@jax.jit
def ground(bank, now, goal):
    return search_state(bank, now, goal)


def knock_and_poke():
    """Two of the bundled hands, below a camera of a quarter of the paper's resolution."""
    bank = load_bank("pressed-flour-robot").seen_by(QUARTER, 0.45)
    chosen = [bank.actions.index(name) for name in ("knock", "poke")]
    return replace(
        bank,
        actions=tuple(bank.actions[k] for k in chosen),
        predictors=tuple(bank.predictors[k] for k in chosen),
        errors_mm=None,
    )


@pytest.fixture(scope="module")
def pressed():
    return knock_and_poke()


@pytest.fixture(scope="module")
def beds():
    """Images of two simulated beds with hills, and of a nearly level one."""
    return [
        metric.weigh(
            QUARTER.luminance(
                sim.render(sim.irregular_bed(jax.random.key(seed), std), QUARTER), quantize=False
            ),
            QUARTER,
        )
        for seed, std in ((0, 0.008), (1, 0.008), (2, 0.003))
    ]


def test_d_of_an_image_is_the_papers():
    now, goal = image_of(1), image_of(2)
    state = search_state(differences((5, 4)), now, goal)
    assert float(state.distance) == pytest.approx(float(distance(now, goal)), rel=1e-6)
    assert float(state.distance_of(goal)) == 0
    third = image_of(3)
    assert float(state.distance_of(third)) == pytest.approx(float(distance(third, goal)), rel=1e-6)


@pytest.mark.full
def test_d_on_the_ground_is_within_a_hundredth_of_the_papers(pressed, beds):
    hills, other, level = beds
    for now, goal in ((hills, other), (hills, level), (level, other), (hills, 0.9 * hills)):
        state = ground(pressed, now, goal)
        assert state.now.shape != now.shape  # it is not the image that is looked at
        assert float(state.distance) == pytest.approx(float(distance(now, goal)), rel=0.01)
    assert float(ground(pressed, hills, hills).distance) == 0


def test_the_weights_of_all_nodes_are_those_of_all_pixels(pressed, beds):
    # A bed that is everywhere lower by z changes d by the mean of R over all pixels, times z.
    level = jnp.full(QUARTER.shape, 0.5) * metric.r_matrix(QUARTER) * QUARTER.top
    state = ground(pressed, level, beds[0])
    rays = metric.ray_lengths(QUARTER) / metric.max_ray_length(QUARTER)
    per_metre = float(rays.mean()) / (QUARTER.z_max - QUARTER.z_min)
    assert float(state.weight.sum()) == pytest.approx(per_metre, rel=0.01)
    assert float(state.weight.min()) == 0  # beyond the image's edge nothing counts
    flat = replace(state, goal=state.now)
    lower = float(flat.distance_of(flat.now + 0.002))
    assert lower == pytest.approx(0.002 * per_metre, rel=0.01)


@pytest.mark.parametrize("kind", ["image", "ground"])
def test_places_and_nodes_there_and_back(kind, pressed, beds):
    if kind == "image":
        state = search_state(differences((5, 4)), image_of(1), image_of(2))
    else:
        state = ground(pressed, beds[0], beds[1])
    rows, columns = state.now.shape
    nodes = np.stack(np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij"), -1)
    nodes = nodes.reshape(-1, 2).astype(np.int32)
    np.testing.assert_array_equal(state.node(state.pixel(nodes)), nodes)
    height, width = (CAMERA if kind == "image" else QUARTER).shape
    pixels = np.random.default_rng(1).uniform(0, [height - 1, width - 1], (200, 2))
    apart = np.abs(state.pixel(state.node(pixels)) - pixels) / np.asarray(state.pitch)
    assert apart.max() < 0.5 + 1e-4
    inside = state.node(pixels)
    assert (inside >= 0).all() and (inside < [rows, columns]).all()


def test_a_node_of_the_ground_lies_below_its_pixel(pressed):
    """A bump of the bed is found at the node of the pixel that it is seen in."""
    v, u = np.mgrid[: QUARTER.height, : QUARTER.width]
    level = 0.4 * np.asarray(metric.r_matrix(QUARTER)) * QUARTER.top  # at 0.45 m, as places are
    for centre in ((49, 60), (20, 30), (80, 100)):
        bump = 0.02 * np.exp(-((v - centre[0]) ** 2 + (u - centre[1]) ** 2) / 18)
        image = jnp.asarray(level + bump, jnp.float32)
        state = ground(pressed, image, image)
        highest = np.unravel_index(np.argmin(state.now), state.now.shape)
        pixel = state.pixel(np.array(highest))
        assert np.abs(pixel - centre).max() <= 1.0


@pytest.mark.full
def test_changes_on_the_ground_are_those_of_the_images(pressed, beds):
    """To a few hundredths, at a quarter of the resolution: what a search chooses by."""
    where = placed_positions(pressed, "9x7")
    for now, goal in ((beds[0], beds[1]), (beds[0], beds[2])):
        state = ground(pressed, now, goal)
        candidates = candidates_at(state, pressed, where)
        for number, found in enumerate(sweep(state, candidates)):
            predict = jax.jit(pressed.predictors[number].__call__)
            w, h = pressed.predictors[number].roi
            centres = candidates.of_move(number, candidates.pixels)
            windows = [np.s_[v - h // 2 :, u - w // 2 :] for u, v in centres]
            before, wanted = (
                np.stack([np.asarray(image)[window][:h, :w] for window in windows])
                for image in (now, goal)
            )
            corner = jnp.asarray(centres - np.array([w // 2, h // 2]), jnp.int32)
            after = np.clip(predict(jnp.asarray(before), corner), 0, 1)
            change = np.abs(after - wanted) - np.abs(before - wanted)
            image_space = change.sum((1, 2)) / now.size
            assert np.corrcoef(found[:, 0], image_space)[0, 1] > 0.98
            apart = np.abs(found[:, 0] - image_space)
            assert apart.mean() < 0.08 * np.abs(image_space).max()


def test_a_quarter_turn_leads_from_u_to_v():
    square = np.random.default_rng(2).normal(size=(7, 7)).astype(np.float32)
    # u points right and v down: on the screen that is clockwise.
    quarter = turn(jnp.asarray(square), np.pi / 2, (7, 7))
    np.testing.assert_allclose(quarter, np.rot90(square, -1), atol=1e-6)
    np.testing.assert_allclose(
        turn(jnp.asarray(square), -np.pi / 2, (7, 7)), np.rot90(square), atol=1e-6
    )
    spot = np.zeros((7, 7), np.float32)
    spot[3, 6] = 1.0  # along u from the middle
    np.testing.assert_allclose(turn(jnp.asarray(spot), np.pi / 2, (7, 7))[6, 3], 1.0, atol=1e-6)


@pytest.mark.parametrize("yaw", [0.0, 2 * np.pi, 2 * np.pi - 1e-6, 1e-6])
def test_a_whole_turn_is_none(yaw):
    field = np.random.default_rng(3).normal(size=(9, 9)).astype(np.float32)
    np.testing.assert_allclose(turn(jnp.asarray(field), yaw, (9, 9)), field, atol=5e-5)


def test_a_turned_move_is_the_turned_change():
    bank = differences((9, 5), (3, 3))
    now = image_of(4)
    moves = [(0, None, 1.0), (0, jnp.float32(np.pi / 2), 1.0), (1, None, 1.0)]
    state = search_state(bank, now, now, moves)
    straight, turned, small = state.moves
    assert (straight.shape, turned.shape, small.shape) == ((5, 9), (9, 9), (3, 3))
    assert (turned.roi, turned.action, small.action) == ((9, 9), 0, 1)
    upright = np.zeros((9, 9), np.float32)
    upright[2:7] = bank.predictors[0].delta
    window, first = now[:9, :9], jnp.zeros(2, jnp.int32)
    change = state.act(1, now, first, 1.0)[:9, :9] - window
    np.testing.assert_allclose(
        change, jnp.clip(window + np.rot90(upright, -1), 0, 1) - window, atol=1e-6
    )
    patch, _ = after_action(bank.placed(0, np.pi / 2), now, first)
    np.testing.assert_allclose(patch, jnp.clip(window + change, 0, 1), atol=1e-6)


def test_a_hand_turned_on_the_ground_is_the_ground_turned_below_it(pressed):
    hand = pressed.predictors[1]
    n = (max(hand.grid.shape) - 1) // 2 * 2 + 1  # odd
    upright = hand.turned(0.0)
    names = ("reference", "tool", "give", "rest", "swell", "follow", "deep")
    maps = {name: getattr(upright, name)[:n, :n] for name in names}
    upright = replace(upright, grid=replace(upright.grid, shape=(n, n)), **maps)
    surface = 0.45 + 0.02 * image_of(5, replace(CAMERA, width=n, height=n))
    turned = upright.turned(np.pi / 2).change(surface)
    below = upright.change(jnp.rot90(surface))
    assert float(jnp.abs(turned).max()) > 0.005
    np.testing.assert_allclose(turned, np.rot90(below, -1), atol=2e-6)


def between(state, now, node, strength, turn=0.0, stretch=1.0):
    """The map after the first move at a place, and in a direction and of a length, of one's own."""
    kernel, move = state.kernels[0], state.moves[0]
    half = 0.0 if state.node_m is None else move.path_m / 2 / state.node_m
    numbers = (turn, stretch, move.yaw, half)
    pose = Pose(node, *(jnp.asarray(number, jnp.float32) for number in numbers))
    return act_between(state, kernel, kernel.member(0), now, pose, strength)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Pointing(Predictor):
    """Writes down where it is told that its ROI is."""

    roi: ClassVar[tuple[int, int]] = (7, 6)
    step: jax.Array

    def __call__(self, roi, corner, strength=1.0):
        corner = jnp.asarray(corner, jnp.float32)
        return jnp.full_like(roi, self.step * corner[..., 0] + 0.0001 * corner[..., 1])


def test_a_predictor_is_told_the_corner_as_u_and_v():
    u, v, expected = 12, 2, 0.02 * 12 + 0.0001 * 2
    bank, image = Bank(CAMERA, (Pointing(jnp.float32(0.02)),), ("point",)), jnp.full((18, 24), 0.5)
    window = np.s_[v : v + 6, u : u + 7]
    state = search_state(bank, image, image)
    candidates = candidates_at(state, bank, {"point": np.array([[u + 3, v + 3]])})
    found = [
        bank.predict("point", image[window], position=(u + 3, v + 3)),
        after_action(bank.predictors[0], image, jnp.array([u, v]))[0],
        state.act(0, image, jnp.array([v, u]), 1.0)[window],
        between(state, image, jnp.array([v + 3.0, u + 3.0]), jnp.float32(1.0))[window],
    ]
    for one in found:
        np.testing.assert_allclose(one, expected, atol=1e-6)
    (changes,) = sweep(state, candidates)
    np.testing.assert_allclose(changes[:, 0], (0.5 - expected) * 42 / (18 * 24), rtol=1e-4)


SIZES = ((7, 6), (4, 8), (24, 5), (24, 18))  # (w, h); the last ones are as large as the image


@pytest.mark.full
@pytest.mark.parametrize("size", SIZES)
@settings(max_examples=20)
@given(seed=st.integers(0, 2**31))
def test_between_nodes_begins_and_ends_on_nodes(size, seed):
    """On a node, the last ones of the map too, it is `act`."""
    (w, h), rng = size, np.random.default_rng(seed)
    state = search_state(differences(size), image_of(6), image_of(7))
    move = state.moves[0]
    first = rng.integers(0, [18 - h + 1, 24 - w + 1])
    if seed % 2:
        first = np.array([18 - h, 24 - w])
    node = jnp.asarray(first + move.middle, jnp.float32)
    strength = jnp.float32(rng.uniform(0.5, 1.5))
    there = between(state, state.now, node, strength)
    on = state.act(0, state.now, jnp.asarray(first, jnp.int32), strength)
    np.testing.assert_allclose(there, on, atol=1e-6)


def test_half_way_is_the_mean_of_the_neighbours():
    """On a plane, where interpolation is exact, and away from the limits."""
    v, u = np.mgrid[:18, :24]
    now = jnp.asarray(0.3 + 0.01 * u + 0.005 * v, jnp.float32)
    state = search_state(differences((7, 6)), now, now)

    def at(v, u):
        return np.asarray(between(state, now, jnp.array([v, u]), jnp.float32(0.5)))

    np.testing.assert_allclose(at(8.5, 10.0), (at(8.0, 10.0) + at(9.0, 10.0)) / 2, atol=1e-6)
    np.testing.assert_allclose(at(8.0, 10.5), (at(8.0, 10.0) + at(8.0, 11.0)) / 2, atol=1e-6)
    four = [at(8.0, 10.0), at(9.0, 10.0), at(8.0, 11.0), at(9.0, 11.0)]
    np.testing.assert_allclose(at(8.5, 10.5), np.mean(four, 0), atol=1e-6)
    np.testing.assert_allclose(
        at(8.25, 10.0), 0.75 * at(8.0, 10.0) + 0.25 * at(9.0, 10.0), atol=1e-6
    )


@pytest.mark.full
def test_d_has_a_slope_along_all_numbers():
    now = image_of(8)
    state = search_state(differences((7, 6)), now, now)
    state = replace(state, node_m=jnp.float32(1.0), moves=(replace(state.moves[0], path_m=4.0),))
    goal = between(state, now, jnp.array([8.3, 10.6]), jnp.float32(0.9), 0.1, 1.1)
    state = replace(state, goal=goal)

    def d(values):
        after = between(state, now, values[:2], *values[2:])
        return state.distance_of(after)

    start = jnp.array([8.4, 10.5, 0.95, 0.05, 1.05])
    slope = jax.grad(d)(start)
    for k, step in enumerate(np.eye(5, dtype=np.float32) * 1e-3):
        numeric = (d(start + step) - d(start - step)) / 2e-3
        assert float(slope[k]) == pytest.approx(float(numeric), rel=0.05, abs=1e-5)
    assert (
        float(slope @ jnp.array([0.1, -0.1, 0.05, -0.05, -0.05])) > 0
    )  # it leads away from the goal


@pytest.mark.parametrize(
    ("action", "yaw", "turn", "stretch", "share"),
    [
        ("sweep", 0.5, 0.25, 1.0, 0.03),
        ("sweep", 0.5, 0.0, 1.2, 0.06),
        ("scoop", -2.0, -0.3, 1.0, 0.03),
    ],
)
def test_between_directions_and_lengths_is_what_those_moves_do(
    beds, action, yaw, turn, stretch, share
):
    """Against the hand turned, and its path lengthened, by the predictor itself."""
    bank = load_bank("moving-flour-robot").seen_by(QUARTER, 0.45)
    number = bank.actions.index(action)
    moves = [(number, yaw, 1.0), (number, yaw + turn, stretch)]
    state = search_state(bank, beds[2], beds[2], moves)
    node = np.array(state.now.shape) // 2
    found = between(
        state, state.now, jnp.asarray(node, jnp.float32), jnp.float32(1.0), turn, stretch
    )
    true = state.act(1, state.now, jnp.asarray(node - state.moves[1].middle, jnp.int32), 1.0)
    near = state.act(0, state.now, jnp.asarray(node - state.moves[0].middle, jnp.int32), 1.0)
    change = np.abs(true - state.now).sum()
    assert np.abs(found - true).sum() < share * change
    assert np.abs(near - true).sum() > 4 * np.abs(found - true).sum()


@pytest.mark.full
def test_searches_on_the_ground_report_what_they_reach(pressed, beds):
    """A greedy plan for simulated beds, then refined between the nodes."""
    state = ground(pressed, beds[0], beds[2])
    where = placed_positions(pressed, "9x7")
    problem = SearchProblem(
        state, candidates_at(state, pressed, where, (1.0, 1.5)), SearchLimits(), max_steps=4
    )
    found = greedy.search(problem)
    assert int(found.steps) == 4
    again, now, distances = measured(state, found)
    assert float(found.distance) == pytest.approx(float(again.distance), rel=1e-5)
    assert (np.diff(distances[:5]) < 0).all()
    low, high = (float(x) for x in state.limits)
    digit = 3e-8  # m, the last of float32 there: some processors round up once more (fused sums)
    assert low - digit <= float(now.min()) <= float(now.max()) <= high + digit
    refined = refine.refined(problem, found)
    assert float(refined.distance) < 0.99 * float(found.distance)
    assert float(measured(state, refined)[0].distance) == pytest.approx(
        float(refined.distance), rel=1e-5
    )


@pytest.mark.parametrize("by", [(0.0, 0.0), (0.25, 0.0), (0.0, -0.5), (-0.75, 0.4)])
def test_shift_reads_further(by):
    v, u = np.mgrid[:6, :8].astype(np.float32)
    plane = 0.3 + 0.5 * u - 0.2 * v
    moved = np.asarray(shift(jnp.asarray(plane), jnp.asarray(by)))
    expected = 0.3 + 0.5 * np.clip(u + by[0], 0, 7) - 0.2 * np.clip(v + by[1], 0, 5)
    np.testing.assert_allclose(moved, expected, atol=1e-5)
    if by == (0.0, 0.0):
        np.testing.assert_array_equal(moved, plane)


@pytest.mark.full
def test_an_exact_place_moves_the_change_and_not_the_bed():
    bank = differences((7, 6))
    bump = np.zeros((6, 7), np.float32)
    bump[3, 3] = 0.1
    bank = replace(bank, predictors=(Difference(jnp.asarray(bump)),))
    image, corner = image_of(9), jnp.array([6, 5], jnp.int32)
    offset = jnp.array([-0.5, 0.25])
    patch, clipped = after_action(bank.predictors[0], image, corner, 1.0, offset)
    change = np.asarray(patch - image[5:11, 6:13])
    assert float(clipped) == 0 and change.sum() == pytest.approx(0.1, rel=1e-4)
    v, u = np.mgrid[:6, :7]
    middle = [(change * n).sum() / change.sum() for n in (v, u)]
    np.testing.assert_allclose(middle, [3.25, 2.5], atol=1e-4)
    # The same as on the state, between its nodes.
    state = search_state(bank, image, image)
    node = jnp.array([5.0, 6.0]) + jnp.asarray(state.moves[0].middle, jnp.float32) + offset[::-1]
    there = between(state, image, node, jnp.float32(1.0))
    np.testing.assert_allclose(there[5:11, 6:13], patch, atol=1e-6)
