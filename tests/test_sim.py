"""The simulated bed: what it conserves, what it makes, what the camera sees of it."""

import re
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.views import aimed
from jshape.camera import PAPER_BOX, Camera
from jshape.errors import BadPosition, JShapeError, UnknownName
from jshape.height_map import as_frame
from jshape.sim import (
    ACTIONS,
    AGENTS,
    DOUGH,
    FLOUR,
    KINETIC_SAND,
    MATERIALS,
    SURFACE,
    Z_FLOOR,
    act,
    apply_action,
    curved_bed,
    flat_bed,
    inputs,
    irregular_bed,
    loose_bed,
    mass,
    position_to_xy,
    relax,
    render,
    sensor,
    stroke,
    to_uint16,
    volume,
)
from tests.conftest import ROOT
from tests.documentation import blocks
from tests.reference import sim_rays

MIDDLE = (0.0, 0.0)
STIFF_FLOUR = replace(FLOUR, compressibility=0.0)


def key(seed=0):
    return jax.random.key(seed)


def nominal(bed, material, action, xy=MIDDLE, **options):
    """The bed after a nominal stroke: no variability."""
    return apply_action(key(), bed, material, action, xy, spread=0.0, **options)


def rise_mm(after, before):
    return np.asarray(after.height - before.height) * 1000.0


# --- What is conserved --------------------------------------------------------------------------


@pytest.mark.parametrize("action", ACTIONS)
@pytest.mark.parametrize("material", [STIFF_FLOUR, DOUGH], ids=["flour", "dough"])
def test_volume_is_kept_where_nothing_compresses(material, action):
    bed = irregular_bed(key(1), std=0.010)
    after = apply_action(key(2), bed, material, (action, "human"), (0.02, -0.03))
    assert np.abs(rise_mm(after, bed)).max() > 5.0
    # The deepest crater displaces about 1 % of the bed: compare with what moved, not the bed.
    moved = np.abs(np.asarray(after.height - bed.height, float)).sum() / 2
    lost = np.asarray(bed.height, float).sum() - np.asarray(after.height, float).sum()
    assert abs(lost) < 1e-3 * moved
    np.testing.assert_allclose(volume(after), volume(bed), rtol=1e-5)


@pytest.mark.parametrize("action", ACTIONS)
@pytest.mark.parametrize("material", MATERIALS)
def test_mass_is_kept_even_where_material_packs(material, action):
    bed = irregular_bed(key(3), std=0.008)
    after = apply_action(key(4), bed, material, (action, "robot"), MIDDLE)
    np.testing.assert_allclose(mass(after), mass(bed), rtol=1e-5)
    packing = np.asarray(after.packing)
    assert packing.min() > 0.999
    assert packing.max() < MATERIALS[material].packing_max + 1e-3
    assert (packing.max() > 1.02) == (MATERIALS[material].compressibility > 0)


def test_a_long_series_of_actions_keeps_the_mass():
    bed = before = flat_bed()
    for k in range(12):
        place = (0.03 * (k % 4) - 0.05, 0.03 * (k // 4) - 0.03)
        bed = apply_action(key(k), bed, FLOUR, (ACTIONS[k % 5], "human"), place)
    np.testing.assert_allclose(mass(bed), mass(before), rtol=1e-4)
    assert np.isfinite(bed.height).all() and bed.height.min() >= 0.0


@pytest.mark.full
@pytest.mark.parametrize("action", ACTIONS)
def test_walls_hold_and_nothing_leaves_at_a_corner(action):
    bed = flat_bed(size=(0.3, 0.25))
    after = apply_action(key(5), bed, STIFF_FLOUR, (action, "robot"), (0.15, 0.125))
    assert np.isfinite(after.height).all() and after.height.min() >= 0.0
    np.testing.assert_allclose(volume(after), volume(bed), rtol=1e-5)
    np.testing.assert_allclose(mass(after), mass(bed), rtol=1e-5)


def test_nothing_flows_through_a_wall():
    """Half a hand at the wall digs half of what it digs mid-bed; nothing leaves, none wraps."""
    bed = flat_bed(size=(0.3, 0.25))
    half_dug = dug(rise_mm(nominal(bed, STIFF_FLOUR, "knock"), bed)) / 2
    after = nominal(bed, STIFF_FLOUR, "knock", (0.15, 0.0))
    rise = rise_mm(after, bed).astype(float)
    np.testing.assert_allclose(dug(rise), half_dug, rtol=0.1)
    assert abs(rise.sum()) < 1e-3 * dug(rise)
    assert np.abs(rise[:, :10]).max() == 0.0


def dug(rise):
    """How much is missing where the bed is lower than before."""
    return -rise[rise < 0].sum(dtype=float)


# --- What an action makes -----------------------------------------------------------------------


@pytest.mark.parametrize("action", ACTIONS)
def test_every_action_makes_a_crater_and_a_rim(action):
    bed = flat_bed()
    rise = rise_mm(nominal(bed, FLOUR, action), bed)
    assert rise.min() < -12.0
    assert rise.max() > 0.5


def test_grasp_makes_a_mound_between_trenches():
    bed = flat_bed()
    rise = rise_mm(nominal(bed, FLOUR, "grasp"), bed)
    x, y = (np.asarray(a) for a in bed.axes())
    row = rise[np.abs(y).argmin()]
    assert row[np.abs(x) < 0.005].mean() > 10.0
    assert row[(x > 0.02) & (x < 0.05)].min() < -12.0
    assert row[(x < -0.03) & (x > -0.06)].min() < -12.0


def test_press_is_elongated_along_v():
    bed = flat_bed()
    hole = rise_mm(nominal(bed, FLOUR, "press"), bed) < -5.0
    assert hole.any(1).sum() > 2 * hole.any(0).sum()


@pytest.mark.full
def test_yaw_turns_the_hand():
    bed = flat_bed(size=(0.4, 0.4))
    straight = rise_mm(nominal(bed, FLOUR, "press"), bed)
    turned = rise_mm(nominal(bed, FLOUR, "press", yaw=np.pi / 2), bed)
    np.testing.assert_allclose(turned.T, straight, atol=1.0)


@pytest.mark.parametrize("agent", AGENTS)
@pytest.mark.parametrize("material", MATERIALS)
def test_a_deeper_stroke_makes_a_deeper_crater(material, agent):
    bed = flat_bed()
    depths = [
        -rise_mm(nominal(bed, material, ("knock", agent), strength=s), bed).min()
        for s in (0.5, 1.0, 2.5)
    ]
    assert depths[0] < 0.6 * depths[1]
    assert depths[2] > 2.0 * depths[1]


def test_order_matters():
    bed = flat_bed()
    near = (0.03, 0.0)
    one = nominal(nominal(bed, FLOUR, "knock"), FLOUR, "grasp", near)
    other = nominal(nominal(bed, FLOUR, "grasp", near), FLOUR, "knock")
    assert np.abs(rise_mm(one, other)).max() > 10.0


def test_pressed_flour_packs_less_and_less():
    beds = [flat_bed()]
    for _ in range(3):
        beds.append(nominal(beds[-1], FLOUR, "knock", strength=0.8))
    lost = -np.diff([float(volume(b)) for b in beds])
    deeper = -np.diff([float(b.height.min()) for b in beds])
    assert lost[2] / deeper[2] < 0.7 * lost[0] / deeper[0]


def test_dough_springs_back():
    bed = flat_bed()
    stiff = replace(DOUGH, elastic=0.0)
    full = -rise_mm(nominal(bed, stiff, "poke"), bed).min()
    sprung = -rise_mm(nominal(bed, DOUGH, "poke"), bed).min()
    np.testing.assert_allclose(sprung, (1 - DOUGH.elastic) * full, rtol=0.05)


@pytest.mark.full
def test_robot_is_repeatable_and_human_is_not():
    bed, camera = flat_bed(), PAPER_BOX.crop(140, 97, 200, 200)

    def spread_mm(agent, action):
        act_once = jax.vmap(
            lambda k: render(apply_action(k, bed, FLOUR, (action, agent), MIDDLE), camera)
        )
        images = np.asarray(act_once(jax.random.split(key(8), 12)))
        return images.std(0, ddof=1).mean() * 1000.0

    for action in ("knock", "grasp"):
        robot, human = spread_mm("robot", action), spread_mm("human", action)
        assert robot < 0.6
        assert human > 2.0 * robot


def test_flour_and_sand_differ():
    bed = flat_bed()
    flour, sand = (nominal(bed, m, "knock") for m in (FLOUR, KINETIC_SAND))
    assert volume(flour) < volume(sand)
    assert rise_mm(sand, bed).max() > 1.15 * rise_mm(flour, bed).max()


# --- Slopes -------------------------------------------------------------------------------------


@pytest.mark.parametrize("cohesion", [0.0, 0.5])
def test_slopes_that_are_too_steep_slide(cohesion):
    material = replace(FLOUR, cohesion=cohesion)
    bed = flat_bed(size=(0.2, 0.2))
    x, y = bed.axes()
    tower = jnp.where(jnp.hypot(x[None, :], y[:, None]) < 0.03, 0.10, 0.03)
    bed = loose_bed(tower)
    after = relax(bed, material, rounds=3000)
    height = np.asarray(after.height)
    limit = float(material.steepest) * bed.cell
    diagonal = np.abs(height[1:, 1:] - height[:-1, :-1]) / np.sqrt(2)
    for drop in (np.abs(np.diff(height, axis=0)), np.abs(np.diff(height, axis=1)), diagonal):
        assert drop.max() < 1.02 * limit
    np.testing.assert_allclose(volume(after), volume(bed), rtol=1e-5)


def test_a_bed_that_stands_is_left_alone():
    bed = irregular_bed(key(9), std=0.005)
    np.testing.assert_array_equal(relax(bed, FLOUR).height, bed.height)


# --- Compiling and batching ---------------------------------------------------------------------


@pytest.mark.full
def test_one_kernel_serves_all_actions_agents_and_materials(monkeypatch):
    traces = []
    genuine = act.repetition
    monkeypatch.setattr(act, "repetition", lambda *a: traces.append(1) or genuine(*a))
    bed = flat_bed(size=(0.11, 0.12))  # a size that no other test compiles for
    for material in MATERIALS:
        for action in ACTIONS:
            for agent in AGENTS:
                scale = 1.0 if agent == "robot" else 2.5
                apply_action(key(), bed, material, (action, agent), (0.01, 0.0), scale)
    assert len(traces) == 1


@pytest.mark.full
def test_batch_equals_loop():
    keys = jax.random.split(key(10), 3)
    beds = jax.vmap(lambda k: irregular_bed(k, std=0.006))(jax.random.split(key(11), 3))
    places = jnp.array([[0.0, 0.0], [0.05, -0.04], [-0.1, 0.07]])
    together = jax.vmap(lambda k, h, m, p: _knock(k, h, m, p).height)(
        keys, beds.height, beds.mass, places
    )
    keys = jax.random.split(key(10), 3)
    for n in range(3):
        alone = _knock(keys[n], beds.height[n], beds.mass[n], places[n])
        np.testing.assert_allclose(together[n], alone.height, atol=2e-6)


def _knock(k, height, mass, place):
    bed = replace(flat_bed(), height=height, mass=mass)
    return apply_action(k, bed, KINETIC_SAND, ("knock", "human"), place)


@pytest.mark.full
def test_beds_are_batched_as_a_whole():
    beds = jax.vmap(lambda k: irregular_bed(k, std=0.006))(jax.random.split(key(12), 2))
    after = jax.vmap(lambda k, b: apply_action(k, b, FLOUR, ("poke", "robot"), MIDDLE))(
        jax.random.split(key(13), 2), beds
    )
    assert after.height.shape == beds.height.shape
    assert volume(after).shape == (2,)


@pytest.mark.full
def test_looks_at_many_beds_with_an_action_each_are_those_of_one_by_one():
    """Some rest: a place of NaN."""
    camera = PAPER_BOX.crop(180, 140, 120, 110)
    keys = jax.random.split(key(15), 3)
    beds = jax.vmap(lambda k: irregular_bed(k, 0.005, size=(0.3, 0.25)))(keys)
    strokes = [stroke(*one) for one in (("knock", "robot"), ("grasp", "human"), ("poke", "robot"))]
    where = jnp.array([[0.02, 0.01], [-0.03, 0.0], [jnp.nan, jnp.nan]])
    strengths, yaws = jnp.array([0.5, 1.2, 1.0]), jnp.array([0.3, 0.0, 0.0])

    def step(k, bed, hand, place, strength, yaw):
        bed = apply_action(k, bed, FLOUR, hand, place, strength, yaw)
        return bed, render(bed, camera)

    each = jax.tree.map(lambda *x: jnp.stack(x), *strokes)
    given = beds, each, where, strengths, yaws
    after, looks = jax.jit(jax.vmap(step))(jax.random.split(key(16), 3), *given)
    for n, one in enumerate(jax.random.split(key(16), 3)):
        bed, look = jax.jit(step)(one, *jax.tree.map(lambda x, n=n: x[n], given))
        np.testing.assert_allclose(after.height[n], bed.height, atol=2e-6)
        np.testing.assert_allclose(looks[n], look, atol=2e-5)
    np.testing.assert_array_equal(after.height[2], beds.height[2])
    assert (jnp.abs(after.height - beds.height).max((1, 2)) > 0.003).tolist() == [True, True, False]


@pytest.mark.slow
def test_the_closed_loops_of_the_documentation_run():
    text = (ROOT / "docs" / "simulator.md").read_text(encoding="utf-8")
    _, code = (block.text for block in blocks(text) if block.language == "python")
    done: dict = {}
    exec(code.replace("COUNT, STEPS, camera = 256, 3", "COUNT, STEPS, camera = 2, 2"), done)
    left = np.abs(done["image"](done["looks"]) - done["goal"]).mean((1, 2))
    before = jax.vmap(lambda k: irregular_bed(k, 0.006))(jax.random.split(key(0), 2))
    first = done["image"](jax.vmap(render, (0, None))(before, PAPER_BOX))
    assert (left < np.abs(first - done["goal"]).mean((1, 2))).all()


@pytest.mark.full
def test_the_grid_does_not_matter_much():
    numbers = []
    for cell in (0.0025, 0.004):
        bed = flat_bed(cell=cell)
        after = nominal(bed, KINETIC_SAND, "knock")
        rise = rise_mm(after, bed)
        numbers.append((rise.min(), np.percentile(rise, 99), np.abs(rise).sum() * cell**2))
    np.testing.assert_allclose(numbers[1], numbers[0], rtol=0.15)


# --- Beds ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("std", [0.004, 0.010, 0.017])
def test_irregular_beds_are_as_irregular_as_asked(std):
    height = np.asarray(irregular_bed(key(14), std=std).height)
    np.testing.assert_allclose(height.std(), std, rtol=0.02)
    assert height.min() >= 0.002
    spacing = 0.0025
    there, here = height[:, 18:] - height.mean(), height[:, :-18] - height.mean()
    # Smoothed with 22 mm, the surface correlates over r as exp(-r²/4σ²): 0.35 at 45 mm.
    assert abs((there * here).mean() / height.var() - np.exp(-((18 * spacing / 0.044) ** 2))) < 0.2


def test_curved_beds_have_the_radius():
    for sign in (1.0, -1.0):
        bed = curved_bed(sign * 0.15)
        x, y = (np.asarray(a) for a in bed.axes())
        row = np.asarray(bed.height)[np.abs(y).argmin()]
        fit = np.polyfit(x[np.abs(x) < 0.05], row[np.abs(x) < 0.05], 2)
        np.testing.assert_allclose(-0.5 / fit[0], sign * 0.15, rtol=0.05)


# --- The camera ---------------------------------------------------------------------------------


def test_a_flat_bed_is_at_the_surface_depth():
    image = np.asarray(render(flat_bed(), PAPER_BOX))
    np.testing.assert_allclose(image, SURFACE, atol=1e-6)
    assert image.shape == PAPER_BOX.shape


def test_render_equals_a_plain_ray_marcher():
    camera = replace(PAPER_BOX, width=32, height=26, fx=433 / 15, fy=433 / 15, u0=16.0, v0=13.0)
    bed = irregular_bed(key(15), std=0.010)
    image = np.asarray(render(bed, camera, Z_FLOOR))
    by_hand = sim_rays.render(bed.height, bed.cell, camera, Z_FLOOR)
    np.testing.assert_allclose(image, by_hand, atol=5e-5)


@pytest.mark.parametrize("kind", ["pinhole", "parallel rays"])
@pytest.mark.parametrize("tilt", [0, 30, 60])
def test_render_from_anywhere_equals_a_plain_ray_marcher(tilt, kind):
    bed = irregular_bed(key(6), std=0.008, size=(0.3, 0.25))
    camera = Camera(12, 9, 40.0, 42.0, 5.0, 4.5, 0.2, 2.0, pose=aimed(tilt, 0.4))
    if kind != "pinhole":
        camera = replace(camera, fx=80.0, fy=90.0, orthographic=True)
    image = np.asarray(render(bed, camera))
    by_hand = sim_rays.render(bed.height, bed.cell, camera, Z_FLOOR)
    np.testing.assert_allclose(image, by_hand, atol=2e-6)


def test_a_pose_that_is_none_changes_nothing():
    bed, camera = irregular_bed(key(6), std=0.008), PAPER_BOX.crop(100, 100, 120, 90)
    posed = render(bed, replace(camera, pose=aimed(0, SURFACE)))
    np.testing.assert_allclose(posed, render(bed, camera), atol=1e-6)


def test_a_ray_that_meets_no_bed_reads_nothing():
    wide = Camera(9, 61, 20.0, 20.0, 4.0, 30.0, 0.2, 2.0)
    endless = flat_bed(size=(20.0, 20.0), cell=0.1)
    image = np.asarray(render(endless, replace(wide, pose=aimed(60, 0.4))))
    down = np.cos(np.radians(60)) + (np.arange(61) - 30.0) / 20.0 * np.sin(np.radians(60))
    rays = np.abs(down) > 0.1  # but for those that all but graze
    assert (image[rays & (down < 0)] == 0).all() and (down < 0).sum() > 10
    np.testing.assert_allclose(image[rays & (down > 0), 4], 0.2 / down[rays & (down > 0)],
                               rtol=1e-4)  # fmt: skip
    buried = np.eye(4)
    buried[2, 3] = SURFACE + 0.01
    assert (np.asarray(render(flat_bed(), replace(wide, pose=as_frame(buried)))) == 0).all()


@pytest.mark.parametrize("tilt", [0, 30])
def test_the_bed_ends_at_the_walls_of_its_box(tilt):
    camera = Camera(160, 120, 80.0, 80.0, 79.5, 59.5, 0.3, 0.9, pose=aimed(tilt, 0.6))
    seen = np.asarray(render(flat_bed(), camera)) > 0
    begin, along = (np.asarray(part) for part in camera.lines(np.array(camera.pose)))
    x, y = (begin[k] + (SURFACE - begin[2]) / along[2] * along[k] for k in (0, 1))
    off = np.maximum(np.abs(x) - 0.28, np.abs(y) - 0.23)  # from the walls, metres
    assert seen[off < -1e-5].all() and not seen[off > 1e-5].any()
    assert 0.05 < seen.mean() < 0.5


def test_the_camera_sees_the_near_side_of_a_wall_first():
    bed = flat_bed()
    x, _ = bed.axes()
    wall = replace(bed, height=jnp.where((x > 0.1) & (x < 0.12), 0.09, bed.height))
    camera = replace(PAPER_BOX, width=64, height=2, fx=433 / 4, fy=433 / 4, u0=10.0, v0=0.0)
    image = np.asarray(render(wall, camera))
    by_hand = sim_rays.render(wall.height, wall.cell, camera, Z_FLOOR)
    np.testing.assert_allclose(image, by_hand, atol=2e-5)


SMALL = replace(PAPER_BOX, width=96, height=79, fx=433 / 5, fy=433 / 5, u0=48.0, v0=39.5)
"""All of the box in few pixels: the reference takes a second or two."""


@pytest.mark.full
@pytest.mark.parametrize("seed", [1, 2])
def test_steep_walls_of_a_molded_bed_are_rendered_where_they_are(seed):
    bed = flat_bed() if seed == 1 else irregular_bed(key(3), std=0.010)
    for k in range(10):
        place = jax.random.uniform(key(100 * seed + k), (2,), minval=-0.16, maxval=0.16)
        bed = apply_action(key(k), bed, FLOUR, (ACTIONS[k % 5], "human"), place, 1.5)
    image = np.asarray(render(bed, SMALL), float)
    by_hand = sim_rays.render(bed.height, bed.cell, SMALL, Z_FLOOR)
    off = np.abs(image - by_hand)
    # A ray that grazes a crest may go on: only there, where a fiftieth of a pixel decides.
    moved = [replace(SMALL, u0=SMALL.u0 + a, v0=SMALL.v0 + b) for a, b in NUDGES]
    nudged = [sim_rays.render(bed.height, bed.cell, camera, Z_FLOOR) for camera in moved]
    silhouette = np.ptp([by_hand, *nudged], axis=0) > 0.002
    assert silhouette.mean() < 0.01
    assert off[~silhouette].max() < 5e-5
    assert (off > 5e-5).mean() < 1e-3
    # Near a silhouette too, every depth is a point of the surface: none floats.
    x, y = (np.broadcast_to(np.asarray(a, float), SMALL.shape) for a in SMALL.rays())
    height = np.asarray(bed.height, float)
    rays = zip(image.ravel(), x.ravel(), y.ravel(), strict=True)
    under = [sim_rays.height_at(height, bed.cell, a * z, b * z) + z for z, a, b in rays]
    np.testing.assert_allclose(under, Z_FLOOR, atol=1e-4)


NUDGES = ((0.02, 0.02), (-0.02, -0.02))
"""Shifts of a camera, pixels."""


def test_noise_is_as_large_and_as_correlated_as_asked():
    flat = jnp.full((395, 480), 0.45)
    noise = np.asarray(sensor(key(16), flat, hole_share=0.0)) - 0.45
    np.testing.assert_allclose(noise.std(), 0.00045, rtol=0.1)
    assert abs(noise.mean()) < 5e-5
    for r in (2, 4, 8):
        measured = (noise[:, r:] * noise[:, :-r]).mean() / noise.var()
        np.testing.assert_allclose(measured, np.exp(-((r / 4.6) ** 2)), atol=0.05)
    far = np.asarray(sensor(key(16), 2.0 * flat, hole_share=0.0)) - 0.9
    np.testing.assert_allclose(far, 4.0 * noise, atol=2e-6)


def test_missing_pixels_are_exactly_zero():
    flat = jnp.full((395, 480), 0.45).at[10, 20].set(0.0)
    seen = np.asarray(sensor(key(17), flat, hole_share=0.01))
    assert 0.005 < (seen == 0).mean() < 0.02
    assert seen[10, 20] == 0
    assert seen[seen > 0].min() > 0.44
    counts = np.asarray(to_uint16(jnp.asarray(seen)))
    assert counts.dtype == np.uint16
    np.testing.assert_array_equal(counts == 0, seen == 0)
    np.testing.assert_allclose(counts * 1e-4, seen, atol=5.1e-5)


def test_what_is_no_depth_stays_missing():
    strange = jnp.full((40, 40), 0.45).at[:, :4].set(jnp.array([0.0, jnp.nan, jnp.inf, -0.2]))
    seen = np.asarray(sensor(key(18), strange, hole_share=0.0))
    assert (seen[:, :4] == 0).all() and (seen[:, 4:] > 0.4).all()
    counts = np.asarray(to_uint16(strange))
    assert (counts[:, :4] == 0).all() and (counts[:, 4:] == 4500).all()
    assert to_uint16(jnp.array([[7.0]]))[0, 0] == 65535


def test_noise_makes_no_depth_negative():
    seen = np.asarray(sensor(key(19), jnp.full((40, 40), 0.45), 0.5, 0.0))
    assert seen.min() == 0.0 and (seen > 0).any()


def test_eight_bits_go_through_the_camera():
    image = render(nominal(flat_bed(), FLOUR, "knock"), PAPER_BOX)
    level = np.asarray(PAPER_BOX.luminance(image))
    assert level.max() <= 255 and 0 < level.min() and (level == np.round(level)).all()


def test_position_is_where_the_camera_sees_the_action():
    uv = np.array([[300.0, 150.0], [140.0, 250.0]], np.float32)
    bed = flat_bed()
    for place, xy in zip(uv, position_to_xy(PAPER_BOX, uv), strict=True):
        after = nominal(bed, FLOUR, "poke", xy)
        hole = np.asarray(render(after, PAPER_BOX)) - SURFACE > 0.004
        v, u = np.nonzero(hole)
        np.testing.assert_allclose([u.mean(), v.mean()], place, atol=4.0)


# --- Refusals -----------------------------------------------------------------------------------


def test_unknown_names_are_refused():
    bed = flat_bed()
    with pytest.raises(UnknownName, match="'tickle'.*grasp, knock"):
        stroke("tickle", "robot")
    with pytest.raises(UnknownName, match="'dog'.*robot, human"):
        apply_action(key(), bed, FLOUR, ("poke", "dog"), MIDDLE)
    with pytest.raises(UnknownName, match="'mud'.*flour, sand, dough"):
        apply_action(key(), bed, "mud", "poke", MIDDLE)


def test_a_place_outside_the_box_is_refused():
    with pytest.raises(BadPosition, match="0.280"):
        apply_action(key(), flat_bed(), FLOUR, "poke", (0.4, 0.0))
    with pytest.raises(BadPosition):
        apply_action(key(), flat_bed(), FLOUR, "poke", (np.nan, 0.0))


def test_a_batch_of_beds_needs_vmap():
    bed = flat_bed()
    batch = replace(bed, height=bed.height[None], mass=bed.mass[None])
    with pytest.raises(JShapeError, match="vmap"):
        apply_action(key(), batch, FLOUR, "poke", MIDDLE)


@pytest.mark.full
@pytest.mark.parametrize("place", [(0.4, 0.0), (0.0, -3.0), (np.nan, 0.0)])
def test_a_traced_place_outside_the_box_changes_nothing(place):
    bed = irregular_bed(key(20), std=0.008)
    places = jnp.array([MIDDLE, place])
    after = jax.vmap(lambda p: apply_action(key(), bed, FLOUR, "poke", p))(places)
    assert np.abs(after.height[0] - bed.height).max() > 0.01
    np.testing.assert_array_equal(after.height[1], bed.height)
    np.testing.assert_array_equal(after.mass[1], bed.mass)


@pytest.mark.full
def test_a_hand_with_no_cell_below_it_takes_the_bed_around_it():
    bed = flat_bed(cell=0.01)
    poke = stroke("poke", "robot")
    narrow = replace(poke, reach=0.1 * poke.reach)
    hole = -rise_mm(nominal(bed, FLOUR, narrow), bed).min()
    np.testing.assert_allclose(hole, -rise_mm(nominal(bed, FLOUR, poke), bed).min(), rtol=1e-3)


def unchecked_bed(**fields):
    """A bed with fields that the hook of the test run (not a user's Python) would refuse."""
    bed = flat_bed()
    for name, value in fields.items():
        object.__setattr__(bed, name, value)
    return bed


@pytest.mark.full
def test_integer_beds_are_pressed_as_floats():
    ones = jnp.ones((60, 60), jnp.int32)
    after = nominal(unchecked_bed(height=ones, mass=ones), FLOUR, "poke")
    assert after.height.dtype == jnp.float32
    np.testing.assert_allclose(1.0 - after.height.min(), 0.0195, atol=0.003)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"strength": 0.0}, "strength is 0.0"),
        ({"strength": np.inf}, "strength is inf"),
        ({"yaw": np.nan}, "yaw is nan"),
        ({"spread": -1.0}, "spread is -1.0"),
        ({"spread": jnp.ones(2)}, "spread is an array"),
        ({"xy": ("a", "b")}, "two numbers"),
        ({"bed": flat_bed(cell=0.02)}, "0.02 m.*0.01"),
        ({"bed": unchecked_bed(mass=jnp.ones((3, 3)))}, r"\(184, 224\).*\(3, 3\)"),
    ],
)
def test_nonsense_is_refused_in_one_line(options, said):
    given = {"bed": flat_bed(), "material": FLOUR, "action": "poke", "xy": MIDDLE} | options
    with pytest.raises(JShapeError, match=said) as caught:
        apply_action(key(), **given)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("read", "given"),
    [
        (inputs.read_material, 3),
        (inputs.read_stroke, 3.0),
        (inputs.read_stroke, ["poke", "robot", "now"]),
        (inputs.read_bed, "flat"),
    ],
)
def test_the_wrong_kind_is_refused_with_what_came(read, given):
    with pytest.raises(JShapeError, match=re.escape(repr(given))):
        read(given)


@pytest.mark.parametrize(
    "make",
    [
        lambda: flat_bed(0.0),
        lambda: flat_bed(np.nan),
        lambda: flat_bed(size=(np.inf, 0.3)),
        lambda: flat_bed(size=(0.3, 0.001)),
        lambda: flat_bed(cell=0.0),
        lambda: irregular_bed(key(), std=-0.01),
        lambda: irregular_bed(key(), sigma=0.0),
        lambda: irregular_bed(key(), depth=-0.06),
        lambda: curved_bed(0.0),
        lambda: curved_bed(np.inf),
        lambda: curved_bed(drop=-0.01),
        lambda: curved_bed(crown=np.nan),
        lambda: loose_bed(jnp.full((20, 20), jnp.nan)),
        lambda: loose_bed(jnp.ones((20, 20)), cell=-0.0025),
    ],
)
def test_beds_that_cannot_be_are_refused(make):
    with pytest.raises(JShapeError):
        make()


# --- Against independent samples ----------------------------------------------------------------


@pytest.mark.full
@pytest.mark.parametrize("action", ACTIONS)
def test_close_to_material_point_samples(shared_data, action):
    """Less than half of what doing nothing is off by; docs/simulator.md has all the numbers."""
    from benchmarks import sim_against_mpm as bench

    camera, pairs = bench.read_group(shared_data / "mpm" / "pairs" / "flat_flour_robot")
    row = bench.compare([p for p in pairs if p["action"] == action][:3], camera)
    assert row["sim"] < 0.5 * row["change"]


@pytest.mark.full
def test_64_bits_change_nothing():
    def seen():
        bed = apply_action(key(), irregular_bed(key(1), 0.002), FLOUR, "knock", MIDDLE)
        return bed.height, render(bed, PAPER_BOX.crop(180, 150, 60, 50))

    expected = seen()
    with jax.enable_x64(True):
        for one, other in zip(seen(), expected, strict=True):
            assert one.dtype == np.float32
            np.testing.assert_allclose(one, other, atol=1e-6)
