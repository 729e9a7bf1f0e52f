"""The studio's page and its server."""

from nicegui import app, ui
from starlette.middleware.trustedhost import TrustedHostMiddleware

from jshape.listening import LOCAL
from jshape.studio.annotate_page import AnnotatePage
from jshape.studio.annotation import Annotation
from jshape.studio.bench import Bench
from jshape.studio.desk import Desk
from jshape.studio.mold_page import MoldPage

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
    if host in LOCAL:  # a page elsewhere must not reach this one by a name of its own
        app.add_middleware(TrustedHostMiddleware, allowed_hosts=list(LOCAL))

    def build() -> None:
        ui.add_css(".nicegui-content { padding: 8px }")
        with ui.header().classes("items-center no-wrap py-1"):
            ui.label("jshape studio").classes("text-lg gt-xs")  # a telephone has no room for it
            with ui.tabs().props("dense no-caps") as tabs:
                ui.tab("mold", label="Mold")
                ui.tab("annotate", label="Annotate boxes")
            ui.space()
            ui.button("STOP", on_click=bench.stop).props("dense color=negative")
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

    ui.run(
        build, host=host, port=port, show=show, reload=False, title="jshape studio",
        favicon="🏖", show_welcome_message=False,
    )  # fmt: skip
