"""The studio's server under requests of other pages: STOP comes through, memory comes back."""

import asyncio
import re
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from pathlib import Path

import pytest

from tests.browser import environment, until
from tests.conftest import ROOT

pytest.importorskip("nicegui", reason="NiceGUI is not installed (extra studio)")


class Served:
    """A running studio whose arm is in a motion that ends when it is stopped."""

    def __init__(self, process, port, folder):
        self.process, self.port, self.folder = process, port, folder
        self.url = f"http://127.0.0.1:{port}"

    def get(self, path="/", **headers):
        """(status, text) of a request."""
        asked = urllib.request.Request(self.url + path, headers=headers)
        try:
            with urllib.request.urlopen(asked, timeout=60) as answer:
                return answer.status, answer.read().decode()
        except urllib.error.HTTPError as problem:
            return problem.code, problem.read().decode()

    @property
    def megabytes(self):
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return int(re.search(r"VmRSS:\s+(\d+)", status).group(1)) / 1024

    def told(self):
        """When the arm was told to stop; None: not yet."""
        file = self.folder / "told"
        first, *rest = (file.read_text() if file.exists() else "").split("\n")
        return float(first) if rest else None  # a file that was opened and not yet written to

    def said(self):
        return (self.folder / "said.txt").read_text()


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    folder = tmp_path_factory.mktemp("served")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with (folder / "said.txt").open("w") as said:
        process = subprocess.Popen(
            [sys.executable, "-m", "tests.studio_stage", str(port), str(folder)], cwd=ROOT,
            stdout=said, stderr=said, env=environment() | {"JAX_PLATFORMS": "cpu"},
        )  # fmt: skip
    try:

        def moving():
            assert process.poll() is None, (folder / "said.txt").read_text()
            with socket.socket() as asked:
                open_ = asked.connect_ex(("127.0.0.1", port)) == 0
            return open_ and (folder / "moving").exists()

        until(moving, "the studio's server", 120)
        yield Served(process, port, folder)
    finally:
        process.terminate()
        process.wait(30)


@pytest.mark.full
def test_stop_is_told_at_once_whatever_other_pages_ask(served):
    status, page = served.get()
    assert status == 200
    port, path = re.search(r"hostname}:(\d+)(/stop/[\w-]+)`", page).groups()
    stop = f"http://127.0.0.1:{port}{path}"
    seen, built = [], []

    def image(k):
        foreign = {"Sec-Fetch-Site": "cross-site", "Referer": "http://evil.example/"}
        seen.append(served.get(f"/{k}.png" if k % 2 else "/", **foreign)[0])

    def page_of_its_own():
        assert served.get()[0] == 200
        built.append(time.monotonic())

    asking = [threading.Thread(target=image, args=(k,)) for k in range(60)]
    own = [threading.Thread(target=page_of_its_own) for _ in range(6)]  # keep the server busy
    held = []
    try:
        for at in (served.port, int(port)):
            for _ in range(20):  # requests that never end
                held.append(socket.create_connection(("127.0.0.1", at)))
                held[-1].sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n")
        for thread in (*own, *asking):
            thread.start()
        assert served.told() is None
        with urllib.request.urlopen(urllib.request.Request(stop, method="POST"), timeout=60) as ok:
            assert ok.read() == b"the arm was told to stop"
        told = until(lambda: served.told(), "the arm", 10)
    finally:
        for thread in (*own, *asking):
            thread.join()
        for one in held:
            one.close()
    assert len(built) == 6
    assert told < max(built)  # in a queue it would have been last
    assert seen == [403] * 60
    assert "Traceback" not in served.said()


@pytest.mark.full
def test_stop_is_for_who_knows_the_path(served):
    _, page = served.get()
    port, path = re.search(r"hostname}:(\d+)(/stop/[\w-]+)`", page).groups()

    def asked(path, **headers):
        try:
            where = f"http://127.0.0.1:{port}{path}"
            with urllib.request.urlopen(urllib.request.Request(where, headers=headers)) as answer:
                return answer.status, answer.headers.get("Access-Control-Allow-Origin")
        except urllib.error.HTTPError as problem:
            return problem.code, problem.headers.get("Access-Control-Allow-Origin")

    assert asked(path, Origin=served.url) == (200, served.url)
    assert asked(path[:-1] + "~", Origin=served.url) == (404, None)
    assert asked("/stop/", Origin="http://evil.example") == (404, None)
    assert asked(path, Host="rebound.example") == (404, None)


@pytest.mark.full
def test_unknown_paths_build_no_page_and_no_page_is_framed(served):
    assert served.get("/anything.png") == (404, "not here")
    with urllib.request.urlopen(served.url + "/favicon.ico", timeout=60) as answer:
        assert answer.headers["X-Frame-Options"] == "DENY"
    for headers in ({"Origin": "http://evil.example"}, {"Host": "rebound.example"}):
        for path in ("/", "/_nicegui_ws/socket.io/?EIO=4&transport=polling"):
            status, text = served.get(path, **headers)
            assert status == 403 and text.startswith("jshape studio: ") and len(text) < 200


@pytest.mark.full
def test_pages_that_are_gone_give_their_memory_back(served):
    def open_pages(count):
        done = 0
        while done < count:
            opened = served.get()[0] == 200
            done += opened
            time.sleep(0.0 if opened else 0.1)

    open_pages(10)
    before = served.megabytes
    open_pages(20)
    assert served.megabytes - before < 60  # 20 pages hold 150


def test_so_many_pages_and_no_more(monkeypatch):
    from nicegui import Client

    from jshape.app import pages

    reached, sent = [], []

    async def app(scope, receive, send):
        reached.append(scope["path"])

    async def send(message):
        sent.append(message)

    door = pages._OriginCheck(app, "127.0.0.1", "jshape studio")

    def ask(path):
        scope = {"type": "http", "path": path, "headers": [(b"host", b"127.0.0.1:1")]}
        asyncio.run(door(scope, None, send))

    monkeypatch.setattr(Client, "prune_instances", lambda **how: None)
    monkeypatch.setattr(Client, "instances", dict.fromkeys(range(pages.MOST_PAGES - 1)))
    ask("/")
    Client.instances["one more"] = None
    ask("/")
    ask("/_nicegui/script.js")
    assert reached == ["/", "/_nicegui/script.js"]
    assert sent[0]["status"] == 503 and b"close one" in sent[1]["body"]
