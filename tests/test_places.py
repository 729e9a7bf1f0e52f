"""Where actions are tried, and the options of a plan that say so, from end to end."""

import json
import os
import subprocess
import sys
import textwrap

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from jshape import Camera, Status, distance, plan
from jshape.actions import fits, grid
from jshape.errors import BadBank
from jshape.models.bank import Bank
from jshape.models.base import Predictor
from jshape.models.difference import Difference
from jshape.planning.candidates import dense_positions, placed_positions, reachable
from tests.conftest import ROOT, paper

CAMERA = Camera(48, 40, 60.0, 50.0, 24.0, 20.0, 0.42, 0.47)


def bank_of(*sizes, camera=CAMERA):
    def crater(w, h):
        x, y = np.linspace(-2, 2, w), np.linspace(-2, 2, h)[:, None]
        return Difference(jnp.asarray(-0.2 * np.exp(-(x**2) - y**2), jnp.float32))

    return Bank(camera, tuple(crater(*size) for size in sizes), ("knock", "poke")[: len(sizes)])


@pytest.fixture(scope="module")
def bank():
    return bank_of((15, 9), (7, 7))


@pytest.fixture(scope="module")
def images(bank):
    """(I0, I*): smooth hills, and the same after five craters anywhere."""
    rng = np.random.default_rng(1)
    rough = gaussian_filter(rng.normal(size=CAMERA.shape), 3)
    now = np.float32(0.6 + 0.03 * rough / rough.std())
    goal = now.copy()
    for k in rng.integers(2, size=5):
        delta = np.asarray(bank.predictors[k].delta)
        h, w = delta.shape
        v, u = rng.integers(0, [40 - h, 48 - w])
        goal[v : v + h, u : u + w] += np.float32(rng.uniform(0.6, 1.3)) * delta
    return now, goal


@settings(max_examples=40)
@given(
    size=st.tuples(st.integers(1, 48), st.integers(1, 40)), stride=st.sampled_from([1, 2, 3, 7, 40])
)
def test_dense_places_reach_both_ends(size, stride):
    """As many as there can be at that stride, what is left over shared by the two ends."""
    (w, h) = size
    where = dense_positions(bank_of(size), stride)["knock"]
    assert fits(CAMERA, where, size).all()
    for axis, (side, count) in enumerate(((w, 48), (h, 40))):
        line = np.unique(where[:, axis])
        assert (np.diff(line) == stride).all()
        before, behind = line[0] - side // 2, (count - (side - side // 2)) - line[-1]
        assert 0 <= before <= behind <= before + 1 and before + behind < stride
    lines = [len(np.unique(where[:, axis])) for axis in (0, 1)]
    assert len(np.unique(where, axis=0)) == len(where) == lines[0] * lines[1]


def test_each_action_has_places_of_its_own():
    where = dense_positions(bank_of((15, 9), (7, 7)), 1)
    assert len(where["knock"]) == (48 - 15 + 1) * (40 - 9 + 1)
    assert len(where["poke"]) == (48 - 7 + 1) * (40 - 7 + 1)


def test_grids_of_a_bank(bank):
    papers = placed_positions(bank, "paper")
    assert papers.keys() == {"knock", "poke"}
    for where in papers.values():
        np.testing.assert_array_equal(where, grid(CAMERA, margin=(15, 9)))
    given = placed_positions(bank, {"poke": [[10, 12]]})
    np.testing.assert_array_equal(given["poke"], [[10, 12]])
    assert len(given.get("knock", ())) == 0


@pytest.mark.parametrize("kind", [bool, np.uint8, float])
def test_a_mask_says_where_the_hand_goes(kind):
    mask = np.zeros(CAMERA.shape, kind)
    mask[5:9, 10:30] = 1
    free = reachable(CAMERA, mask)
    np.testing.assert_array_equal(free, mask != 0)
    assert reachable(CAMERA, None) is None


@pytest.mark.parametrize("clearance", [5.0, 9.0, 20.0, 33.5])
def test_clearance_is_kept_in_millimetres(clearance):
    """To every pixel that is left out, and to the walls beyond the image; by its definition."""
    mask = np.ones(CAMERA.shape, bool)
    mask[20, 24] = mask[0, 3] = False
    free = reachable(CAMERA, mask, clearance)
    framed = np.pad(mask, 1)
    v, u = np.nonzero(~framed)
    across, along = 1e3 * 0.445 / 60, 1e3 * 0.445 / 50  # mm of a pixel along u and v
    for row in range(40):
        for column in range(48):
            far = np.hypot((v - row - 1) * along, (u - column - 1) * across).min()
            if abs(far - clearance) > 1e-3:
                assert free[row, column] == (far > clearance)
    assert free.any() and not free.all()
    np.testing.assert_array_equal(
        reachable(CAMERA, None, clearance), reachable(CAMERA, np.ones(CAMERA.shape), clearance)
    )


@pytest.mark.full
def test_a_dense_plan_is_finer_than_its_stride(bank, images):
    now, goal = images
    coarse = plan(now, goal, bank=bank, **paper(positions=dense_positions(bank, 8)))
    found = plan(now, goal, bank=bank, **paper(stride=8, strengths=(0.5, 1.0, 1.5)))
    assert 0 < len(found) <= 16 and found.status is Status.NO_IMPROVEMENT
    assert found.distances[-1] < 0.8 * coarse.distances[-1]
    own = {name: where.tolist() for name, where in dense_positions(bank, 8).items()}
    steps = list(zip(found.actions, found.positions.tolist(), strict=True))
    assert any(place not in own[name] for name, place in steps)  # moved
    assert any(s not in (0.5, 1.0, 1.5) for s in found.strengths)
    assert ((found.strengths >= 0.5) & (found.strengths <= 1.5)).all()
    for name, place in steps:
        assert fits(CAMERA, np.array([place]), bank.roi(name)).all()
    again = [distance(image, goal) for image in found.images]
    np.testing.assert_allclose(found.distances, again, rtol=1e-5)
    assert (np.diff(found.distances) < 0).all()


@pytest.mark.full
@pytest.mark.parametrize("planner", ["greedy", "refine"])
def test_a_plan_stays_within_reach(bank, images, planner):
    reach = np.zeros(CAMERA.shape, bool)
    reach[:, 20:] = True
    found = plan(
        *images,
        bank=bank,
        **paper(
            planner=planner, stride=3, reachable=reach, clearance_mm=40.0, strengths=(0.7, 1.0, 1.3)
        ),
    )
    free = reachable(CAMERA, reach, 40.0)
    assert len(found) > 1
    exact = np.rint(found.exact_positions).astype(int)
    assert free[exact[:, 1], exact[:, 0]].all()
    assert not free[:, 24].any() and free[20, 25]  # 5 pixels of 7.4 mm are too few
    if planner == "refine":
        assert found.offsets.any()
        again = [distance(image, images[1]) for image in found.images]
        np.testing.assert_allclose(found.distances, again, rtol=1e-5)


def test_most_and_strengths_hold(bank, images):
    free = plan(*images, bank=bank, **paper(positions="17x13", strengths=(0.5, 1.0, 1.5)))
    most = {name: free.actions.count(name) - 1 for name in set(free.actions)}
    assert max(most.values()) > 0 and set(free.strengths.tolist()) <= {0.5, 1.0, 1.5}
    found = plan(
        *images, bank=bank, **paper(positions="17x13", strengths=(0.5, 1.0, 1.5), max_uses=most)
    )
    assert len(found) and all(found.actions.count(name) <= n for name, n in most.items())
    none = plan(*images, bank=bank, **paper(positions="17x13", max_uses={"knock": 0}))
    assert set(none.actions) == {"poke"}
    same = plan(*images, bank=bank, **paper(positions="17x13", strengths=(1.5, 0.5, 1.0, 0.5)))
    assert same.actions == free.actions  # sorted, and each once


@pytest.mark.full
def test_a_turned_hand_finds_what_lies_across():
    """A crater along v, made by a hand that makes them along u."""
    bank = bank_of((15, 5))
    now = np.full(CAMERA.shape, 0.6, np.float32)
    goal = now.copy()
    delta = np.asarray(bank.predictors[0].delta)
    goal[10:25, 18:23] += np.rot90(delta)
    where = {"knock": np.array([[20, 17], [30, 20], [7, 2]])}  # the last one cannot be turned
    straight = plan(now, goal, bank=bank, **paper(positions=where))
    found = plan(now, goal, bank=bank, **paper(positions=where, yaws=2))
    assert straight.distances[-1] > 0.3 * straight.distances[0]
    assert found.positions[0].tolist() == [20, 17] and found.rois[0].tolist() == [15, 15]
    assert found.yaws[0] == pytest.approx(np.pi / 2)
    assert found.distances[1] < 1e-6
    one = plan(now, goal, bank=bank, **paper(positions=where, yaws={"knock": 1}))
    np.testing.assert_array_equal(one.distances, straight.distances)


@pytest.mark.full
def test_a_hand_too_long_to_turn_in_the_image_is_not_turned():
    narrow = Camera(48, 12, 60.0, 60.0, 24.0, 6.0, 0.42, 0.47)
    bank = bank_of((15, 5), camera=narrow)
    now = np.full(narrow.shape, 0.6, np.float32)
    found = plan(now, now - 0.1, bank=bank, **paper(stride=2, yaws=4))
    assert len(found) and not found.yaws.any()


def test_a_budget_is_kept_and_said(bank, images):
    found = plan(*images, bank=bank, **paper(stride=2, evaluations=300, strengths=(0.7, 1.0)))
    assert found.status is Status.BUDGET and found.evaluations <= 330
    assert found.distances[-1] < found.distances[0]


@pytest.mark.full
def test_an_earlier_plan_is_begun_with(bank, images):
    options = paper(stride=3, strengths=(0.6, 1.0, 1.4), planner="refine") | {"bank": bank}
    first = plan(*images, **options)
    again = plan(*images, start=first, **options)
    assert again.distances[-1] <= first.distances[-1] * (1 + 1e-5)
    rest = plan(first.images[2], images[1], start=first.rest(2), **options)
    assert rest.distances[-1] <= first.distances[-1] * (1 + 1e-4)
    other = plan(*images, start=first, bank=bank, **paper(planner="careful", positions="3x3"))
    assert set(other.strengths.tolist()) <= {1.0}  # none but what this plan may use


def test_nothing_in_reach_is_an_empty_plan(bank, images):
    reach = np.zeros(CAMERA.shape, bool)
    reach[0, 0] = True  # where no ROI fits
    found = plan(*images, bank=bank, **paper(stride=2, reachable=reach))
    assert len(found) == 0 and found.status is Status.NO_IMPROVEMENT


REFUSED = {
    "strengths=[0]": ("JShapeError", "strengths is [0]; "),
    "strengths=[1.0, nan]": ("JShapeError", "strengths is [1.0, nan]"),
    "strengths=['deep']": ("JShapeError", "strengths is ['deep']; "),
    "strengths='1,2'": ("JShapeError", "strengths is '1,2'"),
    "strengths=[]": ("JShapeError", "at least one"),
    "strengths=2.0": ("JShapeError", "strengths is 2.0"),
    "strengths=list(range(1, 70))": ("JShapeError", "at most 64"),
    "yaws=0": ("JShapeError", "yaws is 0; it must be a whole number from 1 to 64"),
    "yaws=1.5": ("JShapeError", "yaws is 1.5"),
    "yaws={'tap': 2}": ("UnknownName", "'tap'; allowed: poke"),
    "strides=4": ("BadOption", "unknown option 'strides'; did you mean stride?"),
    "clip='shift'": ("BadOption", "unknown option 'clip'"),
    "stride=0": ("JShapeError", "stride is 0"),
    "stride=2.0": ("JShapeError", "stride is 2.0"),
    "stride=True": ("JShapeError", "stride is True"),
    "reachable=ones[:-1]": ("BadImage", "reachable has shape (39, 48)"),
    "reachable=ones[None]": ("BadImage", "reachable has shape (1, 40, 48)"),
    "reachable=ones.astype(str)": ("BadImage", "type <U"),
    "reachable=[[1], [1, 1]]": ("BadImage", "rows of different length"),
    "reachable=ones * nan": ("BadImage", "reachable has pixels that are NaN or infinite"),
    "reachable=0 * ones": ("BadImage", "reachable leaves no pixel where"),
    "clearance_mm=500": ("BadImage", "reachable leaves no pixel 500 mm from its ends"),
    "clearance_mm=-1": ("JShapeError", "clearance_mm is -1; it must be a number from 0"),
    "clearance_mm='wide'": ("JShapeError", "clearance_mm is 'wide'"),
    "max_uses={'tap': 1}": ("UnknownName", "'tap'; allowed: poke"),
    "max_uses={'poke': -1}": ("JShapeError", "max_uses of poke is -1"),
    "max_uses={'poke': 1.5}": ("JShapeError", "max_uses of poke is 1.5"),
    "seconds=-1": ("JShapeError", "seconds is -1; it must be a number above 0"),
    "seconds=nan": ("JShapeError", "seconds is nan"),
    "seconds='1'": ("JShapeError", "seconds is '1'"),
    "evaluations=0": ("JShapeError", "evaluations is 0"),
    "evaluations='many'": ("JShapeError", "evaluations is 'many'"),
    "error_margin=-1": ("JShapeError", "error_margin is -1; it must be a number from 0"),
    "stop=3": ("JShapeError", "stop is a int; it must be StopCriteria"),
    "start='plan.json'": ("JShapeError", "start is a str; it must be a Plan"),
    "planner='best'": ("UnknownName", "'best'; allowed: greedy, careful, refine"),
    "positions='3 x 3'": ("BadPosition", "written COLUMNSxROWS"),
}
"""Options, and how they are refused."""


@pytest.fixture(scope="module")
def refusals():
    """What a user, whose types nothing checks, is told: the error's name and its text."""
    code = """
        import json, sys
        import jax.numpy as jnp, numpy as np
        import jshape
        from jshape.models.difference import Difference

        camera = jshape.Camera(48, 40, 60.0, 60.0, 24.0, 20.0, 0.42, 0.47)
        bank = jshape.Bank(camera, (Difference(jnp.ones((7, 7)) / 8),), ("poke",))
        image, ones, nan = np.full(camera.shape, 0.5, np.float32), np.ones(camera.shape), np.nan
        told = {}
        for options in json.load(sys.stdin):
            try:
                eval(f"jshape.plan(image, image + 0.1, bank=bank, **jshape.options({options}))")
                told[options] = "nothing", ""
            except Exception as error:
                told[options] = type(error).__name__, str(error)
        print(json.dumps(told))
    """
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", textwrap.dedent(code)],
        input=json.dumps(list(REFUSED)), capture_output=True, text=True, timeout=300,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.full
@pytest.mark.parametrize("options", REFUSED)
def test_bad_options_are_refused_in_one_line(refusals, options):
    (name, text), (error, words) = refusals[options], REFUSED[options]
    assert (name, "\n" in text) == (error, False)
    assert words in text


def test_a_bank_that_cannot_turn_says_so(bank, images):
    class Fixed(Predictor):
        """A predictor of its own kind, without `turned`."""

        roi = (7, 7)

        def __call__(self, roi, corner, strength=1.0):
            return roi

    fixed = Bank(CAMERA, (Fixed(),), ("poke",), "X")
    with pytest.raises(BadBank, match="kind 'X' cannot turn the hand; yaws must be 1"):
        plan(*images, bank=fixed, **paper(yaws=2))
