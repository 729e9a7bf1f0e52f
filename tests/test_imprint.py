"""f_P: the ground from above and back, the pressed tool, and fitting it to pairs."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from jshape import PAPER_BOX, Bank, fit, load_bank, load_pairs, save_bank
from jshape.data.pairs import Examples
from jshape.data.simulate import simulate_pairs, together
from jshape.errors import BadBank, BadCamera, BadDataset, JShapeError
from jshape.io.kinds import pack, unpack
from jshape.learn import imprint as learning
from jshape.learn.first_guess import Shown, mirrors
from jshape.learn.fit import fit as fit_bank
from jshape.learn.imprint import fit_imprint
from jshape.learn.scores import roi_errors_mm
from jshape.metric import roi_weight
from jshape.models.difference import fit_difference
from jshape.models.imprint import Imprint
from jshape.models.imprint_change import NO_HEAP
from jshape.models.orthographic import OrthographicGrid
from jshape.models.stretch import stretch
from jshape.planning import evaluate as sweep
from jshape.planning.state import search_state
from tests.reference import heap as slow
from tests.reference import orthographic as twin

CAMERA = PAPER_BOX
ROI = (36, 30)
GROUND = OrthographicGrid(CAMERA, jnp.float32(0.45), jnp.float32(0.0022), (14, 17), ROI)
MIDDLE, CORNER = np.array([222, 182], np.int32), np.array([420, 20], np.int32)


def hills(seed, shape=(30, 36), std=0.006, middle=0.447):
    rough = gaussian_filter(np.random.default_rng(seed).normal(size=shape), 6)
    return (middle + std * rough / rough.std()).astype(np.float32)


def tool(give=1.0, depth=0.012):
    """A round tool of 12 mm in the middle of the grid, with a rim."""
    rows, columns = GROUND.shape
    y, x = np.mgrid[:rows, :columns] - np.array([rows // 2, columns // 2])[:, None, None]
    far = np.hypot(x, y)
    inside = far < 5
    rim = np.where(inside, 0.0, -0.003 * np.exp(-((far - 6) ** 2) / 4))
    maps = {
        "reference": np.where(inside, 0.0, -20.0),
        "tool": np.where(inside, depth, -0.003),
        "give": give * inside,
        "rest": rim,
        "swell": rim,
        "follow": 0 * rim,
        "deep": 0 * rim,
        "stroke": depth,
    }
    return Imprint(GROUND, **{name: jnp.asarray(a, jnp.float32) for name, a in maps.items()})


def centre(hole):
    """(v, u) of the middle of what is lower."""
    low = np.maximum(hole, 0.0)
    return np.array([(low.sum(1 - k) * np.arange(low.shape[k])).sum() for k in (0, 1)]) / low.sum()


def image_of(depth, corner):
    """I of a ROI's depths (h, w), metres."""
    weight = roi_weight(CAMERA, jnp.asarray(corner), ROI)
    return (CAMERA.z_max - depth) / (CAMERA.z_max - CAMERA.z_min) * weight


def examples_of(predictor, count, seed=0, noise=0.0, std=0.006, strengths=None):
    rng = np.random.default_rng(seed)
    v, u = rng.integers(0, 360, count), rng.integers(0, 440, count)
    corner = np.stack([u, v], -1).astype(np.int32)
    prior = np.stack([
        np.asarray(image_of(hills(seed + 100 + k, std=std), corner[k])) for k in range(count)
    ])  # fmt: skip
    strength = np.ones(count, np.float32)
    if strengths is not None:
        strength = np.geomspace(*strengths, count).astype(np.float32)
    after = predictor(jnp.asarray(prior), jnp.asarray(corner), jnp.asarray(strength))
    posterior = np.clip(after, 0.0, 1.0)  # what lies beyond its range a camera does not see
    posterior = posterior + noise * rng.normal(size=posterior.shape).astype(np.float32)
    return Examples(prior, posterior.astype(np.float32), corner, strength)


def error(predictor, examples):
    parts = (examples.prior, examples.corner, examples.strengths)
    after = np.clip(predictor(*map(jnp.asarray, parts)), 0.0, 1.0)
    return float(np.abs(after - examples.posterior).mean())


@pytest.mark.full
@pytest.mark.parametrize("corner", [MIDDLE, CORNER], ids=["middle", "corner"])
def test_the_ground_equals_its_slow_twin(corner):
    depth = hills(1)
    above = GROUND.from_roi(jnp.asarray(depth), jnp.asarray(corner))
    np.testing.assert_allclose(above, twin.from_roi(GROUND, depth, corner), atol=2e-6)
    surface = hills(2, GROUND.shape)
    seen = GROUND.to_roi(jnp.asarray(surface)[None], jnp.asarray(corner))[0]
    np.testing.assert_allclose(seen, twin.to_roi(GROUND, surface, corner), atol=2e-6)


@pytest.mark.full
@pytest.mark.parametrize("corner", [MIDDLE, CORNER], ids=["middle", "corner"])
def test_a_level_plane_is_level_from_everywhere(corner):
    above = GROUND.from_roi(jnp.full((30, 36), 0.444, "f4"), jnp.asarray(corner))
    np.testing.assert_allclose(above, 0.444, atol=1e-6)


def test_the_middle_node_is_below_the_rois_middle_pixel():
    x, y = GROUND.nodes(jnp.asarray(CORNER))
    (w, h), (rows, columns) = ROI, GROUND.shape
    node = jnp.array([[x[columns // 2], y[rows // 2], GROUND.depth]])
    (v,), (u,) = np.nonzero(np.asarray(CAMERA.project(node)))
    assert (u, v) == (CORNER[0] + w // 2, CORNER[1] + h // 2)


def test_there_and_back_is_where_it_was():
    depth = hills(3)
    above = GROUND.from_roi(jnp.asarray(depth), jnp.asarray(CORNER))
    back = np.asarray(GROUND.to_roi(above[None], jnp.asarray(CORNER))[0])
    inner = np.s_[4:-4, 4:-4]  # at the edge the ground beyond the ROI is not known
    assert np.abs(back - depth)[inner].max() < 5e-4


@pytest.mark.full
def test_the_same_hole_looks_different_elsewhere_and_is_the_same_on_the_ground():
    rows, columns = GROUND.shape
    y, x = np.mgrid[:rows, :columns] - np.array([rows // 2, columns // 2])[:, None, None]
    # Without walls, behind which a camera sees nothing.
    hollow = jnp.asarray(0.015 * np.exp(-(x**2 + y**2) / 18), jnp.float32)
    none = jnp.zeros_like(hollow)
    hollow = replace(tool(0.0), tool=none, swell=none, rest=hollow)

    def of(corner):
        flat = jnp.asarray(image_of(jnp.full((30, 36), 0.45), corner))
        after = hollow(flat, jnp.asarray(corner))
        weight = roi_weight(CAMERA, jnp.asarray(corner), ROI)
        span = CAMERA.z_max - CAMERA.z_min
        hole = (flat - after) / weight * span
        return np.asarray(hole), np.asarray(GROUND.from_roi(0.45 + hole, jnp.asarray(corner)))

    (seen_a, ground_a), (seen_b, ground_b) = of(MIDDLE), of(CORNER)
    shift = np.abs(centre(seen_a) - centre(seen_b))  # pixels of 1 mm
    assert shift.min() > 1.0
    left = np.abs(centre(ground_a - 0.45) - centre(ground_b - 0.45)) * 2.2  # nodes to mm
    assert left.max() < 0.25 * shift.max()


def test_a_tool_levels_what_is_below_it():
    surfaces = jnp.asarray(np.stack([hills(k, GROUND.shape, std=0.003) for k in range(4)]))
    after = np.asarray(surfaces + tool().change(surfaces))
    inside = np.asarray(tool().give) > 0
    before = np.asarray(surfaces)
    for k in range(4):
        assert before[k][inside].std() > 5e-4
        assert after[k][inside].std() < 5e-5
        assert after[k][inside].mean() == pytest.approx(before[k][inside].mean() + 0.012, abs=1e-4)


def test_strength_lowers_the_tool():
    flat = jnp.full(GROUND.shape, 0.45)
    once, deeper, nothing = (np.asarray(tool().change(flat, s)) for s in (1.0, 2.5, 0.0))
    assert once.max() == pytest.approx(0.012, abs=1e-5)
    assert deeper.max() == pytest.approx(0.030, abs=1e-4)
    assert deeper.min() == pytest.approx(2.5 * once.min(), rel=0.05)  # rims hold what left
    assert nothing.max() < 1e-3
    np.testing.assert_allclose(tool().change(flat), once)


def test_what_is_beside_the_tool_grows_as_told():
    flat = jnp.full(GROUND.shape, 0.45)
    deep = jnp.full(GROUND.shape, -0.002)
    plain, heaping = tool(), replace(tool(), deep=deep)
    for strength, share in ((0.25, -0.75 * 0.25), (1.0, 0.0), (2.0, 1.0), (3.0, 2.0)):
        more = heaping.change(flat, strength) - plain.change(flat, strength)
        np.testing.assert_allclose(more, share * deep, atol=1e-7)
    farther = replace(tool(), stroke=jnp.float32(0.02))
    assert float(farther.change(flat, 2.0).max()) == pytest.approx(0.032, abs=1e-4)
    np.testing.assert_array_equal(farther.change(flat), plain.change(flat))


def handful(brought=0.6, flow=1.0):
    """A handful that is poured: a cone of 35 degrees, whose volume is given in metres·nodes."""
    rows, columns = GROUND.shape
    y, x = np.mgrid[:rows, :columns] - np.array([rows // 2, columns // 2])[:, None, None]
    away = np.hypot(x, y) * float(GROUND.pitch)
    none = jnp.zeros(GROUND.shape, jnp.float32)
    poured = replace(tool(0.0), rest=none, swell=none)
    height = jnp.asarray(NO_HEAP + 0.01 - 0.7 * away, jnp.float32)
    maps = {"rise": none + 1.0, "flow": none + flow, "share": jnp.float32(0.0)}
    return replace(poured, height=height, brought=jnp.float32(brought), **maps)


@pytest.mark.parametrize("strength", [0.3, 1.0, 2.0])
def test_a_heap_equals_its_slow_twin(strength):
    surface, poured = hills(9, GROUND.shape), handful()
    relief = surface - (np.asarray(poured.on_grid().weights) * surface).sum()
    raised = -np.asarray(poured.change(surface, strength))
    np.testing.assert_allclose(raised, slow.heaped(poured, relief, 0.6 * strength), atol=3e-5)
    assert raised.sum() == pytest.approx(0.6 * strength, rel=0.01)  # all that was brought
    traced = jax.jit(lambda surface: poured.change(surface, strength))(surface)
    np.testing.assert_allclose(traced, -raised, atol=1e-6)


def test_a_heap_fills_from_below_and_widens():
    surfaces = np.stack([hills(k, GROUND.shape, std=0.003) for k in range(3)])
    poured = handful()
    after = surfaces + np.asarray(poured.change(surfaces))
    buried = (surfaces - after > 4e-3).all(0)
    shapes = (after - after[:, buried].mean(1)[:, None, None])[:, buried]
    assert np.abs(shapes - shapes[0]).max() < 2e-4 < surfaces[:, buried].std()
    lying = surfaces + np.asarray(handful(flow=0.0).change(surfaces))
    np.testing.assert_allclose(lying - surfaces, (lying - surfaces)[:1].repeat(3, 0), atol=1e-6)
    level = np.full(GROUND.shape, 0.45, np.float32)
    once, twice = (-np.asarray(poured.change(level, x)) > 1e-3 for x in (1.0, 2.0))
    assert 1.2 * once.sum() < twice.sum() < 2.0 * once.sum()  # by 2 to the power of 2/3


def test_nothing_is_heaped_beyond_the_maps():
    frame = ((3, 2), (4, 5))
    inside = np.s_[3:-2, 4:-5]
    surface = np.pad(hills(9, GROUND.shape), frame, mode="edge")
    effect = replace(handful(), share=jnp.float32(0.5)).on_grid()
    padded = jax.tree.map(lambda a: np.pad(a, frame) if a.shape == GROUND.shape else a, effect)
    change = np.asarray(padded.change(surface))
    np.testing.assert_allclose(change[inside], effect.change(surface[inside]), atol=1e-6)
    change[inside] = 0.0
    assert np.abs(change).max() < 1e-9


def test_a_heap_turns_with_the_hand():
    aside = handful(0.1)
    aside = replace(aside, height=jnp.roll(aside.height, 3, 1))
    level = np.full((17, 17), 0.45, np.float32)
    ahead, turned = (-np.asarray(aside.turned(yaw).change(level)) for yaw in (0.0, np.pi / 2))
    np.testing.assert_allclose(turned, ahead.T, atol=2e-4)


def dragged(path=0.0176):
    """A tool that is dragged along 8 nodes, and a heap before it."""
    rows, columns = GROUND.shape
    y, x = np.mgrid[:rows, :columns] - np.array([rows // 2, columns // 2])[:, None, None]
    furrow = jnp.asarray((np.abs(x) <= 5) & (np.abs(y) <= 3), jnp.float32)
    away = np.hypot(x - 7, y) * float(GROUND.pitch)
    heap = replace(handful(0.0), height=jnp.asarray(NO_HEAP + 0.005 - 0.7 * away, jnp.float32))
    pulled = {"tool": jnp.where(furrow > 0, 0.01, -0.1), "give": furrow, "path": path}
    return replace(heap, reference=20.0 * (furrow - 1), share=jnp.float32(0.5), **pulled)


@pytest.mark.parametrize("length", [0.5, 1.0, 2.0])
def test_a_longer_path_keeps_its_ends(length):
    one, longer = dragged(), dragged().lengthened(length)
    assert longer.path_mm == pytest.approx(17.6 * length) and longer.directed and one.directed
    more = round(8 * (length - 1))  # nodes
    assert longer.grid.shape == (14, 17 + more + more % 2) and longer.roi[1] == ROI[1]
    pixels = 1e3 * (length - 1) * 0.0176 * float(CAMERA.fx) / 450
    assert -2e-3 <= longer.roi[0] - ROI[0] - pixels < 2 and longer.roi[0] % 2 == ROI[0] % 2
    ends, middle = np.array([-8, -5, -4, 4, 5, 7]), 17 // 2
    moved = ends + np.sign(ends) * (more // 2) + longer.grid.shape[1] // 2
    for name in ("tool", "give", "height", "rise", "flow"):
        old, new = (np.asarray(getattr(p, name)) for p in (one, longer))
        np.testing.assert_allclose(new[:, moved], old[:, ends + middle], atol=1e-6)
    assert float(longer.give.sum()) == float(one.give.sum()) + 7 * more
    # What the longer furrow displaces is heaped before it.
    for p in (one, longer):
        change = np.asarray(p.change(np.full(p.grid.shape, 0.45, np.float32)))
        cut = float(p.on_grid().volume[0, 0])
        assert change.sum() == pytest.approx(0.5 * cut, rel=0.05)  # the other half is packed
    assert cut == pytest.approx(7 * (11 + more) * 0.01, rel=0.02)


def test_a_longer_path_turns_with_the_hand():
    level = np.full((33, 33), 0.45, np.float32)
    longer = dragged().lengthened(3.0)
    ahead, turned = (np.asarray(longer.turned(yaw).change(level)) for yaw in (0.0, np.pi / 2))
    np.testing.assert_allclose(turned, ahead[::-1].T, atol=2e-4)


def test_the_slope_of_a_length_is_known():
    maps = jnp.asarray(dragged().give)

    def sum_of(length):
        return stretch(maps, length, 8.0, 40).sum()

    # A furrow of 7 rows becomes 4 nodes longer; its walls stay.
    assert float(sum_of(1.5) - sum_of(1.0)) == pytest.approx(7 * 4, abs=0.01)
    assert float(jax.jit(jax.grad(sum_of))(1.4)) == pytest.approx(7 * 8, rel=0.2)


def test_what_has_no_path_cannot_be_lengthened():
    assert (tool().path_mm, tool().directed, handful().directed) == (0.0, False, False)
    for one in (tool(), dragged().turned(0.3)):
        with pytest.raises(BadBank, match="no path along u"):
            one.lengthened(2.0)
    plain = fit_difference(np.ones((1, 2, 2)), np.ones((1, 2, 2)))
    assert (plain.path_mm, plain.directed) == (0.0, False)
    with pytest.raises(BadBank, match="Difference has no path"):
        plain.lengthened(2.0)
    for length in (0.0, -1.0, np.nan, 11.0):
        with pytest.raises(BadBank, match="length is .*; expected above 0, up to 10"):
            dragged().lengthened(length)


@pytest.mark.full
def test_a_longer_sweep_is_that_of_the_simulator():
    def pairs(seed, count, length):
        return together(
            simulate_pairs(
                jax.random.key(seed), count, actions=("sweep",), beds=("irregular",), noise=0.0,
                rois={"sweep": (246, 156)}, length=length,
            )
        )  # fmt: skip

    bank = fit_bank(pairs(0, 6, 1.0), "P")
    assert bank.predictor("sweep").path_mm == pytest.approx(85.0)
    longer, tested = bank.predictor("sweep").lengthened(1.5), pairs(1, 3, 1.5)
    errors = {}
    # Pairs that do not say their path are predicted along the predictor's own.
    tested = replace(tested, path_mm=np.zeros_like(tested.path_mm))
    for name, one in (("as trained", bank.predictor("sweep")), ("longer", longer)):
        error, change = roi_errors_mm(replace(bank, predictors=(one,)), tested, "sweep")
        errors[name] = error.mean() / change.mean()
    assert errors["longer"] < 0.4 < 0.6 < errors["as trained"]


def test_mirror_images_are_found():
    before = np.stack([hills(k, GROUND.shape) for k in range(6)])
    rng = np.random.default_rng(0)
    ones = np.ones(6, np.float32)

    def found(one, count=6):
        after = before + np.asarray(one.change(before)) + rng.normal(0, 1e-4, before.shape)
        seen = np.ones_like(before)
        return mirrors(Shown(before[:count], after[:count], seen[:count], ones[:count]))

    assert found(tool()) == (1.0, 1.0, 1.0)
    assert found(replace(tool(), give=jnp.roll(tool().give, 2, 1))) == (1.0, 0.0, 0.0)
    assert found(tool(), 3) == (0.0, 0.0, 0.0)  # too few to know
    # Two without the third are no symmetry: maps would be drawn to something else at every step.
    give, sums = tool().give, set()
    for share in np.linspace(0.0, 0.5, 26).tolist():
        aside = jnp.roll(give, 1, 0) + jnp.roll(give, 1, 1) - 2 * give
        sums.add(sum(found(replace(tool(), give=give + share * aside))))
    assert sums == {3.0, 1.0}


def test_many_strengths_of_one_ground():
    bent = replace(tool(), deep=tool().rest, follow=jnp.full(GROUND.shape, 0.1))
    surface = jnp.asarray(hills(9, GROUND.shape))
    strengths = jnp.array([0.2, 1.0, 2.0])
    together = bent.on_grid().change(surface, strengths)
    assert together.shape == (3, *GROUND.shape)
    for one, strength in zip(together, strengths, strict=True):
        np.testing.assert_allclose(one, bent.change(surface, strength), atol=1e-7)


def test_no_tool_changes_nothing():
    none = jax.tree.map(jnp.zeros_like, tool())
    none = replace(none, grid=GROUND)
    roi = image_of(hills(4), CORNER)
    np.testing.assert_array_equal(none(roi, jnp.asarray(CORNER)), roi)


@pytest.mark.full
def test_a_batch_is_its_members():
    examples = examples_of(tool(), 3)
    strength = jnp.array([0.5, 1.0, 2.0])
    together = tool()(jnp.asarray(examples.prior), jnp.asarray(examples.corner), strength)
    for k in range(3):
        alone = tool()(jnp.asarray(examples.prior[k]), jnp.asarray(examples.corner[k]), strength[k])
        # Where a ray grazes a wall, rounding moves the point that it meets.
        np.testing.assert_allclose(together[k], alone, atol=5e-5)


@pytest.mark.full
def test_the_sweep_uses_the_place():
    shallow = tool(depth=0.005)  # and without a rim: walls hide nothing of the hole
    shallow = replace(shallow, rest=0 * shallow.rest, swell=0 * shallow.swell)
    bank = Bank(CAMERA, (shallow,), ("poke",), "P")
    image = np.asarray(jnp.full(CAMERA.shape, 0.4) * 0.95)
    image = image + 0.02 * gaussian_filter(np.random.default_rng(5).normal(size=CAMERA.shape), 5)
    image = jnp.asarray(image, jnp.float32)
    goal = image - 0.35
    centres = np.array([[240, 197], [30, 40], [440, 360]], np.int32)
    state = search_state(bank, image, goal)
    found = sweep.sweep(state, sweep.candidates_at(state, bank, {"poke": centres}))[0][:, 0]
    for k, (u, v) in enumerate(centres):
        window = np.s_[v - 15 : v + 15, u - 18 : u + 18]
        after = np.array(image)
        after[window] = bank.predict("poke", image[window], position=(u, v))
        change = np.abs(after - goal).mean() - np.abs(image - goal).mean()
        # The ground's edges fall between nodes; near the image's edge each counts 15 % more.
        assert float(found[k]) == pytest.approx(float(change), rel=0.05)
    assert float(found[1]) < 1.1 * float(found[0]) < 0


@pytest.fixture(scope="module")
def training():
    """Pairs of one strength."""
    return examples_of(tool(), 24, seed=1, noise=0.002)


@pytest.fixture(scope="module")
def known(training):
    """What is fitted to them."""
    return fit_imprint(training, CAMERA)


@pytest.mark.full
def test_fitting_finds_the_tool(training, known):
    testing = examples_of(tool(), 6, seed=2)
    difference = fit_difference(training.prior, training.posterior)
    assert error(known, testing) < 0.35 * error(difference, testing)
    assert float(known.grid.depth) == pytest.approx(0.45, abs=0.003)


@pytest.mark.full
def test_a_fit_depends_on_the_seed_alone(training, monkeypatch):
    monkeypatch.setattr(learning, "STEPS", (20, 20))
    monkeypatch.setattr(learning, "PER_MANY", 0)
    fitted, same, other = (fit_imprint(training, CAMERA, seed=seed) for seed in (0, 0, 1))
    for name in learning.fitted(fitted):
        np.testing.assert_array_equal(getattr(fitted, name), getattr(same, name))
    assert not np.array_equal(fitted.tool, other.tool)


def by_strength():
    """A tool of which deeper strokes do more than go deeper."""
    return replace(tool(), deep=1.5 * tool().rest, stroke=jnp.float32(0.017))


@pytest.fixture(scope="module")
def varied():
    """What is fitted to pairs of all strengths."""
    training = examples_of(by_strength(), 24, seed=1, strengths=(0.2, 2.0), noise=0.001)
    assert (training.posterior <= 0.005).any()  # deeper than the camera can see
    return fit_imprint(training, CAMERA)


@pytest.mark.full
def test_fitting_finds_how_strength_acts(varied):
    true, fitted = by_strength(), varied
    once = fit_imprint(examples_of(true, 24, seed=1, noise=0.001), CAMERA)
    assert float(once.stroke) == float(once.deepest)  # one strength says nothing about others
    np.testing.assert_array_equal(once.deep, 0.0)
    for strength in (0.3, 2.0):
        testing = examples_of(true, 6, seed=2, strengths=(strength, strength))
        assert error(fitted, testing) < 0.7 * error(once, testing)


@pytest.mark.full
def test_adapting_with_pairs_of_any_strength(varied):
    other = replace(by_strength(), rest=1.5 * tool().rest)
    few = examples_of(other, 6, seed=5, strengths=(0.3, 0.6))
    testing = examples_of(other, 6, seed=6, strengths=(0.3, 0.6))
    assert error(fit_imprint(few, CAMERA, varied), testing) < error(varied, testing)


@pytest.mark.full
def test_what_the_camera_cannot_see_is_not_learned():
    deeper = tool(depth=0.03)  # 0.47 m is the end of the camera's range, 23 mm below the ground
    fitted = fit_imprint(examples_of(deeper, 6, seed=1), CAMERA)
    flat = jnp.full(fitted.grid.shape, 0.45)
    assert float(fitted.change(flat).max()) > 0.025  # 0.024 if the end of the range were ground


@pytest.mark.full
def test_few_pairs_do_better_from_a_bank(known):
    deeper = tool(depth=0.014)
    few, testing = examples_of(deeper, 6, seed=5), examples_of(deeper, 6, seed=6)
    adapted = error(fit_imprint(few, CAMERA, known), testing)
    assert adapted < error(known, testing)
    assert adapted < error(fit_imprint(few, CAMERA), testing)


@pytest.mark.full
def test_pixels_without_a_reading_do_not_count():
    whole = examples_of(tool(), 6, seed=1)
    prior, posterior = whole.prior.copy(), whole.posterior.copy()
    corners = np.ix_(range(1, 6), [*range(6), *range(-6, 0)], [*range(6), *range(-6, 0)])
    posterior[corners] = 0.9  # nonsense in the corners of all pairs but one ...
    holed = posterior.copy()
    holed[corners] = np.nan  # ... and the same corners without readings
    clean = fit_imprint(whole, CAMERA)
    with_hole = fit_imprint(Examples(prior, holed, whole.corner), CAMERA)
    with_nonsense = fit_imprint(Examples(prior, posterior, whole.corner), CAMERA)
    gap = np.abs(np.asarray(with_hole.rest - clean.rest))[:3, :3].max()
    assert gap < 0.1 * np.abs(np.asarray(with_nonsense.rest - clean.rest))[:3, :3].max()


@pytest.mark.full
def test_what_cannot_be_fitted_is_refused():
    examples = examples_of(tool(), 3)
    with pytest.raises(BadDataset, match="no pairs"):
        fit_imprint(examples.select(np.arange(0)), CAMERA)
    blind = Examples(examples.prior, np.full_like(examples.posterior, np.nan), examples.corner)
    with pytest.raises(BadDataset, match="pair 1 of 3 has no pixel"):
        fit_imprint(blind, CAMERA)


@pytest.mark.full
def test_one_flat_pair_is_repeated():
    one = examples_of(tool(), 1, std=0.0001)
    assert error(fit_imprint(one, CAMERA), one) < 0.2 * np.abs(one.posterior - one.prior).mean()


def test_more_pairs_are_gone_over_more_often():
    least, most = learning.STEPS
    assert least < learning.PER_PAIR * 24 < most  # what the tests above fit with


@pytest.mark.full
def test_saved_and_loaded_is_the_same(tmp_path):
    bank = Bank(CAMERA, (tool(), handful(), dragged()), ("poke", "pour", "sweep"), "P")
    found = load_bank(save_bank(bank, tmp_path / "bank"))
    assert [one.path_mm for one in found.predictors] == [0.0, 0.0, 17.6]
    assert found.kind == "P" and found.rois == bank.rois
    roi = image_of(hills(7), CORNER)
    for name in bank.actions:
        position = (CORNER[0] + 18, CORNER[1] + 15)
        np.testing.assert_array_equal(
            found.predict(name, roi, position=position), bank.predict(name, roi, position=position)
        )


def test_damaged_arrays_are_refused():
    arrays = pack(replace(tool(), deep=tool().rest, stroke=jnp.float32(0.02)), "P")
    for broken in (
        {"deep": np.zeros((2, 2))},
        {"stroke": np.array(np.nan, np.float32)},
        {"path": np.array(-1)},
    ):
        with pytest.raises(BadBank):
            unpack("P", arrays | broken, ROI, CAMERA)


@pytest.mark.full
def test_another_camera_uses_the_same_bank():
    bank = Bank(CAMERA, (tool(),), ("poke",), "P")
    finer = replace(CAMERA, width=960, height=790, fx=866.0, fy=866.0, u0=480.0, v0=394.0)
    farther = replace(finer, z_min=0.52, z_max=0.57)
    other = bank.seen_by(farther, 0.55)
    assert other.roi("poke") == (round(36 * 2 * 0.45 / 0.55), round(30 * 2 * 0.45 / 0.55))
    w, h = other.roi("poke")
    flat = jnp.full((h, w), 0.4) * roi_weight(farther, jnp.array([450, 370]), (w, h))
    after = other.predict("poke", flat, position=(450 + w // 2, 370 + h // 2))
    change = np.asarray(flat - after) / np.asarray(flat) * 0.4 * 0.05
    assert change.max() == pytest.approx(0.012, abs=2e-4)
    # As wide on the ground as it is below the bank's own camera.
    area = (change > 0.006).sum() * (0.55 / 866) ** 2
    own = jnp.full(ROI[::-1], 0.4) * roi_weight(CAMERA, jnp.asarray(MIDDLE), ROI)
    hole = own - bank.predict("poke", own, position=MIDDLE + (18, 15))
    share = np.asarray(hole / own) * 0.4 * 0.05
    assert area == pytest.approx((share > 0.006).sum() * (0.45 / 433) ** 2, rel=0.1)
    with pytest.raises(BadCamera, match="depth 0.6"):
        bank.seen_by(farther, 0.6)
    bound = replace(bank, predictors=(fit_difference(np.ones((1, 2, 2)), np.ones((1, 2, 2))),))
    with pytest.raises(BadBank, match="bound to its camera"):
        bound.seen_by(farther, 0.55)


@pytest.mark.full
def test_no_strength_changes_nothing():
    surfaces = jnp.asarray(np.stack([hills(k, GROUND.shape) for k in range(2)]))
    bent = replace(tool(), follow=jnp.full(GROUND.shape, 0.1), swell=jnp.full(GROUND.shape, 0.002))
    np.testing.assert_array_equal(bent.change(surfaces, 0.0), 0.0)


@pytest.mark.full
@pytest.mark.parametrize(
    ("what", "words"),
    [
        ({"position": (np.nan, 1)}, "leaves the 480x395 image"),
        ({"position": (-500, 900)}, "leaves the 480x395 image"),
        ({"position": (1, 2, 3)}, "expected"),
        ({"strength": np.nan}, "must be a number from 0"),
        ({"strength": -1.0}, "must be a number from 0"),
        ({"strength": "x"}, "must be a number from 0"),
        ({"position": np.full((3, 2), 100)}, None),
        ({"position": np.full((3, 2), 100), "strength": np.ones(2)}, "do not fit together"),
        ({"roi": np.full((30, 36), 7.0)}, "values from 7 to 7"),
        ({"roi": np.full((30, 36), 100, np.uint8)}, "type uint8"),
    ],
)
def test_what_cannot_be_predicted_is_refused(what, words):
    bank = Bank(CAMERA, (tool(),), ("poke",), "P")
    options = dict(what)
    roi = options.pop("roi", np.full((30, 36), 0.4, np.float32))
    if words is None:
        assert bank.predict("poke", roi, **options).shape == (3, 30, 36)
        return
    with pytest.raises(JShapeError, match=words):
        bank.predict("poke", roi, **options)


@pytest.mark.full
def test_pixels_that_no_pair_has_seen_are_refused():
    examples = examples_of(tool(), 3)
    prior = examples.prior.copy()
    prior[:, :, :5] = np.nan
    with pytest.raises(BadDataset, match="150 of 1080 ROI pixels have no depth reading"):
        fit_imprint(Examples(prior, examples.posterior, examples.corner), CAMERA)


@pytest.mark.full
def test_a_handful_that_is_poured_is_a_heap(shared_data):
    """It lowers nothing: a tool that displaces next to nothing was 14.7 mm off, f_D 2.4."""
    pairs = load_pairs(shared_data / "mpm/carry/pairs/irregular_flour_robot").of(action="pour")
    bank = fit(pairs, "P")
    np.testing.assert_array_equal(bank.predictor("pour").give, 0.0)
    assert bank.errors_mm[0] < 1.0
    error, change = roi_errors_mm(bank, pairs, "pour")
    assert error.mean() < 0.15 * change.mean()
