"""Six operations: where the tool goes, what ends them, what is refused before the arm moves."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from jshape.camera import PAPER_BOX
from jshape.errors import BadFile, JShapeError
from jshape.robot.arms.base import (
    POSTURES,
    Arm,
    ArmError,
    ArmSettings,
    EffortLimit,
    Moved,
    PoseRefused,
)
from jshape.robot.arms.dry_run import DryRun
from jshape.robot.arms.names import open_arm
from jshape.robot.arms.simulated import SimulatedArm
from jshape.robot.cameras.simulated import levelled_world
from jshape.robot.perform import perform
from jshape.robot.procedure import NAMES, ArmLimits, Operation, Procedure, surface_point, turned
from jshape.robot.procedure_file import load_hand, read_procedure
from jshape.robot.simulated import SimulatedWorld

POINT = np.array([0.03, -0.02, 0.45])
HERE = np.eye(4)


class Recorded(DryRun):
    """An arm that keeps what it was told; `effort` is what it feels in an operation, by name."""

    def __init__(self, effort=None, broken=None):
        super().__init__(lambda line: None)
        self.moves, self.stops, self.felt, self.broken = [], 0, effort or {}, broken

    def begin(self, doing, tool):
        self.doing = doing
        if doing.operation == self.broken:
            raise ArmError("a fuse blew")

    def move(self, pose, *, speed, threshold):
        super().move(pose, speed=speed, threshold=threshold)
        self.moves.append((self.doing.operation, pose, speed))
        felt = self.felt.get(self.doing.operation, 0.0)
        return Moved(felt > threshold, felt, pose)

    def stop(self):
        self.stops += 1


@pytest.fixture(scope="module")
def hand():
    return load_hand()


def test_the_bundled_hand_can_do_all_that_the_simulated_one_can(hand):
    from jshape import sim

    assert set(hand.procedures) == {*sim.ACTIONS, *sim.MOVING}
    for procedure in hand.procedures.values():
        assert tuple(one.name for one in procedure.operations) == NAMES
        assert {one.posture for one in procedure.operations} - {None} <= set(POSTURES)


@pytest.mark.parametrize("action", ["sweep", "scoop"])
def test_paths_are_those_of_the_simulator(hand, action):
    """Its edge is one finger: x and z of its middle at the three moments, metres."""
    from jshape import sim

    simulated = np.asarray(sim.stroke(action).path)[:, 0].mean(1)[:, [0, 2]]
    path = hand.procedures[action].path() * [1.0, -1.0]
    if action == "sweep":  # which is above the bed at first
        simulated = simulated[1:]
    np.testing.assert_allclose(path, simulated, atol=1e-6)


@pytest.mark.parametrize("yaw", [0.0, 0.7])
def test_the_tool_goes_above_down_and_up_at_the_place(hand, yaw):
    base = np.eye(4)
    base[:3, :3], base[:3, 3] = np.diag([1.0, -1.0, -1.0]), [0.5, 0.1, 0.9]
    arm = Recorded()
    done = perform(arm, hand, "poke", POINT, base, strength=1.5, yaw=yaw)
    assert [one.operation for one in done] == list(NAMES) and not any(d.contact for d in done)
    by_name = {one.name: one for one in hand.procedures["poke"].operations}
    for name, pose, speed in arm.moves:
        inside = np.linalg.inv(base) @ pose
        np.testing.assert_allclose(inside[:3, :3], turned(yaw), atol=1e-12)
        np.testing.assert_allclose(inside[:2, 3], POINT[:2], atol=1e-12)
        one = by_name[name]
        down = one.depth_mm * 1.5 if one.depth_mm else -one.height_mm
        np.testing.assert_allclose(1000 * (inside[2, 3] - POINT[2]), down, atol=1e-9)
        assert speed == one.speed_mm_s / 1000
    assert arm.stops == 0


@pytest.mark.parametrize(("yaw", "length", "strength"), [(0.0, 1.0, 1.0), (2.2, 1.5, 0.5)])
def test_a_path_is_followed_between_where_the_hand_goes_down_and_up(hand, yaw, length, strength):
    base = np.eye(4)
    base[:3, :3], base[:3, 3] = np.diag([1.0, -1.0, -1.0]), [0.5, 0.1, 0.9]
    arm, how = Recorded(), {"yaw": yaw, "length": length, "strength": strength}
    perform(arm, hand, "scoop", POINT, base, **how)
    to_hand = np.eye(4)
    to_hand[:3, :3], to_hand[:3, 3] = turned(yaw), POINT
    at = [
        (name, *1000 * (np.linalg.inv(base @ to_hand) @ pose)[[0, 1, 2], 3])
        for name, pose, _ in arm.moves
    ]
    middle, half = (16.8 - 63.9) / 2, (16.8 + 63.9) / 2 * length
    start, corner, end = middle - half, middle + length * (-4.6 - middle), middle + half
    expected = [
        ("above", start, -120), ("prepare", start, -30), ("contact", start, 0),
        ("act", start, 0), ("act", corner, 11.8 * strength), ("act", end, 11.8 * strength),
        ("up", end, -120),
    ]  # fmt: skip
    assert [name for name, *_ in at] == [name for name, *_ in expected]
    for (_, x, y, z), (_, x_wanted, z_wanted) in zip(at, expected, strict=True):
        np.testing.assert_allclose((x, y, z), (x_wanted, 0.0, z_wanted), atol=1e-9)
    assert arm.doing.length == length and arm.doing.way == pytest.approx(2e-3 * half)
    begins = hand.procedures["scoop"].begins(yaw, length)
    np.testing.assert_allclose(begins, 1e-3 * turned(yaw)[:2, 0] * start)
    np.testing.assert_array_equal(hand.procedures["poke"].begins(yaw), [0, 0])


def test_an_effort_on_the_way_ends_the_path(hand):
    arm = Recorded({"act": 100.0})
    done = perform(arm, hand, "sweep", POINT, HERE)
    assert [one.operation for one in done] == list(NAMES) and done[3].contact
    assert [name for name, *_ in arm.moves].count("act") == 1  # it went down, and no further


def test_a_pour_opens_the_hand_in_the_air(hand):
    arm, lines = Recorded(), []
    arm.posture = lambda name, **how: (
        lines.append((arm.doing.operation, name)) or Moved(False, 0.0, arm.pose())
    )
    perform(arm, hand, "pour", POINT, HERE)
    assert max(pose[2, 3] for _, pose, _ in arm.moves) < POINT[2] - 0.03
    assert lines[-1] == ("act", "open") and arm.moves[-1][0] == "up"


def test_the_surface_counts_where_the_hand_goes_down(hand):
    """A step in the bed between a sweep's start and its place: depths are below the start's."""
    depth = np.full(PAPER_BOX.shape, 0.46)
    depth[:, :240] = 0.44
    procedure = hand.procedures["sweep"]
    for yaw, expected in ((0.0, 0.44), (np.pi, 0.46)):
        point = surface_point(depth, PAPER_BOX, (245, 197), beside=procedure.begins(yaw))
        x = (245 - float(PAPER_BOX.u0)) * 0.45 / float(PAPER_BOX.fx)
        np.testing.assert_allclose(point[[0, 2]], (x, expected), atol=1e-6)


@pytest.mark.parametrize(
    ("action", "length", "said"),
    [
        ("sweep", 0.0, "its path 0 times as long; a length is above 0 and at most 10"),
        ("sweep", float("nan"), "a length is above 0"),
        ("sweep", 9.0, "sweep: act goes to .* the workspace is"),
        ("poke", 1.5, "poke: its act has no path_mm, so it cannot be 1.5 times as long"),
    ],
)
def test_lengths_that_make_no_sense_are_refused_before_the_arm_moves(hand, action, length, said):
    arm = Recorded()
    with pytest.raises(PoseRefused, match=said):
        perform(arm, hand, action, np.array([0.1, 0.0, 0.45]), HERE, length=length)
    assert not arm.moves


def test_an_effort_ends_an_operation_and_the_next_follows(hand):
    arm = Recorded({"contact": 100.0})
    done = perform(arm, hand, "knock", POINT, HERE)
    assert [one.operation for one in done if one.contact] == ["contact"]
    assert [one.operation for one in done] == list(NAMES)


def test_an_effort_beyond_the_hard_limit_stops_the_arm(hand):
    arm = Recorded({"act": hand.limits.effort_nm + 1})
    with pytest.raises(EffortLimit, match="act: effort 121 Nm; the hard limit is 120"):
        perform(arm, hand, "knock", POINT, HERE)
    assert arm.stops == 1 and arm.moves[-1][0] == "act"


@pytest.mark.parametrize("operation", ["above", "up"])
def test_a_contact_in_the_air_is_a_collision(hand, operation):
    arm = Recorded({operation: 100.0})
    with pytest.raises(ArmError, match=f"{operation}: effort 100 Nm: something is in the way"):
        perform(arm, hand, "knock", POINT, HERE)
    assert arm.stops == 1 and arm.moves[-1][0] == operation


def test_an_effort_that_is_no_number_stops_the_arm(hand):
    arm = Recorded({"above": float("nan")})
    with pytest.raises(EffortLimit, match="effort nan Nm"):
        perform(arm, hand, "knock", POINT, HERE)
    assert arm.stops == 1


@pytest.mark.parametrize("operation", NAMES)
def test_an_arm_that_fails_is_stopped(hand, operation):
    arm = Recorded(broken=operation)
    with pytest.raises(ArmError, match="a fuse blew"):
        perform(arm, hand, "poke", POINT, HERE)
    assert arm.stops == 1


def test_what_leaves_the_workspace_is_refused_before_the_arm_moves(hand):
    arm = Recorded()
    with pytest.raises(PoseRefused, match="poke: above goes to .* the workspace is"):
        perform(arm, hand, "poke", np.array([0.5, 0.0, 0.45]), HERE)
    for strength, yaw in ((-1.0, 0.0), (1e6, 0.0), (1.0, float("nan")), (float("nan"), 0.0)):
        with pytest.raises(PoseRefused, match="a strength is above 0"):
            perform(arm, hand, "poke", POINT, HERE, strength=strength, yaw=yaw)
    with pytest.raises(ArmError, match="cannot stroke; it can: grasp"):
        perform(arm, hand, "stroke", POINT, HERE)
    assert not arm.moves


def test_a_stroke_ends_above_the_floor():
    some = Procedure("poke", (Operation("act", depth_mm=40.0), Operation("clear")))
    for strength, z in ((2.0, ArmLimits().high_mm[2] / 1000), (1.0, 0.49)):
        (_, (pose,)), (_, nowhere) = some.poses(ArmLimits(), POINT, strength)
        assert pose[2, 3] == pytest.approx(z, abs=1e-12) and not nowhere


def test_a_dry_run_says_every_operation(hand):
    lines = []
    arm = DryRun(lines.append)
    perform(arm, hand, "grasp", POINT, HERE)
    perform(arm, hand, "sweep", POINT, HERE, length=2.0)
    arm.stop()
    arm.stop()
    assert lines.count("  stop") == 1
    assert isinstance(DryRun(), Arm) and sum(line.startswith("grasp") for line in lines) == 6
    assert any("tool to (30.0, -20.0, 330.0) mm" in line for line in lines)
    act = lines.index("sweep x1.00, 170 mm of way: act")
    assert "(-52.5, -20.0, 458.6) mm, 0°, 60 mm/s, until 80 Nm" in lines[act + 1]
    assert "(117.5, -20.0, 458.6) mm" in lines[act + 2] and lines[act + 3].startswith("sweep")


def test_the_simulated_arm_refuses_what_lies_beyond_its_box(hand):
    opened, world = open_arm("sim:3", ArmSettings(PAPER_BOX)), levelled_world(3)
    np.testing.assert_array_equal(opened.arm.world.bed.height, world.bed.height)  # one bed
    for x, y in ((0.29, 0.0), (0.0, -0.24)):
        with pytest.raises(PoseRefused, match="beyond the walls of the simulated box, ±280 and"):
            perform(opened.arm, hand, "knock", np.array([x, y, 0.45]), opened.base_camera)
    there = np.array([0.27, 0.22, 0.45])
    assert not perform(opened.arm, hand, "knock", there, opened.base_camera, only_check=True)
    np.testing.assert_array_equal(opened.arm.world.bed.height, world.bed.height)  # none moved it


@pytest.fixture
def flat():
    import jax

    from jshape import sim

    return SimulatedWorld(jax.random.key(0), sim.flat_bed(), spread=0.0)


def _depth(world):
    import jax

    from jshape.data.simulate import look

    return look(jax.random.key(1), world.bed, world.camera, frames=1, noise=0.0)


@pytest.mark.full
def test_the_simulated_arm_does_what_the_world_does(hand, flat):
    import jax

    from jshape import sim

    other = SimulatedWorld(jax.random.key(0), sim.flat_bed(), spread=0.0)
    other.act("knock", (240, 197), 0.8, 0.3)
    surface = float(np.median(_depth(flat)))
    done = perform(
        SimulatedArm(flat), hand, "knock", np.array([0.0, 0.0, surface]), HERE,
        strength=0.8, yaw=0.3,
    )  # fmt: skip
    assert [one.contact for one in done] == [False, False, True, False, False, False]
    assert np.abs(_depth(flat) - _depth(other)).max() < 2e-4
    assert np.abs(_depth(other) - surface).max() > 0.01


class Buried(SimulatedArm):
    """Over a bed that is rigid up to so far above the floor, mm."""

    def __init__(self, world, top_mm):
        super().__init__(world)
        self.top_mm = top_mm

    def _efforts(self, line):
        from jshape import sim

        stone = sim.Z_FLOOR - self.top_mm / 1000
        return super()._efforts(line) + 1e4 * np.maximum(line[:, 2] - stone, 0.0)


@pytest.mark.full
def test_something_buried_ends_the_stroke_early_and_the_bed_knows(hand, flat):
    import jax

    from jshape import sim

    surface = float(np.median(_depth(flat)))
    top_mm = 1000 * (sim.Z_FLOOR - surface) - 6.0  # 6 mm below the surface
    arm = Buried(flat, top_mm)
    done = perform(arm, hand, "knock", np.array([0.0, 0.0, surface]), HERE)
    act = done[3]
    assert act.contact and act.operation == "act" and len(done) == 6
    reached = act.tool_mm[2] / 1000 - surface
    assert 0.006 < reached < 0.013
    other = SimulatedWorld(jax.random.key(0), sim.flat_bed(), spread=0.0)
    other.act("knock", (240, 197), reached / 0.0167)
    assert np.abs(_depth(flat) - _depth(other)).max() < 5e-4


@pytest.mark.full
@pytest.mark.parametrize(
    ("action", "how"),
    [
        ("sweep", {"strength": 0.8, "yaw": 2.5, "length": 0.7}),
        ("scoop", {"strength": 1.3, "yaw": -0.4}),
    ],
)
def test_the_simulated_arm_moves_material_as_the_world_does(hand, flat, action, how):
    import jax

    from jshape import sim

    other = SimulatedWorld(jax.random.key(0), sim.flat_bed(), spread=0.0)
    other.act(action, (240, 197), **how)
    surface = float(np.median(_depth(flat)))
    done = perform(SimulatedArm(flat), hand, action, np.array([0.0, 0.0, surface]), HERE, **how)
    assert not done[3].contact and 5.0 < done[3].effort_nm < 20.0
    assert np.abs(np.asarray(flat.bed.height - other.bed.height)).max() < 1e-4
    assert float(flat.bed.stock) == pytest.approx(float(other.bed.stock), abs=1e-8)
    assert (float(flat.bed.stock) > 30e-6) == (action == "scoop")
    assert np.abs(_depth(other) - surface).max() > 0.005


@pytest.mark.full
def test_a_sweep_that_is_stopped_on_its_way_moves_what_it_met(hand, flat):
    """A hill of 20 mm stands from 10 mm after the place on: there the effort rises to 17 Nm."""
    import jax

    from jshape import sim

    x, _ = flat.bed.axes()
    flat.bed = sim.loose_bed(np.where(x > 0.010, 0.08, 0.06) * np.ones(flat.bed.height.shape))
    start = flat.bed
    other = SimulatedWorld(jax.random.key(0), start, spread=0.0)
    procedure = hand.procedures["sweep"]
    act = replace(procedure.operations[3], effort_nm=10.0)
    operations = (*procedure.operations[:3], act, *procedure.operations[4:])
    gentle = replace(hand, procedures={"sweep": replace(procedure, operations=operations)})
    point = np.array([0.0, 0.0, sim.Z_FLOOR - 0.06])
    done = perform(SimulatedArm(flat), gentle, "sweep", point, HERE)
    assert done[3].contact and done[3].tool_mm[0] == pytest.approx(10.0, abs=1.5)
    other.act("sweep", (240, 197), share=(done[3].tool_mm[0] + 40) / 85)
    np.testing.assert_allclose(flat.bed.height, other.bed.height, atol=2e-4)
    whole = SimulatedWorld(jax.random.key(0), start, spread=0.0)
    whole.act("sweep", (240, 197))
    lowest = [float(world.bed.height[:, x > 0.04].min()) for world in (flat, whole)]
    assert lowest[0] > 0.075 and lowest[1] < 0.055


@pytest.mark.full
def test_what_is_scooped_is_what_can_be_poured(hand, flat):
    from jshape import sim

    surface = float(np.median(_depth(flat)))
    arm, before = SimulatedArm(flat), float(sim.mass(flat.bed))
    empty = flat.bed
    perform(arm, hand, "pour", np.array([0.1, 0.05, surface]), HERE)
    np.testing.assert_array_equal(flat.bed.height, empty.height)  # nothing was taken yet
    perform(arm, hand, "scoop", np.array([-0.05, 0.0, surface]), HERE, strength=0.8)
    held = float(flat.bed.stock)
    assert 20e-6 < held < 50e-6
    perform(arm, hand, "pour", np.array([0.1, 0.05, surface]), HERE, strength=2.0)
    assert abs(float(flat.bed.stock)) < 1e-8
    assert float(sim.mass(flat.bed)) == pytest.approx(before, rel=1e-5)
    height = np.asarray(flat.bed.height)
    row, column = np.unravel_index(height.argmax(), height.shape)
    x, y = (np.asarray(axis) for axis in flat.bed.axes())
    assert abs(x[column] - 0.1) < 0.015 and abs(y[row] - 0.05) < 0.015


def test_a_stock_beside_the_bed_is_brought_and_ends():
    import jax

    from jshape import sim

    world = SimulatedWorld(jax.random.key(0), sim.flat_bed(), stock_cm3=70.0)
    before = float(sim.mass(world.bed))
    for brought in (50e-6, 70e-6, 70e-6):
        world.act("pour", (240, 197))
        assert float(sim.mass(world.bed)) - before == pytest.approx(brought, abs=2e-6)
    opened = open_arm("sim:3", ArmSettings(PAPER_BOX, stock_cm3=70.0)).arm.world
    before = float(sim.mass(opened.bed))
    opened.act("pour", (240, 197))
    assert float(sim.mass(opened.bed)) - before == pytest.approx(50e-6, abs=2e-6)
    with pytest.raises(JShapeError, match="stock_cm3 is -1.0; it must be .* at least 0"):
        SimulatedWorld(jax.random.key(0), sim.flat_bed(), stock_cm3=-1.0)
    with pytest.raises(JShapeError, match="length is 0; it must be one finite number above 0"):
        world.act("sweep", (240, 197), length=0)


def _written(tmp_path, change):
    content = yaml.safe_load(
        """{action: poke, tool_mm: [0, 0, 200], operations: [{name: above, height_mm: 100},
        {name: prepare, height_mm: 20}, {name: contact, height_mm: 0}, {name: act, depth_mm: 10},
        {name: up, height_mm: 100}, {name: clear}]}"""
    )
    change(content)
    (tmp_path / "poke.yaml").write_text(yaml.safe_dump(content))
    (tmp_path / "limits.yaml").write_text("effort_nm: 90")
    return tmp_path / "poke.yaml"


def test_a_procedure_of_ones_own(tmp_path):
    made = read_procedure(_written(tmp_path, lambda content: None))
    assert isinstance(made, Procedure) and made.operations[3].depth_mm == 10
    hand = load_hand(tmp_path)
    assert set(hand.procedures) == {"poke"} and hand.limits.effort_nm == 90


def _with_path(path, **more):
    def change(content):
        content["operations"][3] = {"name": "act", "path_mm": path, **more}

    return change


def test_a_path_of_ones_own(tmp_path):
    made = read_procedure(_written(tmp_path, _with_path([[-20, 0], [-10, 5.5], [30, 5]])))
    np.testing.assert_allclose(made.path(2.0), [[-0.045, 0], [-0.025, 0.0055], [0.055, 0.005]])
    arm = Recorded()
    perform(arm, load_hand(tmp_path), "poke", POINT, HERE, length=2.0)
    assert [name for name, *_ in arm.moves].count("act") == 3


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda c: c["operations"].pop(), "expected above, prepare, contact, act, up, clear"),
        (lambda c: c["operations"][0].update(hight_mm=3), "unknown 'hight_mm'; allowed: name"),
        (lambda c: c["operations"][3].update(height_mm=3), "both given"),
        (lambda c: c["operations"][0].update(speed_mm_s=-1), "speed_mm_s is -1; .* above 0"),
        (lambda c: c["operations"][0].update(speed_mm_s=float("nan")), "expected a number"),
        (lambda c: c["operations"][0].update(effort_nm="much"), "effort_nm is 'much'"),
        (lambda c: c.update(tool_mm=[1, 2]), "expected 3 numbers"),
        (lambda c: c.update(tool_mm=[0, 0, 1e5]), "each a number from -2000 to 2000"),
        (lambda c: c["operations"][0].update(height_mm=-40), "touches nothing there"),
        (lambda c: c["operations"][5].update(effort_nm=4), "nothing else to say of it"),
        (
            lambda c: c["operations"][3].update(seconds=1e5),
            "seconds is 100000.0; .* 0 to 60",
        ),
        (lambda c: c.update(action=3), "action is 3"),
        (lambda c: c.update(operations="all"), "operations is 'all'; expected a list"),
        (lambda c: c.update(tool_mm=[0, 0, 0.2]), "tool_mm is 0.2 mm long; .* metres: times 1000"),
        (_with_path([[-40, 8]]), "path_mm has 1 points; expected 2 to 8 of .x, depth."),
        (_with_path([[-40, 8], [45]]), "path_mm 2 is .45.; expected 2 numbers"),
        (_with_path([[-40, 8], [float("nan"), 8]]), "path_mm 2 is .*expected 2 numbers"),
        (_with_path([[-40, 8], [45, 8], [40, 8]]), "goes from x 45 to 40; each point is ahead"),
        (_with_path([[-40, -8], [45, 8]]), r"path_mm goes \[-8.0, 8.0\] mm deep; depths are"),
        (_with_path([[-40, 0], [45, 0]]), "depths are from 0, one of them above"),
        (_with_path([[-0.04, 8], [0.045, 8]]), "path_mm is 0.085 mm long; .* metres: times 1000"),
        (_with_path([[-40, 0.008], [45, 0.008]]), "path_mm is 0.008 mm deep; .* metres"),
        (_with_path([[-40, 8], [45, 8]], depth_mm=8), "depth_mm and path_mm are both given"),
        (_with_path("x"), "path_mm is 'x'; expected a list"),
        (lambda c: c["operations"][1].update(path_mm=[[0, 1], [9, 1]]), "is for act alone"),
        (lambda c: c["operations"][1].update(height_mm=0.02), "height_mm is 0.02; less than 1 mm"),
        (lambda c: c["operations"][3].update(depth_mm=0.01), "depth_mm is 0.01; less than 0.1 mm"),
        (lambda c: c["operations"][0].update(speed_mm_s=0.2), "speed_mm_s is 0.2; less than 1 mm"),
    ],
)
def test_a_wrong_procedure_is_refused_in_one_line(tmp_path, change, said):
    with pytest.raises(BadFile, match=said) as refused:
        read_procedure(_written(tmp_path, change))
    assert "\n" not in str(refused.value)


def test_files_that_are_no_hand_are_refused(tmp_path):
    with pytest.raises(BadFile, match="no such folder"):
        load_hand(tmp_path / "none")
    with pytest.raises(BadFile, match="holds no limits.yaml"):
        load_hand(tmp_path)
    (tmp_path / "limits.yaml").write_text("effort_nm: 90")
    with pytest.raises(BadFile, match="no action in it"):
        load_hand(tmp_path)
    (tmp_path / "a.yaml").write_text("!!python/object/apply:os.system [exit]")
    with pytest.raises(BadFile, match="not a YAML file"):
        load_hand(tmp_path)
    _written(tmp_path, lambda content: None)
    (tmp_path / "a.yaml").write_text((tmp_path / "poke.yaml").read_text())
    with pytest.raises(BadFile, match="two files for the action poke"):
        load_hand(tmp_path)
    (tmp_path / "a.yaml").unlink()
    (tmp_path / "b.yml").write_text("")
    with pytest.raises(BadFile, match="b.yml would not be read; name it b.yaml"):
        load_hand(tmp_path)
    (tmp_path / "b.yml").unlink()
    (tmp_path / "limits.yaml").write_text("effort_nm: 9\neffort_nm: 900")
    with pytest.raises(BadFile, match="'effort_nm' is given twice"):
        load_hand(tmp_path)
    (tmp_path / "limits.yaml").write_text("low_mm: [1, 1, 1]\nhigh_mm: [0, 0, 0]")
    with pytest.raises(BadFile, match="is not below"):
        load_hand(tmp_path)


_NESTED = ",".join(f"&a{k} [" + ",".join([f"*a{k - 1}" if k else "1"] * 10) + "]" for k in range(9))
LIMITS = {
    "low_mm: [-0.4, -0.4, 0.15]\nhigh_mm: [0.4, 0.4, 0.498]": "is 0.8 mm at most; .* metres: times",
    "speed_mm_s: 0.25": "speed_mm_s is 0.25; less than 1 mm looks like metres",
    f"low_mm: [{_NESTED}]": r"aliases \(\*name\) are not read",
    "".join(f"a{k}: 1\n" for k in range(95_000)): "938,890 bytes; at most 65,536 are read",
    "".join(f"a{k}: 1\n" for k in range(3_000)): "unknown 'a0'",
    "low_mm: " + "[" * 5_000: "recursion",
    "effort_nm: " + "9" * 5_000: "not a YAML file",
    "effort_nm: 2001-99-99": "not a YAML file",
}


@pytest.mark.parametrize("text", LIMITS, ids=[one[:20] for one in LIMITS])
def test_limits_that_would_hang_or_are_in_metres_are_refused(tmp_path, text):
    (tmp_path / "limits.yaml").write_text(text)
    with pytest.raises(BadFile, match=LIMITS[text]) as refused:
        load_hand(tmp_path)
    assert len(str(refused.value)) < 400 + len(str(tmp_path))


def test_a_file_of_the_hand_with_upper_case_letters_is_not_left_out(tmp_path):
    _written(tmp_path, lambda content: None).rename(tmp_path / "POKE.YAML")
    with pytest.raises(BadFile, match="POKE.YAML would not be read; name it POKE.yaml"):
        load_hand(tmp_path)
