"""Plans on disk: there and back to the last bit, and nothing damaged is read."""

import base64
import io
import json
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jshape import Camera, Plan, Status
from jshape.data.view import View
from jshape.errors import BadFile, JShapeError
from jshape.height_map import as_frame, looking_down
from jshape.planning import plan_file as plans
from jshape.planning.plan_file import plan_fields, write_plan

CAMERA = Camera(40, 30, 50.0, 50.0, 19.5, 14.5, 0.4, 0.5)
WHOLE = Camera(60, 50, 50.0, 50.0, 29.5, 24.5, 0.4, 0.5)
HIGHER = as_frame(looking_down(0.55))
ROIS = [(12, 9), (4, 5)]
STEP_NUMBERS = (
    *("positions", "offsets", "exact_positions", "rois", "strengths", "yaws", "lengths", "strokes"),
    *("distances", "distances_mm", "clipped"),
)


@pytest.fixture
def plan(rng):
    def image(w, h):
        return rng.uniform(0, 1, (h, w)).astype(np.float32)

    return Plan(
        camera=CAMERA,
        actions=("grasp", "poke/ é"),
        positions=np.array([[10, 9], [37, 27]], np.int32),
        rois=np.array(ROIS, np.int32),
        distances=np.array([0.3, 0.2, 0.1], np.float32),
        status=Status.NO_IMPROVEMENT,
        evaluations=60,
        seconds=0.1 + 0.2,
        strengths=np.array([0.1, 1.6], np.float32),
        yaws=np.array([-np.pi, np.pi / 3], np.float32),
        offsets=np.array([[-1.0, 0.3], [0.0, 1e-7]], np.float32),
        lengths=np.array([0.6, 1.0], np.float32),
        strokes=np.array([[-40.25, 12.5], [0.0, 0.0]], np.float32),
        clipped=np.array([0.0, 0.25], np.float32),
        filled=(3, 4),
        clamped=(5, 0),
        initial=image(40, 30),
        goal=image(40, 30),
        patches=tuple(image(w, h) for w, h in ROIS),
    )


@pytest.fixture
def path(plan, tmp_path):
    write_plan(tmp_path / "plan.json", plan)
    return tmp_path / "plan.json"


def same(a, b):
    for name in (
        "actions",
        "status",
        "evaluations",
        "seconds",
        "filled",
        "clamped",
        "camera",
        "view",
    ):
        assert getattr(a, name) == getattr(b, name), name
    for name in STEP_NUMBERS:
        x, y = getattr(a, name), getattr(b, name)
        np.testing.assert_array_equal(x, y)
        assert x.dtype == y.dtype and x.shape == y.shape
    for x, y in zip((a.initial, a.goal, *a.patches), (b.initial, b.goal, *b.patches), strict=True):
        np.testing.assert_array_equal(x, y)


def refused(path, match):
    with pytest.raises(BadFile) as info:
        Plan.from_json(path)
    message = str(info.value)
    assert message.startswith(f"{path}: ") and match in message
    assert "\n" not in message and len(message) < len(str(path)) + 300


def test_round_trip(plan, path):
    found = Plan.from_json(path)
    same(found, plan)
    np.testing.assert_array_equal(found.images, plan.images)
    fields = json.loads(path.read_text())
    del fields["images"]
    assert fields == plan_fields(plan)
    assert fields["steps"][0]["camera_position"] == [10, 9] and fields["view"] is None


@pytest.mark.parametrize(
    "view",
    [
        View(WHOLE, CAMERA, (10, 10)),
        View(replace(WHOLE, fx=40.0), replace(CAMERA, pose=HIGHER)),
        View(replace(WHOLE, pose=HIGHER), replace(CAMERA, orthographic=True, fx=90.0, fy=90.0)),
    ],
    ids=["window", "looked at again", "from above"],
)
def test_a_view_comes_back(plan, tmp_path, view):
    plan = replace(plan, view=view, camera=view.target)
    write_plan(tmp_path / "plan.json", plan)
    found = Plan.from_json(tmp_path / "plan.json")
    same(found, plan)
    np.testing.assert_array_equal(found.camera_positions, plan.camera_positions)
    steps = json.loads((tmp_path / "plan.json").read_text())["steps"]
    assert [s["camera_position"] for s in steps] == plan.camera_positions.tolist()
    assert view.window is None or steps[0]["camera_position"] == [20, 19]


def test_without_images_or_steps(plan, tmp_path):
    path = tmp_path / "plan.json"
    write_plan(path, plan, images=False)
    same(Plan.from_json(path), replace(plan, initial=None, goal=None, patches=()))
    none = np.zeros((0, 2), np.int32)
    empty = replace(
        plan, actions=(), positions=none, rois=none, patches=(), clipped=np.zeros(0, np.float32),
        distances=np.zeros(1, np.float32), goal=None, strengths=np.zeros(0, np.float32),
        yaws=np.zeros(0, np.float32), offsets=np.zeros((0, 2), np.float32),
    )  # fmt: skip
    write_plan(path, empty)
    same(Plan.from_json(path), empty)


def test_a_plan_of_before_goals_and_views_is_read(plan, path):
    fields = json.loads(path.read_text())
    del fields["clamped"], fields["view"], fields["seconds"]
    for step in fields["steps"]:
        for name in ("camera_position", "strength", "yaw", "offset", "length", "stroke"):
            del step[name]
    path.write_text(json.dumps(fields))
    usual = {"strengths": np.ones(2, np.float32), "yaws": np.zeros(2, np.float32)}
    usual |= {"offsets": np.zeros((2, 2), np.float32), "seconds": 0.0}
    usual |= {"lengths": np.ones(2, np.float32), "strokes": np.zeros((2, 2), np.float32)}
    same(Plan.from_json(path), replace(plan, clamped=(0, 0), **usual))


def test_the_least_and_greatest_numbers_come_back(plan, path):
    """A half turn is more than pi in 32 bits; the least strength is hardly one."""
    strengths = np.array([1e-45, np.finfo(np.float32).max], np.float32)
    yaws = np.array([np.pi, -np.pi], np.float32)
    extreme = replace(plan, strengths=strengths, yaws=yaws, offsets=np.ones((2, 2), np.float32))
    write_plan(path, extreme)
    same(Plan.from_json(path), extreme)


def test_the_square_of_a_turned_hand_is_inside_too(plan, path):
    """The 12x9 ROI at (10, 5) is inside the image; the 12x12 one of the hand turned is not."""
    square = replace(plan, rois=np.array([[12, 12], [4, 5]], np.int32))
    square = replace(square, positions=np.array([[10, 5], [37, 27]], np.int32))
    write_plan(path, square, images=False)
    refused(path, "step 1: its ROI leaves the 40x30 image")


def step(**change):
    return lambda f: {"steps": [f["steps"][0] | change, f["steps"][1]]}


def view(**change):
    fields = {"source": plans.camera_fields(WHOLE), "window": [10, 10]}
    return {"view": fields | change}


BIG = 2**70
SPOILED = [
    ({"format": "x"}, "expected 'jshape-plan'"),
    ({"version": 2}, "version 2 is newer than this program reads (1)"),
    ({"version": True}, "version is True"),
    ({"steps": None}, "missing steps"),
    ({"steps": {}}, "steps is {}; expected a list"),
    ({"steps": [1, 2]}, "step 1: is 1; expected an object"),
    (step(action={"a": 1}), "step 1: action is {'a': 1}; expected a line of text"),
    (step(action=None), "step 1: action is None"),
    (step(action=""), "step 1: action is ''; expected a line of text"),
    (step(action="\x1b[2Jpoke"), r"step 1: action is '\x1b[2Jpoke'; expected a line of text"),
    (step(position=[BIG, 9]), "step 1: its ROI leaves the 40x30 image"),
    (step(position=[-BIG, 9]), "step 1: position is [-"),
    (step(position=[10.9, 9]), "step 1: position is [10.9, 9]; expected 2 whole numbers"),
    (step(position=[10.0, 9]), "position is [10.0, 9]"),
    (step(position=["10", 9]), "position is ['10', 9]"),
    (step(position=[True, 9]), "position is [True, 9]"),
    (step(position=[10, 9, 8]), "position is [10, 9, 8]"),
    (step(position=10), "position is 10"),
    (step(position=None), "position is None"),
    (step(position=[0, 0]), "its ROI leaves"),
    (step(position=[35, 9]), "its ROI leaves"),
    (step(roi=[0, 9]), "roi is [0, 9]; expected 2 whole numbers, each a whole number from 1"),
    (step(roi=[-12, 9]), "roi is"),
    (step(roi=[BIG, 9]), "its ROI leaves"),
    (step(roi=[12.5, 9]), "roi is [12.5, 9]"),
    (step(roi=[13, 9]), "images: patch_0 is float32 of shape (9, 12); expected float32 of (9, 13)"),
    (step(camera_position=[1.5, 2]), "camera_position is [1.5, 2]"),
    (step(camera_position="here"), "camera_position is 'here'"),
    (step(strength=0), "step 1: strength is 0; expected a number from 1.4"),
    (step(strength=-1.0), "strength is -1.0"),
    (step(strength=1e-50), "strength is 1e-50"),
    (step(strength=1e39), "strength is 1e+39"),
    (step(strength=10**400), "strength is 1000"),
    (step(strength="1"), "strength is '1'"),
    (step(strength=True), "strength is True"),
    (step(strength=None), "strength is None"),
    (step(yaw=3.2), "step 1: yaw is 3.2; expected a number from -3.14159 to 3.14159"),
    (step(yaw=-4), "yaw is -4"),
    (step(yaw=[0]), "yaw is [0]"),
    (step(yaw=None), "yaw is None"),
    (
        step(offset=[0.0, 1.01]),
        "step 1: offset is [0.0, 1.01]; expected 2 numbers, each a number from -1 to 1",
    ),
    (step(offset=[-2, 0]), "offset is [-2, 0]"),
    (step(offset=[0.0]), "offset is [0.0]; expected 2 numbers"),
    (step(offset=[0.0, 0.0, 0.0]), "offset is [0.0, 0.0, 0.0]"),
    (step(offset=["0", 0.0]), "offset is ['0', 0.0]"),
    (step(offset=0.0), "offset is 0.0"),
    (step(offset=None), "offset is None"),
    (step(clipped=-0.1), "clipped is -0.1; expected a number from 0 to 1"),
    (step(clipped=BIG), "clipped is"),
    (step(clipped="0"), "clipped is '0'"),
    (step(clipped=False), "clipped is False"),
    ({"distances": [0.1]}, "has 1 distances; 2 steps need 3"),
    ({"distances": 3}, "distances is 3"),
    ({"distances": [0.3, -0.2, 0.1]}, "distance 2 is -0.2"),
    ({"distances": [0.3, "0.2", 0.1]}, "distance 2 is '0.2'"),
    ({"distances": [0.3, 1e300, 0.1]}, "distance 2 is 1e+300"),
    ({"distances": [0.3, 10**4000, 0.1]}, "distance 2 is 1000"),
    ({"status": "HAPPY"}, "status is 'HAPPY'; allowed: CONVERGED"),
    ({"status": ["CONVERGED"]}, "status is ['CONVERGED']"),
    ({"evaluations": 1.5}, "evaluations is 1.5"),
    ({"evaluations": -1}, "evaluations is -1"),
    ({"seconds": -0.1}, "seconds is -0.1"),
    ({"seconds": "1"}, "seconds is '1'"),
    ({"seconds": None}, "seconds is None"),
    ({"filled": [1]}, "filled is [1]"),
    ({"filled": None}, "filled is None"),
    ({"filled": [1, -1]}, "filled is [1, -1]"),
    ({"clamped": [0.5, 1]}, "clamped is [0.5, 1]"),
    ({"camera": None}, "missing camera"),
    ({"camera": [1]}, "camera is [1]; expected an object"),
    ({"camera": {"width": 40}}, "camera: missing height"),
    ({"view": 3}, "view: is 3; expected an object"),
    ({"view": {}}, "view: missing source"),
    (view(source={"width": 1}), "view: source: missing"),
    (view(window=[21, 10]), "view: its window leaves the 60x50 image"),
    (view(window=[BIG, 10]), "view: its window leaves"),
    (view(window=[-1, 10]), "view: window is [-1, 10]"),
    (view(window="all"), "view: window is 'all'"),
    (
        view(source=plans.camera_fields(WHOLE) | {"pose": [[1]]}),
        "view: source: pose is [[1]]",
    ),
    ({"images": 3}, "images is 3; expected text"),
    ({"images": ""}, "images: not a readable NPZ"),
    ({"images": "AAA"}, "images: not base64"),
    ({"images": "é"}, "images: not base64"),
    ({"images": "AAAA"}, "images: not a readable NPZ"),
]


@pytest.mark.parametrize("name", ["strength", "yaw", "seconds", "clipped"])
@pytest.mark.parametrize("value", ["NaN", "Infinity", "-Infinity"])
def test_what_is_not_finite_is_refused(path, name, value):
    text = path.read_text()
    at = text.index(f'"{name}": ') + len(name) + 4
    end = min(k for k in (text.find(mark, at) for mark in ",}\n") if k > 0)
    path.write_text(text[:at] + value + text[end:])
    with pytest.raises(BadFile, match=rf"^{path}: "):
        Plan.from_json(path)


@pytest.mark.parametrize("change, match", SPOILED, ids=[match for _, match in SPOILED])
def test_a_spoiled_plan_is_refused(path, change, match):
    fields = json.loads(path.read_text())
    fields |= change(fields) if callable(change) else change
    if match.startswith("missing"):
        fields = {k: v for k, v in fields.items() if v is not None}
    path.write_text(json.dumps(fields))
    refused(path, match)


def pack(path, content=None, **arrays):
    if content is None:
        stream = io.BytesIO()
        np.savez_compressed(stream, **arrays)
        content = stream.getvalue()
    fields = json.loads(path.read_text())
    path.write_text(json.dumps(fields | {"images": base64.b64encode(content).decode()}))


@pytest.mark.parametrize("name", ["initial", "goal", "patch_1"])
def test_bad_images_are_refused(plan, path, name):
    good = {"initial": plan.initial, "goal": plan.goal}
    good |= {f"patch_{k}": patch for k, patch in enumerate(plan.patches)}
    pack(path, **good)
    same(Plan.from_json(path), plan)
    nan = good[name].copy()
    nan[1, 1] = np.nan
    for bad, match in (
        (nan, f"images: {name} holds NaN or infinity"),
        (good[name].astype(np.float64), f"images: {name} is float64 of shape"),
        (good[name].astype(np.uint8), f"images: {name} is uint8"),
        (good[name].astype("S1"), "images: not a readable NPZ"),
        (good[name].astype(object), "images: not a readable NPZ"),
        (good[name][1:], f"images: {name} is float32 of shape"),
        (good[name][None], f"images: {name} is float32 of shape (1, "),
    ):
        pack(path, **good | {name: bad})
        refused(path, match)
    pack(path, **{k: v for k, v in good.items() if k != name})
    if name != "goal":
        refused(path, f"images: has no {name}")


def test_images_that_unpack_too_far_are_refused(plan, path):
    pack(path, initial=np.zeros((3000, 4000), np.float32))
    assert path.stat().st_size < 100_000
    refused(path, "images: unpacks to 48,000,128 bytes; at most 35,")
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("initial.npy", bytes(10**7))
    # Both headers of the member say that it is small.
    content = stream.getvalue().replace((10**7).to_bytes(4, "little"), (64).to_bytes(4, "little"))
    pack(path, content)
    refused(path, "images: not a readable NPZ")


@settings(max_examples=150)
@given(st.data())
def test_a_flipped_byte_never_escapes_as_another_error(tmp_path_factory, data):
    """In the packed images: zlib, zipfile and NumPy have a dozen ways to fail."""
    image = np.linspace(0, 1, 1200, dtype=np.float32).reshape(30, 40)
    none = np.zeros((0, 2), np.int32)
    plan = Plan(
        CAMERA, (), none, none, np.zeros(1, np.float32), Status.CONVERGED, initial=image, goal=image
    )
    path = tmp_path_factory.getbasetemp() / "flipped.json"
    write_plan(path, plan)
    content = bytearray(base64.b64decode(json.loads(path.read_text())["images"]))
    # A stored member has its header in the clear, where NumPy parses it as Python.
    if data.draw(st.booleans()):
        stream = io.BytesIO()
        np.savez(stream, initial=image, goal=image)
        content = bytearray(stream.getvalue())
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, min(len(content), 400) - 1) | st.integers(-200, -1))
        content[at] ^= data.draw(st.integers(1, 255))
    pack(path, bytes(content))
    try:
        found = Plan.from_json(path)
    except JShapeError as problem:
        assert isinstance(problem, BadFile) and "\n" not in str(problem)
    else:
        assert found.initial.shape == CAMERA.shape
