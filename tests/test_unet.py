"""The U-Net: the paper's size, and equal to its plain twin in values and gradients."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jshape.models import unet
from jshape.models.convolution import conv3x3
from tests.reference import unet as plain


def images(rng, shape):
    return jnp.asarray(rng.random(shape), jnp.float32)


def strong(params):
    """Parameters with biases and a wide output, so that every layer matters."""
    rng = np.random.default_rng(5)
    return jax.tree.map(lambda x: x + 0.03 * rng.normal(size=x.shape).astype(np.float32), params)


def test_the_papers_network_has_785_million_parameters():
    leaves = jax.tree.leaves(unet.shapes(32))
    assert sum(leaf.size for leaf in leaves) == 7_846_081
    sizes = [unet.shapes(32)[p]["second"]["kernel"].shape for p in ("bottom",)]
    assert sizes == [(3, 3, 512, 512)]
    assert [unet.shapes(32)["up"][k]["first"]["kernel"].shape[2:] for k in range(4)] == [
        (768, 256), (384, 128), (192, 64), (96, 32)
    ]  # fmt: skip


@pytest.mark.full
@pytest.mark.parametrize("width, size", [(8, (45, 40)), (4, (17, 50)), (2, (1, 3))])
def test_it_equals_the_plain_network(rng, width, size):
    params = strong(unet.init(jax.random.key(1), width))
    image = images(rng, (2, *size))
    expected = plain.apply(params, image)
    assert np.ptp(expected) > 0.001
    np.testing.assert_allclose(jax.jit(unet.apply)(params, image), expected, atol=5e-6)


@pytest.mark.slow
def test_it_equals_the_plain_network_at_the_papers_width(rng):
    params = unet.init(jax.random.key(2), 32)
    image = images(rng, (1, 60, 112))
    np.testing.assert_allclose(
        jax.jit(unet.apply)(params, image), plain.apply(params, image), atol=5e-6
    )


@pytest.mark.full
def test_its_gradient_is_the_plain_networks(rng):
    params = strong(unet.init(jax.random.key(3), 4))
    image, goal = images(rng, (2, 20, 33)), images(rng, (2, 20, 33))

    def slope(apply):
        return jax.jit(jax.grad(lambda p: ((apply(p, image) - goal) ** 2).mean()))(params)

    found, expected = slope(unet.apply), slope(plain.apply)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(a, b, atol=2e-5 * max(1.0, float(jnp.abs(b).max())))


# Blocks of one image, of three, a number that only 1 divides, and a side of one pixel.
@pytest.mark.full
@pytest.mark.parametrize("shape", [(3, 50, 44), (6, 20, 24), (7, 20, 24), (2, 1, 200)])
def test_the_gradient_of_a_convolution_is_the_plain_ones(rng, shape):
    x, kernel = images(rng, (*shape, 3)), jnp.asarray(rng.normal(size=(3, 3, 3, 5)), jnp.float32)
    weight = jnp.asarray(rng.normal(size=(*shape, 5)), jnp.float32)

    def slopes(convolve):
        return jax.jit(jax.grad(lambda x, k: (convolve(x, k) * weight).sum(), (0, 1)))(x, kernel)

    def convolve(x, kernel):
        return plain.convolution({"kernel": kernel, "bias": 0.0}, x)

    for found, expected in zip(slopes(conv3x3), slopes(convolve), strict=True):
        assert float(jnp.abs(expected).max()) > 1
        np.testing.assert_allclose(found, expected, atol=3e-6 * float(jnp.abs(expected).max()))


@pytest.mark.full
@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_leading_axes_are_a_batch(rng, batch):
    params = unet.init(jax.random.key(0), 2)
    image, one = images(rng, (*batch, 18, 20)), jax.jit(unet.apply)
    found = one(params, image)
    assert found.shape == image.shape
    for index in np.ndindex(batch):
        np.testing.assert_allclose(found[index], one(params, image[index]), atol=1e-6)


@pytest.mark.full
def test_it_runs_under_vmap_and_in_loops(rng):
    params, image = unet.init(jax.random.key(0), 2), images(rng, (3, 16, 20))
    one_by_one = jax.jit(unet.apply)(params, image)
    np.testing.assert_allclose(
        jax.jit(jax.vmap(lambda x: unet.apply(params, x)))(image), one_by_one, atol=1e-6
    )
    looped = jax.lax.fori_loop(
        0, 3, lambda k, out: out.at[k].set(unet.apply(params, image[k])), jnp.zeros_like(image)
    )
    np.testing.assert_allclose(looped, one_by_one, atol=1e-6)


@pytest.mark.full
def test_the_seed_is_all_that_a_fresh_network_depends_on():
    a, b, c = (unet.init(jax.random.key(k), 2) for k in (0, 0, 1))
    assert jax.tree.all(jax.tree.map(lambda x, y: bool((x == y).all()), a, b))
    assert not (a["output"]["kernel"] == c["output"]["kernel"]).all()
    assert jax.tree.map(jnp.shape, a) == jax.tree.map(lambda x: x.shape, unet.shapes(2))
