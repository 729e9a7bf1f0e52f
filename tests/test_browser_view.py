"""The viewer in a real browser: it draws, the keyboard moves it, nothing leaves this computer."""

import contextlib
import dataclasses
import json
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request

import numpy as np
import pytest
from selenium.common.exceptions import WebDriverException

from jshape import PAPER_BOX, metric, plan
from jshape.io import journal, runs
from jshape.io.banks import save_bank
from tests.browser import chromium, complaints, environment, outside, until  # noqa: F401 (a fixture)
from tests.conftest import ROOT, mm, paper
from tests.stage import PLACES
from tests.studio_stage import EVIL

pytest.importorskip("nicegui", reason="NiceGUI is not installed")


@contextlib.contextmanager
def viewing(path):
    """The address of `jshape view`, which serves a plan or a run."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    words = ["view", str(path), "--port", str(port), "--no-open"]
    with open(f"{path}.said", "w") as said:
        server = subprocess.Popen(
            [sys.executable, "-m", "jshape", *words],
            cwd=ROOT,
            stdout=said,
            stderr=said,
            env=environment(),
        )

    def listening():
        assert server.poll() is None, open(f"{path}.said").read()
        with socket.socket() as asked:
            return asked.connect_ex(("127.0.0.1", port)) == 0

    try:
        until(listening, "the viewer's server", 120)
        yield f"http://127.0.0.1:{port}"
    finally:
        server.terminate()
        assert server.wait(30) == 0
        with open(f"{path}.said") as said:
            assert "Traceback" not in said.read()


@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    from tests import conftest

    bank = conftest.bank.__wrapped__()
    now, goal, _ = conftest.molded.__wrapped__(bank)
    now, path = now.copy(), tmp_path_factory.mktemp("view") / "plan.json"
    made = plan(now, goal, bank=bank, **paper(positions=PLACES, min_gain_mm=mm(2e-5)))
    made.to_json(path)
    return made, path


@pytest.fixture(scope="module")
def viewer(planned):
    with viewing(planned[1]) as url:
        yield url


def _text(browser):
    return browser.execute_script("return document.body.innerText")


def _press(browser, words):
    browser.find_element("xpath", f"//button[normalize-space()='{words}']").click()


def _choose(browser, words, shows):
    """Choose what the page shows, until it shows it: a click on a menu that unfolds may miss."""
    option = f"//*[@role='option'][normalize-space()='{words}']"

    def chosen():
        shown = [e for e in browser.find_elements("xpath", option) if e.is_displayed()]
        try:
            if shown:  # at the element itself: at its place may by now be the slider below it
                browser.execute_script("arguments[0].click()", shown[0])
            else:
                browser.find_elements("css selector", "[aria-label=show]")[0].click()
        except WebDriverException:  # it moved, or is drawn anew
            pass
        time.sleep(0.5)
        return shows in _text(browser)

    until(chosen, f"the page with {words!r}")


def _mesh(browser):
    """The positions (395, 480, 3), faces (F, 3) and normals of the bed that is drawn."""
    found = browser.execute_script(
        """
        const scene = document.querySelector("[data-name=scene]");
        const { geometry } = getElement(Number(scene.id.slice(1))).bed.mesh;
        const { position, normal } = geometry.attributes;
        const of = (x) => { let s = ""; new Uint8Array(x.buffer).forEach(
            (b) => (s += String.fromCharCode(b))); return btoa(s); };
        return [of(position.array), of(Uint32Array.from(geometry.index.array)), of(normal.array)];
        """
    )
    import base64

    points, faces, normals = (
        np.frombuffer(base64.b64decode(text), kind)
        for text, kind in zip(found, (np.float32, np.uint32, np.float32), strict=True)
    )
    return points.reshape(395, 480, 3), faces.reshape(-1, 3), normals.reshape(-1, 3)


@pytest.mark.full
def test_the_page_is_moved_by_the_keyboard(chromium, viewer):  # noqa: F811
    from selenium.webdriver import ActionChains, Keys

    chromium.get(viewer)
    until(lambda: "step 0 of 3" in _text(chromium), "the first step")

    def step_at(step):
        until(lambda: f"step {step} of 3" in _text(chromium), f"step {step}")

    chromium.find_element("css selector", "[data-name=title]").click()
    for key, step in ((Keys.ARROW_RIGHT, 1), (Keys.ARROW_RIGHT, 2), (Keys.ARROW_LEFT, 1)):
        ActionChains(chromium).send_keys(key).perform()
        step_at(step)
    chromium.find_element("css selector", "[data-name=step]").click()  # its middle, and the focus
    step_at(2)
    ActionChains(chromium).send_keys(Keys.ARROW_LEFT).perform()  # the slider's own key: one step
    step_at(1)
    assert "mm predicted" in _text(chromium)
    for step in (2, 3):
        _press(chromium, "next")
        step_at(step)
    _press(chromium, "next")  # there is none

    drawn = chromium.find_element("css selector", "[data-name=scene] canvas")
    assert drawn.size["width"] > 600
    _choose(chromium, "bed - goal", "red: too high")
    assert "step 3 of 3" in _text(chromium)
    assert outside(chromium) == [] and complaints(chromium) == []


@pytest.mark.full
def test_it_plays_to_the_end(chromium, viewer):  # noqa: F811
    chromium.get(viewer)
    until(lambda: "step 0 of 3" in _text(chromium), "the first step")
    _press(chromium, "play")
    until(lambda: "step 3 of 3" in _text(chromium), "the last step on the page")


@pytest.mark.full
def test_the_mesh_is_the_bed_of_the_step(chromium, viewer, planned):  # noqa: F811
    """A vertex per pixel, facing who looks, at the predicted depth to the step of a count."""
    made, _ = planned
    chromium.get(viewer)
    until(lambda: "step 0 of 3" in _text(chromium), "the first step")
    for step in (0, 3):
        depth = np.asarray(PAPER_BOX.depth(metric.unweigh(made.images[step], PAPER_BOX)))
        points, faces, normals = until(lambda: _mesh(chromium), "the mesh")
        first = np.asarray(PAPER_BOX.depth(metric.unweigh(made.images[0], PAPER_BOX)))
        level = float(np.median(first))
        size = level * ((479 + 394) / 433) / 2  # the scene's unit: the bed's mean side
        assert len(faces) == 2 * 479 * 394
        assert np.abs(level - points[..., 2] * size - depth).max() < 1e-5
        x = (np.arange(480) - 240.0) / 433.0 * depth
        assert np.abs(points[..., 0] * size - x - (points[0, 0, 0] * size - x[0, 0])).max() < 1e-5
        a, b, c = (points.reshape(-1, 3)[faces[:, k]].astype(float) for k in range(3))
        assert (np.cross(b - a, c - a)[:, 2] > 0).all() and (normals[:, 2] > 0).all()
        for k in range(step + 1, 4):
            _press(chromium, "next")
            until(lambda k=k: f"step {k} of 3" in _text(chromium), f"step {k}")


@pytest.mark.full
def test_a_hostile_run_is_shown_as_text_and_no_face_crosses_a_gap(
    chromium, tmp_path, bank, molded  # noqa: F811
):  # fmt: skip
    now, goal, _ = molded
    first, second = EVIL[0], "$\\frac$" + EVIL[1]
    hostile = dataclasses.replace(bank, actions=(first, second))
    save_bank(hostile, tmp_path / "bank")
    run = runs.Run.create(tmp_path / "run", {"what": EVIL[2], "bank": str(tmp_path / "bank")})
    made = plan(now, goal, bank=hostile, **paper(positions=PLACES, min_gain_mm=mm(2e-5)))
    made.to_json(run.folder / "plan.json")
    doing = {
        "action": first,
        "position": [91, 92],
        "why": EVIL[4],
        "operations": [{"operation": EVIL[3]}],
    }
    journal.note(run.folder / journal.NAME, {"event": "planned", "time": EVIL[3], **doing})
    journal.note(run.folder / journal.NAME, {"event": "acting", "why": EVIL[4]})
    depth = np.full(PAPER_BOX.shape, 0.45)
    depth[100:140, 200:260] = 0.0  # no reading
    run.append(doing, depth)
    ending = {"state": EVIL[3], "why": EVIL[4] + "\x1b[2J", "stop": EVIL[0]}
    (run.folder / "summary.json").write_text(json.dumps(ending))

    with viewing(run.folder) as url:
        chromium.get(url)
        until(lambda: "step 0 of 1" in _text(chromium), "the first step")
        _press(chromium, "next")
        until(lambda: "step 1 of 1" in _text(chromium), "the step with the name")
        text = _text(chromium)
        for evil in (EVIL[0], EVIL[3], EVIL[4], EVIL[2][:30]):
            assert evil in text
        whole = 2 * 479 * 394
        until(lambda: len(_mesh(chromium)[1]) < whole, "the bed with a gap")
        used = np.unique(_mesh(chromium)[1])
        assert (depth.reshape(-1)[used] > 0).all() and len(used) == (depth > 0).sum()
        _choose(chromium, "bed - goal", "red: too high")
        assert chromium.execute_script("return window.pwned") is None
        made_of_it = "return document.querySelectorAll('iframe, [onerror], a[href^=java]').length"
        assert chromium.execute_script(made_of_it) == 0
        assert outside(chromium) == [] and complaints(chromium) == []


@pytest.mark.full
def test_other_pages_are_not_answered(viewer):
    def asked(path="/", **headers):
        try:
            request = urllib.request.Request(viewer + path, headers=headers)
            with urllib.request.urlopen(request, timeout=60) as answer:
                return answer.status, answer.headers.get("X-Frame-Options")
        except urllib.error.HTTPError as problem:
            assert problem.read().startswith((b"jshape view: ", b"not here"))
            return problem.code, None

    assert asked() == (200, "DENY")
    socket_path = "/_nicegui_ws/socket.io/?EIO=4&transport=polling"
    for path in ("/", socket_path):
        for name, value in (
            ("Origin", "http://evil.example"), ("Origin", "null"),
            ("Sec-Fetch-Site", "cross-site"), ("Host", "rebound.example"),
        ):  # fmt: skip
            assert asked(path, **{name: value})[0] == 403, (path, name)
    assert asked("/bed.png")[0] == 404
    assert 503 in [asked()[0] for _ in range(12)]  # so many pages and no more
