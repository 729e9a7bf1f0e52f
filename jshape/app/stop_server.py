"""STOP by a way of its own: a small server in its own thread, which nothing else keeps waiting.

The page's server builds pages, for most of a second each: what comes behind that comes too late.
"""

import secrets
import socket
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from jshape.app.ports import refused
from jshape.errors import JShapeError

REQUEST_TIMEOUT = 2.0
"""Seconds in which a request must have come whole."""


class StopServer(ThreadingHTTPServer):
    """Stops the arm for whoever knows the path, which only the studio's own pages are told."""

    daemon_threads = True
    request_queue_size = 256  # of the usual 5, a browser's waiting requests fill it

    def __init__(self, stop: Callable[[], str], host: str, page_port: int):
        """Listen at the port after the page's, or at any if that is not free.

        `stop` is called in any thread and says what came of it.
        """
        self.stop, self.host = stop, host
        self.path = "/stop/" + secrets.token_urlsafe(16)
        """Post to it to stop; get it to see whether that would be heard."""
        self.address_family = socket.AF_INET6 if ":" in host else socket.AF_INET
        try:
            super().__init__((host, page_port + 1), _Handler)
        except (OSError, OverflowError):
            try:
                super().__init__((host, 0), _Handler)
            except OSError as problem:
                raise JShapeError(f"STOP cannot listen at {host}: {problem}") from None
        threading.Thread(target=self.serve_forever, name="STOP", daemon=True).start()

    def __exit__(self, *problem: Any) -> None:
        self.shutdown()
        super().__exit__(*problem)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Nothing is said of a connection that breaks off."""

    @property
    def script(self) -> str:
        """HTML for a page's head: Escape, and a press on what is named "stop", stop the arm.

        Both also go the page's own way, since this one may be barred: a tunnel carries one port.
        """
        port = str(self.server_address[1])
        return _SCRIPT.replace("PORT", port).replace("PATH", self.path)


class _Handler(BaseHTTPRequestHandler):
    server: StopServer
    timeout = REQUEST_TIMEOUT

    def do_POST(self) -> None:
        self._answer(self.server.stop)

    def do_GET(self) -> None:
        self._answer(lambda: "STOP is heard")

    def _answer(self, work: Callable[[], str]) -> None:
        headers = {name.lower(): value for name, value in self.headers.items()}
        # The page is of another port, so of another origin: the path is what proves it.
        from_page = {"host": headers.get("host", "")}
        known = secrets.compare_digest(self.path.encode(), self.server.path.encode())
        heard = known and refused(from_page, self.server.host) is None
        said = (work() if heard else "not here").encode()
        self.send_response(200 if heard else 404)
        if heard and "origin" in headers:
            self.send_header("Access-Control-Allow-Origin", headers["origin"])
        self.send_header("Content-Type", "text/plain; charset=utf-8")
        self.send_header("Content-Length", str(len(said)))
        self.end_headers()
        self.wfile.write(said)

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing on the console."""


_SCRIPT = """
<script>
(() => {
  const url = `http://${location.hostname}:PORTPATH`;
  const bar = said => document.documentElement.dataset.stop = said;
  fetch(url).then(answer => bar(answer.ok ? "own way" : "slow way")).catch(() => bar("slow way"));
  const stop = async () => {
    try {
      const message = await (await fetch(url, {method: "POST", keepalive: true})).text();
      Quasar.Notify.create({message, type: "warning"});
    } catch { bar("slow way"); }
  };
  addEventListener("keydown", event => event.key === "Escape" && !event.repeat && stop(), true);
  addEventListener("click", event => event.target.closest?.("[data-name=stop]") && stop(), true);
})();
</script>
<style>
html[data-stop="slow way"] [data-name=stop]::after { content: " (slow: its port is barred)"; }
</style>
"""
