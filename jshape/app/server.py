"""The studio's page and its server."""

from nicegui import ui

from jshape.app.annotate_page import AnnotatePage
from jshape.app.annotation import Annotation
from jshape.app.bench import Bench
from jshape.app.desk import Desk
from jshape.app.mold_page import MoldPage
from jshape.app.pages import COLUMNS, serve_pages
from jshape.app.stopping import StopServer

RESIZE = "setTimeout(() => window.dispatchEvent(new Event('resize')), 100)"


def serve(
    desk: Desk, bench: Bench, boxes: Annotation | None, *, host: str, port: int, show: bool
) -> None:
    """Serve until it is interrupted.

    Args:
      desk: what people work on; the same in every tab of every browser.
      bench: the robot and the folder.
      boxes: opened in the tab for annotation.
      host: to listen at.
      port: likewise.
      show: open a browser.
    """

    def build(script: str) -> None:
        ui.add_head_html(script)
        ui.add_css(COLUMNS)
        with ui.header().classes("items-center no-wrap py-1"):
            ui.label("jshape studio").classes("text-lg gt-xs")  # a telephone has no room for it
            with ui.tabs().props("dense no-caps") as tabs:
                ui.tab("mold", label="Mold")
                ui.tab("annotate", label="Annotate boxes")
            ui.space()
            stop = ui.button("STOP", on_click=bench.stop)
            stop.props("dense color=negative data-name=stop")
        # Wherever the focus is, in whichever tab.
        ui.keyboard(on_key=lambda e: bench.stop() if e.key.escape else None, ignore=[])
        first = "annotate" if boxes is not None and desk.bed is None else "mold"
        with ui.tab_panels(tabs, value=first, animated=False, keep_alive=True).classes("w-full"):
            with ui.tab_panel("mold").classes("p-0"):
                mold = MoldPage(desk, bench)
            with ui.tab_panel("annotate").classes("p-0"):
                annotate = AnnotatePage(boxes)
        # A 3-D view has no size while its tab is behind.
        tabs.on_value_change(lambda: ui.run_javascript(RESIZE))
        mold.in_front = lambda: tabs.value == "mold"
        annotate.in_front = lambda: tabs.value == "annotate"

    with StopServer(bench.stop, host, port) as stopping:
        serve_pages(
            lambda: build(stopping.script), title="jshape studio", host=host, port=port, show=show
        )
