"""A real browser without a screen, for tests of pages; skips where there is none.

def test_a_page(chromium):
    chromium.get(url)
    ...
    assert outside(chromium) == [] and complaints(chromium) == []
"""

import json
import os
import shutil
import time
from urllib.parse import urlsplit

import pytest

FLAGS = (
    "--headless=new", "--no-sandbox", "--window-size=1500,950", "--hide-scrollbars",
    # WebGL in software.
    "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist",
    # What the browser itself would ask the network for.
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--no-first-run", "--disable-default-apps",
)  # fmt: skip
OWN = {"127.0.0.1", "localhost", "[::1]", "::1"}
"""Hosts that are this computer."""


def open_chromium(*more):
    """A Chromium driven by selenium; skips the test where there is none."""
    webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed")
    from selenium.webdriver.chrome.service import Service

    program = shutil.which("chromium") or shutil.which("chromium-browser")
    driver = shutil.which("chromedriver")
    if program is None or driver is None:
        pytest.skip("chromium and chromedriver are not here (Debian: chromium chromium-driver)")
    options = webdriver.ChromeOptions()
    options.binary_location = program
    for flag in (*FLAGS, *more):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"performance": "ALL", "browser": "ALL"})
    return webdriver.Chrome(options=options, service=Service(driver))


@pytest.fixture
def chromium():
    """A fresh browser, closed after the test."""
    browser = open_chromium()
    yield browser
    browser.quit()


def environment():
    """That of a program whose pages are tested: NiceGUI behaves otherwise where pytest runs it."""
    return {name: value for name, value in os.environ.items() if not name.startswith("PYTEST")}


def outside(browser):
    """Addresses that pages asked for since the last call and that are not on this computer."""
    found = []
    for row in browser.get_log("performance"):
        message = json.loads(row["message"])["message"]
        asked = message["params"]
        url = asked.get("request", {}).get("url") or asked.get("url", "")
        sent = ("Network.requestWillBeSent", "Network.webSocketCreated")
        if message["method"] not in sent or not url.startswith(("http", "ws")):
            continue
        if urlsplit(url).hostname not in OWN:
            found.append(url)
    return found


def complaints(browser):
    """Errors that pages wrote to the console since the last call."""
    return [row["message"] for row in browser.get_log("browser") if row["level"] == "SEVERE"]


def _replaced():
    """Selenium's error of an element that is no longer in the page; none without selenium."""
    try:
        from selenium.common.exceptions import StaleElementReferenceException
    except ImportError:
        return ()
    return StaleElementReferenceException


def until(happened, what, seconds=60.0):
    """What `happened()` gives once it is true; fails saying `what` was waited for.

    An element that the page replaced between being found and being asked is asked for again.
    """
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        try:
            if value := happened():
                return value
        except _replaced():
            pass
        time.sleep(0.1)
    pytest.fail(f"waited {seconds:g} s for {what}")
