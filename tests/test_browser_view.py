"""The viewer in a real browser: it draws, the keyboard moves it, nothing leaves this computer."""

import pytest

from jshape import plan
from jshape.view.read import story_of_plan
from tests.browser import chromium, complaints, outside, until  # noqa: F401 (a fixture)
from tests.stage import PLACES

pytest.importorskip("viser", reason="viser is not installed")

# viser's page loads its panel's picture, docks the panel, and then misses the first picture.
HARMLESS = "blob:"


@pytest.fixture
def viewer(bank, molded):
    from jshape.view.browser import Viewer

    now, goal, _ = molded
    with Viewer(
        story_of_plan(plan(now, goal, bank=bank, positions=PLACES, min_gain=2e-5))
    ) as shown:
        yield shown


def _text(browser):
    from selenium.webdriver.common.by import By

    return browser.find_element(By.TAG_NAME, "body").text


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


def test_it_plays_to_the_end(chromium, viewer):  # noqa: F811
    from selenium.webdriver.common.by import By

    chromium.get(viewer.url)
    until(lambda: "step 0 of 3" in _text(chromium), "the first step")
    chromium.find_element(By.XPATH, "//button[normalize-space()='play']").click()
    until(lambda: viewer.step == 3, "the last step")
    until(lambda: "step 3 of 3" in _text(chromium), "the last step on the page")
