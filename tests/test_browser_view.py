"""The viewer in a real browser: it draws, the keyboard moves it, nothing leaves this computer."""

import dataclasses
import json

import numpy as np
import pytest

from jshape import PAPER_BOX, plan
from jshape.app.view.read import read_story, story_of_plan
from jshape.io import journal, runs
from jshape.io.banks import save_bank
from tests.browser import chromium, complaints, outside, until  # noqa: F401 (a fixture)
from tests.conftest import mm, paper
from tests.stage import PLACES
from tests.studio_stage import EVIL

pytest.importorskip("viser", reason="viser is not installed")

# viser's page loads its panel's picture, docks the panel, and then misses the first picture.
HARMLESS = "blob:"


@pytest.fixture
def viewer(bank, molded):
    from jshape.app.view.browser import Viewer

    now, goal, _ = molded
    with Viewer(
        story_of_plan(plan(now, goal, bank=bank, **paper(positions=PLACES, min_gain_mm=mm(2e-5))))
    ) as shown:
        yield shown


def _text(browser):
    from selenium.webdriver.common.by import By

    return browser.find_element(By.TAG_NAME, "body").text


@pytest.mark.full
def test_the_page_is_moved_by_the_keyboard(chromium, viewer):  # noqa: F811
    from selenium.webdriver.common.by import By
    from selenium.webdriver.common.keys import Keys

    chromium.get(viewer.url)
    until(lambda: "step 0 of 3" in _text(chromium), "the first step")
    sliders = chromium.find_elements(By.CSS_SELECTOR, "[role=slider]")
    assert sliders and viewer.step == 0
    for key, step in ((Keys.ARROW_RIGHT, 1), (Keys.ARROW_RIGHT, 2), (Keys.ARROW_LEFT, 1)):
        sliders[0].send_keys(key)
        until(lambda step=step: viewer.step == step, f"step {step} in the program")
        until(lambda step=step: f"step {step} of 3" in _text(chromium), f"step {step} on the page")
    assert "mm predicted" in _text(chromium)

    button = chromium.find_element(By.XPATH, "//button[normalize-space()='next']")
    button.click()
    until(lambda: viewer.step == 2, "the button's step")
    button.click()
    button.click()
    until(lambda: viewer.step == 3, "the last step")

    drawn = chromium.find_element(By.TAG_NAME, "canvas")
    assert drawn.size["width"] > 600
    viewer.shown = "bed - goal"
    until(lambda: "bed - goal" in chromium.page_source, "another choice on the page")
    assert outside(chromium) == []
    assert [said for said in complaints(chromium) if HARMLESS not in said] == []


@pytest.mark.full
def test_it_plays_to_the_end(chromium, viewer):  # noqa: F811
    from selenium.webdriver.common.by import By

    chromium.get(viewer.url)
    until(lambda: "step 0 of 3" in _text(chromium), "the first step")
    chromium.find_element(By.XPATH, "//button[normalize-space()='play']").click()
    until(lambda: viewer.step == 3, "the last step")
    until(lambda: "step 3 of 3" in _text(chromium), "the last step on the page")


@pytest.mark.full
def test_a_hostile_run_is_shown_as_text(chromium, tmp_path, bank, molded):  # noqa: F811
    from jshape.app.view.browser import Viewer

    now, goal, _ = molded
    first, second = EVIL[0], "$\\frac$" + EVIL[1]
    hostile = dataclasses.replace(bank, actions=(first, second))
    save_bank(hostile, tmp_path / "bank")
    run = runs.Run.create(tmp_path / "run", {"what": EVIL[2], "bank": str(tmp_path / "bank")})
    made = plan(now, goal, bank=hostile, **paper(positions=PLACES, min_gain_mm=mm(2e-5)))
    made.to_json(run.folder / "plan.json")
    doing = {"action": first, "position": [91, 92], "why": EVIL[4], "operations": [EVIL[3]]}
    journal.note(run.folder / journal.NAME, {"event": "planned", "time": EVIL[3], **doing})
    journal.note(run.folder / journal.NAME, {"event": "acting", "why": EVIL[4]})
    run.append(doing, np.full(PAPER_BOX.shape, 0.45))
    ending = {"state": EVIL[3], "why": EVIL[4] + "\x1b[2J", "stop": EVIL[0]}
    (run.folder / "summary.json").write_text(json.dumps(ending))

    with Viewer(read_story(run.folder)) as shown:
        chromium.get(shown.url)
        until(lambda: "step 0 of 1" in _text(chromium), "the first step")
        shown.step = 1
        until(lambda: "step 1 of 1" in _text(chromium), "the step with the name")
        text = _text(chromium)
        for evil in (EVIL[0], EVIL[3], EVIL[4], EVIL[2][:30]):
            assert evil in text
        shown.shown = "bed - goal"
        assert chromium.execute_script("return window.pwned") is None
        made_of_it = "return document.querySelectorAll('iframe, [onerror], a[href^=java]').length"
        assert chromium.execute_script(made_of_it) == 0
        assert outside(chromium) == []


def test_other_pages_are_not_answered(viewer, monkeypatch):
    import viser
    from websockets.exceptions import InvalidStatus
    from websockets.sync.client import connect

    from jshape.app.view import door

    where = viewer.url.replace("http", "ws")

    def opened(url=where, **more):
        # Without the client's own limit, which a bed in 3-D exceeds: it would close.
        return connect(url, subprotocols=[f"viser-v{viser.__version__}"], max_size=None, **more)

    with opened(origin=viewer.url):
        for more in (
            {"origin": "http://evil.example"}, {"origin": "null"},
            {"url": where + "/?websocket=ws://evil.example"},
            {"additional_headers": {"Sec-Fetch-Site": "cross-site"}},
        ):  # fmt: skip
            with pytest.raises(InvalidStatus, match="403"):
                opened(**more)
        monkeypatch.setattr(door, "MOST_PAGES", 1)
        with pytest.raises(InvalidStatus, match="503"):
            opened()


def test_a_viser_that_serves_otherwise_is_refused():
    from jshape.app.view.door import door
    from jshape.errors import JShapeError

    with pytest.raises(JShapeError, match="cannot be told whom to answer"), door("127.0.0.1"):
        pass
