"""The studio's page and its server."""

from pathlib import Path

from nicegui import app, ui
from starlette.middleware.trustedhost import TrustedHostMiddleware

from jshape.studio.annotate_page import AnnotatePage
from jshape.studio.bench import Bench
from jshape.studio.desk import Desk
from jshape.studio.mold_page import MoldPage

LOCAL = ("127.0.0.1", "localhost", "::1")
"""Hosts that only this computer reaches."""


def serve(
    desk: Desk, bench: Bench, dataset: Path | None, *, host: str, port: int, show: bool
) -> None:
    """Serve until it is interrupted.

    Args:
      desk: what people work on; the same in every tab of every browser.
      bench: the robot and the folder.
      dataset: opened in the tab for annotation.
      host: to listen at.
      port: likewise.
      show: open a browser.
    """
    if host in LOCAL:  # a page elsewhere must not reach this one by a name of its own
        app.add_middleware(TrustedHostMiddleware, allowed_hosts=list(LOCAL))

    def build() -> None:
        ui.add_css(".nicegui-content { padding: 8px }")
        with ui.header().classes("items-center py-1"):
            ui.label("jshape studio").classes("text-lg")
            with ui.tabs().props("dense no-caps") as tabs:
                ui.tab("mold", label="Mold")
                ui.tab("annotate", label="Annotate boxes")
        first = "annotate" if dataset is not None and desk.bed is None else "mold"
        with ui.tab_panels(tabs, value=first, animated=False, keep_alive=True).classes("w-full"):
            with ui.tab_panel("mold").classes("p-0"):
                mold = MoldPage(desk, bench)
            with ui.tab_panel("annotate").classes("p-0"):
                annotate = AnnotatePage(dataset)
        mold.in_front = lambda: tabs.value == "mold"
        annotate.in_front = lambda: tabs.value == "annotate"

    ui.run(
        build, host=host, port=port, show=show, reload=False, title="jshape studio",
        favicon="🏖", show_welcome_message=False,
    )  # fmt: skip
