"""The studio in a real browser: load, draw, plan, step, edit, carry out, annotate."""

import csv
import dataclasses
import socket
import subprocess
import sys
import time

import jax
import numpy as np
import pytest

import jshape
from jshape.data.simulate import simulate_pairs, together
from jshape.io import datasets
from jshape.io.cameras import write_camera
from jshape.io.images import write_depth_png
from jshape.robot.cameras.simulated import levelled_world
from tests.browser import chromium, complaints, environment, outside, until  # noqa: F401
from tests.conftest import ROOT
from tests.studio_stage import EVIL

pytest.importorskip("nicegui", reason="NiceGUI is not installed (extra studio)")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("studio")
    depth = levelled_world(5).look()
    depth = np.where(depth > 0, depth, np.median(depth))
    write_depth_png(folder / "bed.png", depth.astype(np.float32), 0.0001)
    write_camera(folder / "camera.json", jshape.PAPER_BOX, 0.0001)
    pairs = simulate_pairs(jax.random.key(0), 2, actions=("poke",))
    pairs = dataclasses.replace(together(pairs), id=np.array(EVIL[:2]), agent=np.array(EVIL[3:5]))
    datasets.save_pairs(pairs, folder / "pairs")
    return folder


@pytest.fixture(scope="module")
def studio(folder):
    """Address of a running studio."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    words = ["studio", "--no-open", "--port", str(port), "--bank", "flour-robot"]
    words += ["--out", str(folder / "out"), "--dataset", str(folder / "pairs")]
    with (folder / "said.txt").open("w") as said:
        server = subprocess.Popen(
            [sys.executable, "-m", "jshape", *words], cwd=ROOT, stdout=said, stderr=said,
            env=environment() | {"JAX_PLATFORMS": "cpu"},
        )  # fmt: skip

        def listening():
            assert server.poll() is None, (folder / "said.txt").read_text()
            with socket.socket() as asked:
                return asked.connect_ex(("127.0.0.1", port)) == 0

        try:
            until(listening, "the studio's server", 120)
            yield f"http://127.0.0.1:{port}"
        finally:
            server.terminate()
            server.wait(30)


FILES = "input[type=file]"


class Page:
    """The page as a person uses it: by what is written on it, by keys, by the mouse."""

    def __init__(self, browser):
        from selenium.webdriver.common.action_chains import ActionChains
        from selenium.webdriver.common.by import By
        from selenium.webdriver.common.keys import Keys

        self.browser, self.keys = browser, Keys
        self._chain = lambda: ActionChains(browser, duration=50)
        self._css, self._xpath = By.CSS_SELECTOR, By.XPATH

    def named(self, name):
        return self.browser.find_element(self._css, f"[data-name={name}]")

    def text(self, name):
        """What an element says; nothing while it is not there, or is being drawn anew."""
        from selenium.common.exceptions import NoSuchElementException as Missing
        from selenium.common.exceptions import StaleElementReferenceException as Redrawn

        try:
            return self.named(name).text
        except (Missing, Redrawn):
            return ""

    def says(self, words):
        """Whether it stands anywhere; asked in the page, since a notice lasts 5 s only."""
        asked = "return document.body.innerText.includes(arguments[0])"
        return self.browser.execute_script(asked, words)

    def press(self, words):
        """A button or tab with these words on it, or with this label for screen readers."""
        path = (
            f"//button[normalize-space(.)='{words}' or @aria-label='{words}']"
            f" | //*[@role='tab'][normalize-space(.)='{words}']"
            f" | //*[contains(@class, 'q-expansion-item')]//*[normalize-space(text())='{words}']"
            f" | //*[@role='checkbox' and @aria-label='{words}']"
        )
        shown = [e for e in self.browser.find_elements(self._xpath, path) if e.is_displayed()]
        assert shown, f"nothing to press says {words!r}"
        self.click(shown[0])

    def click(self, element):
        """In its middle, once it is in view and stands still: else the click may miss it."""
        self.browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", element)
        before = element.rect
        time.sleep(0.1)
        while before != (before := element.rect):
            time.sleep(0.1)
        element.click()

    def type(self, label, words):
        element = self.field(label)
        element.send_keys(self.keys.CONTROL + "a")
        element.send_keys(words + self.keys.TAB)

    def choose(self, label, option):
        """One of a list's options."""
        field = f"//input[@aria-label='{label}']/ancestor::label"
        path = f"//*[@role='option'][normalize-space(.)='{option}']"

        def shown():
            return [e for e in self.browser.find_elements(self._xpath, path) if e.is_displayed()]

        def opened():  # on a busy machine Quasar now and then leaves a list unplaced and unseen
            self.click(self.browser.find_element(self._xpath, field))  # which this closes again
            end = time.monotonic() + 3
            while time.monotonic() < end and not shown():
                time.sleep(0.1)
            return shown()

        until(opened, "the options")[0].click()

    def field(self, label):
        """Where something is typed."""
        return self.browser.find_element(self._css, f"input[aria-label='{label}']")

    def value(self, label):
        """What stands in a field, read at once; None: it is not shown."""
        fields = "[...document.querySelectorAll(`input[aria-label='${arguments[0]}']`)]"
        shown = f"return {fields}.filter(field => field.offsetParent).map(field => field.value)"
        return next(iter(self.browser.execute_script(shown, label)), None)

    def key(self, key):
        self._chain().send_keys(key).perform()

    def drag(self, name, start, end):
        """From one place of an image to another: shares of its width and height."""
        image = self.named(name)
        self.browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", image)
        size = np.array([image.size["width"], image.size["height"]])
        box = "const box = arguments[0].getBoundingClientRect(); return [box.x, box.y]"
        corner = np.array(self.browser.execute_script(box, image))
        start, end = (corner + np.array(at) * size for at in (start, end))
        chain = self._chain()
        mouse = chain.w3c_actions.pointer_action  # on the screen: the image may be drawn anew
        mouse.move_to_location(*map(int, start)).pointer_down()
        for share in (0.25, 0.5, 0.75, 1.0):
            mouse.move_to_location(*map(int, start + share * (end - start)))
        mouse.pointer_up()
        chain.perform()

    def dragged(self, name, start, end, happened, what):
        """Drag until it has happened: a busy page now and then loses the pointer altogether."""
        ends = time.monotonic() + 60
        while time.monotonic() < ends:
            self.drag(name, start, end)
            soon = time.monotonic() + 15
            while time.monotonic() < soon:
                if happened():
                    return
                time.sleep(0.1)
        pytest.fail(f"waited 60 s for {what}")

    def selected(self):
        """Which line of the plan is marked, read at once: lines are drawn anew."""
        marked = "[...document.querySelectorAll('[data-name^=step-].bg-blue-100')]"
        return self.browser.execute_script(f"return {marked}.map(row => row.dataset.name)")


@pytest.fixture
def page(studio, chromium):  # noqa: F811
    chromium.set_window_size(1366, 900)
    chromium.get(studio)
    page = Page(chromium)
    until(lambda: chromium.find_elements("css selector", "[role=tab]"), "the page")
    yield page
    assert outside(chromium) == []
    assert complaints(chromium) == []


@pytest.mark.full
def test_load_draw_plan_step_edit_and_carry_out(page, folder):
    page.press("Mold")
    until(lambda: "no bed yet" in page.text("where"), "an empty table")
    page.type("depth image on this computer", str(folder / "nowhere.png"))
    page.press("is the bed")
    until(lambda: "nowhere.png" in page.browser.page_source, "the error's line")
    page.type("depth image on this computer", str(folder / "bed.png"))
    page.press("is the bed")
    until(lambda: "bed.png; 0.000 mm from the goal" in page.text("where"), "the bed")

    page.type("brush width", "70")
    page.press("draw")
    drawn = lambda: "; 0.000 mm from" not in page.text("where")  # noqa: E731
    page.dragged("image", (0.3, 0.5), (0.7, 0.5), drawn, "the drawn goal")
    page.press("plan")
    said = until(lambda: " actions, " in page.text("said") and page.text("said"), "a plan", 120)
    count = int(said.split()[0])
    assert count >= 2
    assert until(page.selected, "the selected action") == [f"step-{count}"]
    page.named("said").click()  # off the button: keys are for the page
    page.key(page.keys.ARROW_LEFT)
    until(lambda: page.selected() == [f"step-{count - 1}"], "the action before")
    page.key(page.keys.DELETE)
    until(lambda: page.text("said").startswith(f"{count - 1} actions"), "one action less", 60)
    assert page.text("said") != said
    until(lambda: "plan of 16 actions" in page.text("limit"), "how near any plan can come", 120)
    until(lambda: "of what any plan can cover" in page.text("said"), "how good it is")

    page.press("Carry out")
    until(lambda: page.named("state").is_displayed(), "what carries out")
    page.press("start")
    until(lambda: "Act?" in page.text("state"), "the question", 60)
    page.press("act")
    until(lambda: len(page.text("log").splitlines()) >= 2, "what came out", 180)
    state = until(
        lambda: ("Act?" in page.text("state") or "finished" in page.text("state"))
        and page.text("state"),
        "the next question", 60,
    )  # fmt: skip
    if "Act?" in state:
        page.press("end")
    until(lambda: page.text("state").startswith("finished"), "the end", 60)
    assert (folder / "out" / "run-001" / "summary.json").is_file()
    until(lambda: "A run goes on" not in page.text("hint"), "what to do next")
    page.press("save bed, goal and plan")
    until(lambda: (folder / "out" / "saved" / "goal.png").is_file(), "what is saved")
    page.press("clear")
    until(lambda: "Draw a trench" in page.text("hint") and not page.text("limit"), "a fresh goal")


def reachable(browser):
    """Whether nothing that can be pressed or typed in lies beside the screen."""
    return browser.execute_script(
        "const wide = document.documentElement.clientWidth;"
        "return [...document.querySelectorAll('button, input, img')].filter("
        "  e => e.offsetParent && (e.getBoundingClientRect().right > wide + 1"
        "    || e.getBoundingClientRect().left < -1)).map(e => e.outerHTML.slice(0, 120))"
    )  # fmt: skip


@pytest.mark.full
@pytest.mark.parametrize("tab", ["Mold", "Annotate boxes"])
def test_all_is_on_the_screen_of_a_telephone(page, tab):
    page.browser.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": True},
    )
    page.press(tab)
    page.browser.execute_script("window.scrollTo(0, 0)")
    until(lambda: reachable(page.browser) == [], "all of it to be in view")
    high = page.browser.execute_script("return document.documentElement.scrollHeight")
    assert high > 844  # and the rest is scrolled to


@pytest.mark.full
def test_lengths_carries_and_stock_are_set_and_kept(page):
    page.press("Mold")
    until(lambda: page.value("at most"), "the plan's options")
    assert page.value("stroke lengths") is None and page.value("stock") is None  # f_D of presses
    page.choose("bank", "moving-flour-robot")
    until(lambda: page.value("stroke lengths") == "0.6, 1, 1.6", "what such a bank has", 60)
    page.type("stroke lengths", "1, two")
    until(lambda: page.says("numbers above 0"), "what may stand there")
    page.type("stroke lengths", "1, 1.25")
    page.type("stock", "300")
    page.type("at most", "2")
    until(lambda: not page.says("numbers above 0"), "no complaint")
    page.press("carries")
    until(lambda: not page.field("stock").is_enabled(), "no stock without carries")
    page.press("carries")

    page.browser.refresh()
    until(lambda: page.browser.find_elements("css selector", "[role=tab]"), "the page anew")
    page.press("Mold")
    until(lambda: page.value("stock") == "300", "the page as it was", 60)
    assert page.value("stroke lengths") == "1, 1.25" and page.value("at most") == "2"
    assert page.field("stock").is_enabled()
    page.browser.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": True},
    )
    until(lambda: reachable(page.browser) == [], "all of it to be in view on a telephone")
    page.choose("bank", "flour-robot")  # of the other tests
    until(lambda: page.value("stock") is None, "none of it", 60)


@pytest.mark.full
def test_a_dropped_file_keeps_its_name_and_a_plan_can_be_cancelled(page, folder):
    page.press("Mold")
    (folder / "SAND.PNG").write_bytes((folder / "bed.png").read_bytes())
    (folder / "LETTER.PNG").write_bytes(b"dear")
    (folder / "letter.txt").write_text("dear")

    def drop(name, told, what):  # on the bed: the field is drawn anew after each
        from selenium.common.exceptions import StaleElementReferenceException as Redrawn

        def dropped():
            fields = page.browser.find_elements("css selector", FILES)
            try:
                fields[0].send_keys(str(folder / name))
            except (IndexError, Redrawn):
                return False
            end = time.monotonic() + 15  # what met a field that was being drawn is dropped again
            while not (said := told()) and time.monotonic() < end:
                time.sleep(0.1)
            return said

        until(dropped, what)

    drop("letter.txt", lambda: page.says("allowed are .png"), "what may be dropped")
    drop("LETTER.PNG", lambda: page.says("LETTER.PNG: not an image"), "what is wrong")
    drop("SAND.PNG", lambda: page.says("drop the camera.json"), "whose unit is missing")
    drop("camera.json", lambda: "read with" in page.text("where"), "the camera")
    drop("SAND.PNG", lambda: "bed: SAND.PNG" in page.text("where"), "the bed")
    page.press("clear")
    drawn = lambda: "Press plan" in page.text("hint")  # noqa: E731
    page.dragged("image", (0.3, 0.5), (0.7, 0.5), drawn, "the drawn goal")
    page.press("plan")
    until(lambda: page.text("since"), "the search")
    page.press("cancel")
    until(lambda: page.says("you cancelled it"), "its end")
    assert page.text("said") == "no plan yet"


@pytest.mark.full
def test_annotate(page, folder):
    page.press("Annotate boxes")
    until(lambda: "1 of 2" in page.text("title"), "the first pair")
    assert "box 40x45" in page.text("title")
    assert EVIL[0] in page.text("title") and EVIL[3] in page.text("title")
    assert page.browser.execute_script("return window.pwned") is None
    drawn = lambda: "not saved yet" in page.text("title")  # noqa: E731
    page.dragged("difference", (0.25, 0.25), (0.5, 0.5), drawn, "the drawn box")
    page.key(page.keys.ARROW_RIGHT)
    until(lambda: "2 of 2" in page.text("title"), "the second pair")
    page.key("f")
    until(lambda: "2 not saved" in page.text("title"), "the found box")
    page.key("z")
    until(lambda: "1 not saved" in page.text("title"), "the box put back")
    page.key("s")
    until(lambda: "0 not saved" in page.text("title"), "all saved")
    with (folder / "pairs" / "pairs.csv").open() as file:
        first, second = csv.DictReader(file)
    width, height = int(first["width"]), int(first["height"])
    assert abs(width - 120) <= 3 and abs(height - 99) <= 3
    assert (second["width"], second["height"]) == ("40", "45")
