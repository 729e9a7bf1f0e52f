"""Actions that move material: nothing is lost, it ends where a hand brings it, and heaps stand."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks import moving_against_mpm, sim_against_mpm
from jshape import sim
from jshape.data.simulate import ALL_ROIS, ROIS, simulate_pairs, together
from jshape.errors import JShapeError, UnknownName
from jshape.learn import validation
from jshape.learn.fit import fit
from jshape.sim import ACTIONS, FLOUR, MATERIALS, MOVING, apply_action, flat_bed

KEPT = replace(FLOUR, compressibility=0.0, bulk=1.0)
"""Flour that neither packs nor comes out looser than it was."""
BOX = dict(size=(0.32, 0.3), cell=0.005)
"""A small box of coarse cells, so that all tests here share one quick kernel."""


def key(seed=0):
    return jax.random.key(seed)


def irregular(seed=1):
    return sim.irregular_bed(key(seed), std=0.008, **BOX)


def done(action, bed=None, material=FLOUR, xy=(0.0, 0.0), **options):
    bed = flat_bed(**BOX) if bed is None else bed
    after = apply_action(key(), bed, material, action, xy, spread=0.0, **options)
    return after, np.asarray(after.height - bed.height) * 1000.0


def litres(field, bed):
    """A field's volume in cm³, summed in float64."""
    return float(np.asarray(field, np.float64).sum() * bed.cell**2 * 1e6)


# --- What is conserved --------------------------------------------------------------------------


def test_a_stroke_that_is_cut_ends_on_its_way():
    """A sweep goes down first, a scoop is on its way from the start: x and z in mm."""
    for action, share, x, z in (
        ("sweep", 0.0, -40.0, -8.6), ("sweep", 0.4, -6.0, -8.6), ("sweep", 1.0, 45.0, -8.6),
        ("scoop", 0.0, -63.9, 0.0), ("scoop", 0.5, -23.55, -8.028), ("scoop", 2.0, 16.8, -11.8),
        ("poke", 0.3, 0.0, -19.8),
    ):  # fmt: skip
        whole = sim.stroke(action)
        ended = sim.cut(whole, share)
        np.testing.assert_allclose(1000 * sim.way(ended)[-1], (x, 0.0), atol=1e-3)
        assert 1000 * float(ended.path[-1, 0, 0, 2]) == pytest.approx(z, abs=1e-2)
        gone = np.linspace(0, float(ended.times[-1]), 9)  # the same way until then
        for moment in gone:
            one, other = (
                np.interp(moment, s.times, np.asarray(s.path[:, 0, 0, 0])) for s in (whole, ended)
            )
            assert one == pytest.approx(other, abs=1e-6)


@pytest.mark.parametrize("action", MOVING)
@pytest.mark.parametrize("bed", [flat_bed(**BOX), irregular()], ids=["flat", "irregular"])
@pytest.mark.parametrize("material", [KEPT, *MATERIALS.values()], ids=["kept", *MATERIALS])
def test_what_leaves_the_bed_is_in_the_stock(action, bed, material):
    after = apply_action(key(2), bed, material, (action, "human"), (0.02, -0.03))
    moved = litres(np.abs(after.height - bed.height), bed)
    assert moved > 20.0
    stock = float(after.stock) * 1e6
    assert (stock > 10.0, stock < -10.0, stock == 0.0)[["scoop", "pour", "sweep"].index(action)]
    # Of some 60 cm³ that move 0.002 are float32's rounding in 4000 cells.
    assert abs(litres(after.mass, bed) + stock - litres(bed.mass, bed)) < 2e-3
    if material is KEPT:
        assert abs(litres(after.height, bed) + stock - litres(bed.height, bed)) < 2e-3
    assert np.asarray(after.height).min() >= 0.0
    assert np.asarray(after.packing).max() < material.packing_max + 1e-3


def test_nothing_is_lost_at_a_wall():
    bed = flat_bed(**BOX)
    for action in MOVING:
        after, _ = done(action, bed, KEPT, (0.16, 0.1))
        kept = litres(after.height, bed) + float(after.stock) * 1e6
        assert kept == pytest.approx(litres(bed.height, bed), abs=2e-3)


@pytest.mark.full
def test_a_pour_outside_the_box_gives_nothing():
    bed = flat_bed(**BOX)
    after = jax.jit(lambda xy: apply_action(key(), bed, KEPT, "pour", xy))((0.5, 0.0))
    np.testing.assert_array_equal(after.height, bed.height)
    assert after.stock == 0.0


def test_the_stock_adds_up_over_actions():
    bed = flat_bed(**BOX)
    scooped, _ = done("scoop", bed, xy=(-0.08, 0.0))
    both, _ = done("pour", scooped, xy=(0.08, 0.0), strength=float(scooped.stock) / 50e-6)
    assert float(scooped.stock) > 30e-6 and abs(float(both.stock)) < 1e-9
    assert litres(both.mass, bed) == pytest.approx(litres(bed.mass, bed), abs=4e-3)


# --- What an action makes -----------------------------------------------------------------------


def test_a_sweep_leaves_a_furrow_and_a_heap_before_it():
    bed = flat_bed(**BOX)
    _, rise = done("sweep", bed)
    x, y = (np.asarray(axis) for axis in bed.axes())
    row = rise[np.abs(y) < 0.02].mean(0)
    assert row[np.abs(x) < 0.03].max() < -6.0
    assert 8.0 < row[(x > 0.06) & (x < 0.1)].max() < 20.0
    assert row[x < -0.07].max() < 2.0
    _, short = done("sweep", bed, length=0.5)
    _, turned = done("sweep", bed, yaw=np.pi / 2)
    furrow, shorter = ((a[np.abs(y) < 0.02].mean(0) < -4.0).sum() * 5.0 for a in (rise, short))
    assert furrow - shorter == pytest.approx(40.0, abs=5.0)
    middle = slice(2, -2)  # a box that is as wide as long
    np.testing.assert_allclose(turned.T[middle], rise[:, middle], atol=1.0)


def test_a_poured_handful_is_looser_and_stands_at_its_angle_of_repose():
    bed = flat_bed(**BOX)
    for strength in (0.5, 1.0, 2.0):
        after, rise = done("pour", bed, strength=strength)
        assert litres(rise / 1000.0, bed) == pytest.approx(58.0 * strength, rel=1e-3)
        assert rise.min() > -0.01 and rise.max() == pytest.approx(19.0 * np.cbrt(strength), rel=0.1)
        steep = np.abs(np.diff(np.asarray(after.height), axis=0)).max() / bed.cell
        assert steep < 1.05 * np.tan(FLOUR.repose)


def test_a_heap_slides_off_a_wall_that_stays():
    """Only what was poured slides: the wall below it is steeper than the angle of repose."""
    x, _ = flat_bed(**BOX).axes()
    wall = sim.loose_bed(jnp.where(x > 0, 0.04, 0.02)[None] * jnp.ones((60, 1)), BOX["cell"])
    after, rise = done("pour", wall, xy=(0.005, 0.0))
    assert rise.min() > -1e-3
    assert rise[:, np.asarray(x) < -0.02].max() > 2.0


def test_a_deeper_scoop_takes_more():
    taken = [float(done("scoop", strength=s)[0].stock) * 1e6 for s in (0.5, 1.0, 2.0)]
    assert 10.0 < taken[0] < 25.0 and 38.0 < taken[1] < 50.0 and 80.0 < taken[2] < 110.0


# --- Compiling, batching, asking ----------------------------------------------------------------


@pytest.mark.full
def test_batch_equals_loop():
    keys = jax.random.split(key(3), 2)
    beds = jax.vmap(lambda k: sim.irregular_bed(k, 0.006, **BOX))(keys)
    places = jnp.array([[0.0, 0.02], [0.05, -0.04]])
    strengths, lengths = jnp.array([0.7, 1.4]), jnp.array([0.6, 1.5])

    def act(stroke, bed, xy, strength, length):
        return apply_action(key(4), bed, FLOUR, stroke, xy, strength, length=length)

    batch = jax.jit(jax.vmap(act, (None, 0, 0, 0, 0)))
    for action in MOVING:
        many = batch(sim.stroke(action), beds, places, strengths, lengths)
        assert many.stock.shape == (2,)
        for n in range(2):
            bed = jax.tree.map(lambda a, n=n: a[n], beds)
            alone = act(sim.stroke(action), bed, places[n], strengths[n], lengths[n])
            np.testing.assert_allclose(many.height[n], alone.height, atol=2e-6)
            np.testing.assert_allclose(many.stock[n], alone.stock, atol=1e-9)


@pytest.mark.full
def test_one_more_kernel_serves_all_that_move(monkeypatch):
    traces = []
    genuine = sim.act.repetition
    monkeypatch.setattr(sim.act, "repetition", lambda *a: traces.append(1) or genuine(*a))
    bed = flat_bed(size=(0.1, 0.12), cell=0.01)  # a size that no other test compiles for
    for action in MOVING:
        for agent in sim.AGENTS:
            apply_action(key(), bed, "sand", (action, agent), (0.01, 0.0), 1.5, length=0.5)
    assert len(traces) == 1


def test_the_five_actions_press_and_are_the_default():
    assert ACTIONS == tuple(ROIS) == ("grasp", "knock", "press", "pinch", "poke")
    assert all(sim.stroke(name, agent).load is None for name in ACTIONS for agent in sim.AGENTS)
    # What they did before any action moved material: sum of |change| in cm³, deepest in mm.
    moved, deepest = np.transpose([
        (litres(np.abs(rise) / 1000.0, flat_bed(**BOX)), rise.min())
        for rise in (done(name)[1] for name in ACTIONS)
    ])  # fmt: skip
    np.testing.assert_allclose(moved, [128.7326, 109.4569, 66.1478, 39.4532, 7.9044], rtol=2e-5)
    np.testing.assert_allclose(
        deepest, [-24.5253, -16.3957, -17.3685, -20.6143, -18.6563], rtol=2e-5
    )
    assert sim.actions_of("robot") == (*ACTIONS, *MOVING) == tuple(ALL_ROIS)
    assert {pair.action for pair in simulate_pairs(key(), 0)} == set()
    with pytest.raises(UnknownName, match="unknown action 'swep'.*did you mean sweep"):
        sim.stroke("swep")
    with pytest.raises(JShapeError, match="length is 0.0; it must be one finite number above 0"):
        done("sweep", length=0.0)


@pytest.mark.full
def test_pairs_of_moving_actions_are_made_and_fitted():
    made = simulate_pairs(key(5), 3, actions=MOVING, strengths=(0.5, 2.0))
    pairs = together(made)
    assert len(set(pairs.strength.tolist())) == 9 and pairs.roi_size("sweep") == (196, 156)
    np.testing.assert_allclose(pairs.path_mm, [*[85.0] * 3, *[0.0] * 6], atol=1e-4)
    longer = together(simulate_pairs(key(6), 1, actions=("sweep", "pour"), length=1.4))
    assert longer.path_mm.tolist() == [pytest.approx(119.0), 0.0]
    assert longer.size.tolist() == [[230, 156], [100, 100]]  # 34 mm at 0.96 pixels each
    sweeps = [pairs.of(action="sweep"), longer.of(action="sweep")]
    names = ("prior", "posterior", "action", "agent", "material", "centre", "size", "id")
    parts = {
        name: np.concatenate([getattr(one, name) for one in sweeps])
        for name in (*names, "strength", "path_mm")
    }
    mixed = replace(sweeps[0], **parts)
    with pytest.warns(UserWarning, match=r"1 pair\(s\) are left out, whose path"):
        assert validation.fit(mixed, "D").fitted_to.startswith("3 pairs")
    bank = fit(mixed, "P")
    assert bank.predictor("sweep").path_mm == pytest.approx(85.0)
    assert bank.roi("sweep") == (196, 156)
    start = fit(pairs.of(action="pour"), "P")
    of_all = (bank.predictor("sweep"), start.predictor("pour"), start.predictor("pour"))
    start = replace(start, actions=("sweep", "scoop", "pour"), predictors=of_all)
    adapted = fit(longer, "P", start=start)
    assert adapted.actions == ("sweep", "pour")
    assert adapted.predictor("sweep").path_mm == pytest.approx(119.0, abs=1e-3)
    assert adapted.predictor("sweep").directed and not adapted.predictor("pour").directed


@pytest.mark.full
@pytest.mark.parametrize("action", MOVING)
def test_close_to_material_point_samples(shared_data, action):
    """Less than 0.4 of what doing nothing is off by; docs/simulator.md has all the numbers."""
    folder = shared_data / "mpm" / "carry" / "pairs" / "irregular_flour_robot"
    camera, pairs = sim_against_mpm.read_group(folder)
    rows = moving_against_mpm.compare([p for p in pairs if p["action"] == action][:4], camera)
    change = np.mean([np.abs(row["change"]).mean() for row in rows])
    assert np.mean([row["sim"] for row in rows]) < 0.4 * change
