"""The parts `unet` and `simulator` of the benchmarks: equal twins, true counts, and their rows."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks import simulator, unet, unet_peers
from benchmarks.report import Report
from jshape.models import unet as ours
from jshape.sim import CELL, SIZE
from tests.reference import unet as plain


def network(width=2):
    """Parameters with biases, so that every layer matters."""
    rng = np.random.default_rng(5)
    params = ours.init(jax.random.key(0), width)
    return jax.tree.map(lambda x: x + 0.03 * rng.normal(size=x.shape).astype(np.float32), params)


def images(rng, shape):
    return rng.random(shape).astype(np.float32)


def test_pytorchs_network_is_the_papers_in_values_and_gradients(rng):
    torch = pytest.importorskip("torch")
    params, image, goal = network(), images(rng, (2, 20, 33)), images(rng, (2, 20, 33))
    apply, leaves = unet_peers.torch_network(params, torch)
    after = apply(torch.from_numpy(image))
    expected = plain.apply(params, jnp.asarray(image))
    assert np.ptp(expected) > 0.01
    np.testing.assert_allclose(after.detach().numpy(), expected, atol=5e-6)

    (after - torch.from_numpy(goal)).square().mean().backward()
    slope = jax.grad(lambda p: ((plain.apply(p, jnp.asarray(image)) - goal) ** 2).mean())(params)
    theirs = [leaf.grad.numpy() for leaf in leaves]
    assert unet._gradient_gap(jax.tree.leaves(slope), theirs) < 2e-5
    theirs[3] = 1.01 * theirs[3]
    assert unet._gradient_gap(jax.tree.leaves(slope), theirs) > 5e-3


def test_pytorch_trains_a_copy_of_the_parameters():
    torch = pytest.importorskip("torch")
    params = network()
    before = jax.tree.map(np.array, params)
    with torch.no_grad():
        for leaf in unet_peers.torch_network(params, torch)[1]:
            leaf += 1
    assert jax.tree.all(jax.tree.map(lambda a, b: bool((a == b).all()), params, before))


@pytest.mark.parametrize("shape", [(1, 16, 32), (2, 20, 33)])
def test_onnx_runtimes_network_is_the_papers(rng, shape):
    pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    params, image = network(), images(rng, shape)
    after = unet_peers.onnx_network(params, shape, 1)(image)
    np.testing.assert_allclose(after, plain.apply(params, jnp.asarray(image)), atol=5e-6)


def products(program):
    """Multiplications and additions of the convolutions in a program, from its shapes."""
    total = 0
    for equation in program.eqns:
        for inner in jax.tree.leaves(
            list(equation.params.values()), is_leaf=lambda x: hasattr(x, "jaxpr")
        ):
            if hasattr(inner, "jaxpr"):
                total += products(inner.jaxpr)
        if equation.primitive.name == "conv_general_dilated":
            numbers = equation.params["dimension_numbers"]
            kernel = equation.invars[1].aval
            each = kernel.size / kernel.shape[numbers.rhs_spec[0]]
            total += 2 * equation.outvars[0].aval.size * each
    return total


@pytest.mark.full
@pytest.mark.parametrize("shape", [(1, 16, 16), (3, 45, 40)])
def test_the_drawn_network_is_counted(shape):
    params, image = network(3), jnp.zeros(shape)
    forward = jax.make_jaxpr(plain.apply)(params, image)
    assert unet.drawn_flops(shape, 3) == products(forward.jaxpr)
    step = jax.make_jaxpr(jax.grad(lambda p: plain.apply(p, image).sum()))(params)
    assert unet.drawn_flops(shape, 3, train=True) == products(step.jaxpr)


@pytest.fixture
def small(monkeypatch):
    """The part at a size of seconds."""
    monkeypatch.setattr(unet, "WIDTH", 2)
    monkeypatch.setattr(unet, "PRODUCT", 32)
    monkeypatch.setattr(unet, "FORWARD", ((1, 17, 20),))
    monkeypatch.setattr(unet, "TRAINED", ((8, 17, 20),))
    monkeypatch.setattr(unet, "PAPER_ROIS", {"poke": (20, 17)})


@pytest.mark.slow
def test_peers_that_are_not_installed_are_left_out_with_a_line(
    small, monkeypatch, tmp_path, capsys
):
    missing = {"PyTorch": ("no_such_package",), "ONNX Runtime": ("onnx", "nor_this")}
    monkeypatch.setattr(unet, "PEERS", missing)
    report = Report("unet")
    unet.run(report, tmp_path)
    said = capsys.readouterr().out
    assert "PyTorch: left out, no_such_package must be installed" in said
    assert "ONNX Runtime: left out, onnx and nor_this must be installed" in said
    names = [row.name for row in report.rows]
    assert not any("jshape / " in name or "difference" in name for name in names)
    assert "training, poke 20x17: epoch of 56 pairs" in names
    assert [table.name for table in report.tables] == [
        "U-Net of width 2, forward", "U-Net of width 2, training step"
    ]  # fmt: skip
    assert (tmp_path / "unet.png").read_bytes().startswith(b"\x89PNG")


def test_with_peers_the_rows_hold_ratios_and_differences(small, tmp_path):
    for package in sum(unet.PEERS.values(), ()):
        pytest.importorskip(package)
    report = Report("unet")
    unet.run(report, tmp_path)
    rows = {row.name: row for row in report.rows}
    assert rows["forward 1x 17x20: jshape / PyTorch"].goal == unet.GOAL
    assert rows["forward 1x 17x20: jshape / ONNX Runtime"].goal is None
    assert rows["training step 8x 17x20: jshape / PyTorch"].value > 0
    for what in ("forward", "training step"):
        gap = rows[f"{what}: largest difference"]
        assert gap.met and gap.tolerance and 0 < gap.value


@pytest.mark.parametrize("gap", [2e-4, float("nan")])
def test_networks_that_differ_are_not_compared(gap):
    with pytest.raises(AssertionError, match="differ by"):
        unet._agreeing((1, 16, 16), {"jshape": 1.0}, 1.0, 1.0, 2.0, [0.0, gap], unet.AGREE)


@pytest.mark.slow
def test_the_simulators_rows(monkeypatch, tmp_path):
    monkeypatch.setattr(simulator, "BATCHES", (1, 2))
    report = Report("simulator")
    with jax.debug_key_reuse(False):  # a benchmark repeats itself
        simulator.run(report, tmp_path)
    rows = {row.name: row for row in report.rows}
    cells = round(SIZE[0] / CELL) * round(SIZE[1] / CELL)
    assert rows["memory of a bed"].value == pytest.approx(2 * 4 * cells / 1e3)
    assert rows["memory of a bed"].tolerance == 1
    held = 4 * cells / 1e6  # working memory holds at least a padded height map of each bed
    assert rows["working memory per bed, 2 at a time"].value > held
    for name in ("beds per second, 1 at a time", "beds per second, 2 at a time"):
        assert np.isfinite(rows[name].value) and rows[name].value > 0
