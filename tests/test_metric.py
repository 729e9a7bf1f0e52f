"""Laws of the paper's distance, and its value computed another way."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jshape import D435_NOMINAL, PAPER_BOX, distance, metric, r_matrix, ray_lengths, to_mm, weigh
from jshape.errors import BadImage
from tests.reference import greedy as twin
from tests.test_camera import SMALL, points_by_hand


def test_ray_lengths_match_the_paper():
    lengths = np.asarray(ray_lengths(D435_NOMINAL))
    assert lengths.min() == 1.0
    assert np.unravel_index(lengths.argmin(), lengths.shape) == (240, 424)
    np.testing.assert_allclose(lengths.max(), 1.568, atol=5e-4)
    np.testing.assert_allclose(metric.max_ray_length(D435_NOMINAL), lengths.max(), rtol=1e-6)


@pytest.mark.parametrize("window", [(0, 0, 5, 4), (7, 5, 5, 4), (2, 1, 8, 7)])
def test_the_longest_ray_is_at_a_corner_of_any_window(window):
    camera = SMALL.crop(*window)
    np.testing.assert_allclose(
        metric.max_ray_length(camera), np.max(ray_lengths(camera)), rtol=1e-6
    )


def test_the_weight_of_a_roi_is_a_window_of_the_whole():
    (u, v), (w, h) = (371, 22), (48, 31)
    whole = np.asarray(ray_lengths(PAPER_BOX) / metric.max_ray_length(PAPER_BOX))
    found = metric.roi_weight(PAPER_BOX, jnp.array([u, v]), (w, h))
    np.testing.assert_allclose(found, whole[v : v + h, u : u + w], rtol=1e-6)


@pytest.mark.parametrize("batch", [(), (1,), (3, 2)])
def test_distance_is_a_metric(batch, rng):
    a, b, c = rng.random((3, *batch, 9, 12), np.float32)
    np.testing.assert_array_equal(distance(a, a), np.zeros(batch))
    np.testing.assert_allclose(distance(a, b), distance(b, a), rtol=1e-6)
    assert (np.asarray(distance(a, b)) > 0).all()
    slack = np.asarray(distance(a, b)) + np.asarray(distance(b, c)) - np.asarray(distance(a, c))
    assert (slack > -1e-6).all()
    assert (np.asarray(distance(np.zeros((9, 12)), np.ones((9, 12)))) == 1).all()


@pytest.mark.full
@settings(max_examples=30)
@given(seed=st.integers(0, 2**31), h=st.integers(1, 300), w=st.integers(1, 600))
def test_all_routes_of_distance_equal_the_loop(seed, h, w):
    """NumPy and JAX arrays, one pair and batches, small and large images, eager and jitted."""
    a, b = np.random.default_rng(seed).random((2, h, w), np.float32)
    truth = twin.distance(a, b)
    np.testing.assert_allclose(distance(a, b), truth, rtol=2e-6)
    np.testing.assert_allclose(distance(jnp.asarray(a), jnp.asarray(b)), truth, rtol=2e-6)
    np.testing.assert_allclose(distance(a[None], b), [truth], rtol=2e-6)
    np.testing.assert_allclose(distance(a[::-1].T, b[::-1].T), truth, rtol=2e-6)


def test_the_compiled_distance_equals_the_one_in_memory(rng):
    a, b = rng.random((3, 1, 395, 480), np.float32), rng.random((1, 2, 395, 480), np.float32)
    in_memory = distance(a, b)
    assert in_memory.shape == (3, 2)
    np.testing.assert_allclose(jax.jit(distance)(a, b), in_memory, rtol=2e-6)


@pytest.mark.parametrize("x64", [False, True])
def test_whatever_comes_in_jax_arrays_of_float32_come_out(x64, rng):
    def all_of_them(a, b, camera):
        images = [f(x, camera) for f in (weigh, metric.unweigh) for x in (a, b)]
        d = distance(a, b)
        rays = [ray_lengths(camera), metric.max_ray_length(camera), r_matrix(camera)]
        corner = metric.roi_weight(camera, jnp.array([2, 3]), (4, 5))
        return [*images, d, to_mm(d, camera), to_mm(0.5, camera), *rays, corner]

    a, b = rng.random((2, *SMALL.shape))
    camera = replace(SMALL, fx=np.float64(SMALL.fx), z_min=np.float64(SMALL.z_min))
    with jax.enable_x64(x64):
        ways = [(a, b), (a.astype("f4"), b), (jnp.asarray(a), jnp.asarray(b))]
        expected = all_of_them(a.tolist(), b.tolist(), camera)
        for way in ways:
            for function in (all_of_them, jax.jit(all_of_them)):
                for one, other in zip(function(*way, camera), expected, strict=True):
                    assert isinstance(one, jax.Array) and one.dtype == np.float32
                    np.testing.assert_allclose(one, other, rtol=2e-6)


def test_the_same_images_are_equally_far_wherever_storage_lies(rng, monkeypatch):
    a, b = rng.random((2, 300, 300), np.float32)
    empty, found = np.empty, set()
    for shift in range(16):

        def shifted(count, dtype=float, by=shift):
            if not isinstance(count, int):  # NumPy's own
                return empty(count, dtype)
            return empty(count + by, dtype)[by:]

        with monkeypatch.context() as patched:
            patched.setattr(np, "empty", shifted)
            found.add(float(distance(a, b)))
    assert len(found) == 1


def test_distance_broadcasts_one_goal_and_has_a_gradient(rng):
    a, b = rng.random((4, 9, 12), np.float32), rng.random((9, 12), np.float32)
    np.testing.assert_allclose(distance(a, b), [distance(x, b) for x in a], rtol=1e-6)
    np.testing.assert_allclose(jax.vmap(distance, (0, None))(a, b), distance(a, b), rtol=1e-6)
    np.testing.assert_allclose(jax.grad(distance)(a[0], b), np.sign(a[0] - b) / b.size, rtol=1e-6)


def test_nan_is_never_averaged_in(rng):
    a, b = rng.random((2, 9, 12), np.float32)
    a[3, 4] = np.nan
    assert np.isnan(distance(a, b)) and np.isnan(distance(a[None], b)).all()


@pytest.mark.parametrize("bits", [8, 16])
def test_mm_is_the_mean_distance_of_matched_points(bits, rng):
    camera = replace(SMALL, bits=bits)
    la, lb = rng.integers(0, 2**bits, (2, *camera.shape))
    apart = np.linalg.norm(points_by_hand(camera, la) - points_by_hand(camera, lb), axis=-1)
    mm = to_mm(distance(weigh(la, camera), weigh(lb, camera)), camera)
    np.testing.assert_allclose(mm, 1e3 * apart.mean(), rtol=1e-5)


def test_weigh_is_r_times_l_in_the_unit_interval(rng):
    luminance = rng.integers(0, 256, PAPER_BOX.shape)
    image = np.asarray(weigh(luminance, PAPER_BOX))
    np.testing.assert_allclose(image, np.asarray(r_matrix(PAPER_BOX)) * luminance, rtol=1e-6)
    assert image.min() >= 0 and weigh(np.full(PAPER_BOX.shape, 255), PAPER_BOX).max() <= 1
    np.testing.assert_allclose(metric.unweigh(image, PAPER_BOX), luminance, rtol=1e-5)


@pytest.mark.full
def test_the_weighted_distance_does_not_depend_on_the_viewpoint():
    """The paper's figure: the same two clouds of three points, seen before and after a turn.

    Each pair of matched points lies on one ray through the camera, so a turn about the camera's
    centre keeps the rays: the weighted d stays, the mean depth difference does not.
    """
    camera = replace(D435_NOMINAL, bits=24)
    turn = np.deg2rad(20)
    turned = np.array(
        [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
    )

    def see(near, far):
        """Weighed and plain mean distance over the three pixels that both clouds reach."""
        lp, lq = (np.asarray(camera.project(p, quantize=False)) for p in (near, far))
        both = (lp > 0) & (lq > 0)
        assert both.sum() == 3
        ip, iq = (np.asarray(weigh(x, camera)) for x in (lp, lq))
        mm = float(to_mm(np.abs(ip - iq)[both].mean(), camera))
        plain = float(np.abs(camera.depth(lp) - camera.depth(lq))[both].mean() * 1e3)
        return mm, plain

    u = np.array([250, 300, 350])  # rays through pixel centres, left of the axis
    rays = np.stack([(u - 424) / 415, np.full(3, 0.0), np.ones(3)], -1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    near, far = rays * 0.80, rays * np.array([[0.90], [0.95], [0.85]])
    truth = 1e3 * np.linalg.norm(near - far, axis=-1).mean()
    before, plain_before = see(near, far)
    after, plain_after = see(near @ turned.T, far @ turned.T)
    np.testing.assert_allclose(before, truth, rtol=2e-3)
    # After the turn the rays fall between pixel centres: half a pixel is 0.1 % of R here.
    np.testing.assert_allclose(after, before, rtol=2e-3)
    assert abs(plain_after - plain_before) > 0.04 * plain_before


def test_lists_are_taken_too():
    luminance = np.arange(108).reshape(9, 12)
    np.testing.assert_array_equal(weigh(luminance.tolist(), SMALL), weigh(luminance, SMALL))
    assert distance([[0.0, 1.0]], [[1.0, 1.0]]) == 0.5


def test_wrong_shapes_are_named():
    with pytest.raises(BadImage, match=r"\(9, 12\) and \(9, 13\)"):
        distance(np.zeros((9, 12)), np.zeros((9, 13)))
    for a, b in [((3,), (3,)), ((0, 4), (0, 4)), ((2, 4), (2, 4, 4))]:
        with pytest.raises(BadImage, match="last two axes"):
            distance(np.zeros(a), np.zeros(b))
    with pytest.raises(BadImage, match="do not broadcast"):
        distance(np.zeros((2, 3, 4)), np.zeros((3, 3, 4)))
    with pytest.raises(BadImage, match="complex"):
        distance(np.zeros((3, 4), complex), np.zeros((3, 4)))
    with pytest.raises(BadImage, match=r"\(480,\); this camera makes"):
        metric.unweigh(np.zeros(480), PAPER_BOX)
    with pytest.raises(BadImage, match=r"\(12, 9\); expected \(9, 12\)"):
        SMALL.points(np.zeros((12, 9)))
    with pytest.raises(BadImage, match=r"\(5, 2\); expected \(P, 3\)"):
        SMALL.project(np.zeros((5, 2)))
    with pytest.raises(BadImage, match=r"\(12, 9\); this camera makes \(9, 12\)"):
        weigh(np.zeros((12, 9)), SMALL)


def test_a_distance_is_that_of_the_image_as_it_was(rng):
    """Whoever goes on with the same buffer changes no distance that was asked for before."""
    goal, image = np.zeros((2, 405, 575), np.float32)
    seen = rng.random(goal.shape) < 0.9
    asked, expected = [], []
    for k in range(12):
        image[21 * k : 21 * k + 42, 20 * k : 20 * k + 42] = 1.0
        asked.append(distance(image, goal, seen))
        expected.append(image[seen].mean())
    np.testing.assert_allclose(asked, expected, rtol=1e-6)


def test_what_was_not_seen_counts_nothing(rng):
    a, b = rng.random((2, 3, 9, 11)).astype(np.float32)
    seen = rng.random((9, 11)) < 0.5
    expected = np.abs(a - b)[:, seen].mean(-1)
    a[:, ~seen] = np.nan
    np.testing.assert_allclose(distance(a, b, seen), expected, rtol=1e-6)
    np.testing.assert_allclose(jax.jit(distance)(a, b, seen), expected, rtol=1e-6)
    with pytest.raises(BadImage, match="no pixel was seen"):
        distance(a, b, np.zeros_like(seen))
