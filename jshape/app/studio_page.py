"""The studio's page and its server."""

from typing import Any

from nicegui import ui

from jshape.app.annotate_page import AnnotatePage
from jshape.app.annotation import Annotation
from jshape.app.context import AppContext
from jshape.app.editor_state import EditorState
from jshape.app.mold_page import MoldPage
from jshape.app.pages import serve_pages
from jshape.app.stop_server import StopServer


def serve_studio(
    editor: EditorState, context: AppContext, boxes: Annotation | None, **where: Any
) -> None:
    """Serve until Ctrl-C; all browsers work on the same state.  `where` is as of `serve_pages`."""

    def build(script: str) -> None:
        ui.add_head_html(script)
        with ui.header().classes("items-center no-wrap py-1"):
            ui.label("jshape studio").classes("text-lg gt-xs")  # a telephone has no room for it
            with ui.tabs() as tabs:
                ui.tab("mold", label="Mold")
                ui.tab("annotate", label="Annotate boxes")
            ui.space()
            stop = ui.button("STOP", on_click=context.stop)
            stop.props("color=negative data-name=stop")
        # Wherever the focus is, in whichever tab.
        ui.keyboard(on_key=lambda e: context.stop() if e.key.escape else None, ignore=[])
        first = "annotate" if boxes is not None and editor.bed is None else "mold"
        with ui.tab_panels(tabs, value=first, animated=False, keep_alive=True).classes("w-full"):
            with ui.tab_panel("mold").classes("p-0"):
                mold = MoldPage(editor, context)
            with ui.tab_panel("annotate").classes("p-0"):
                annotate = AnnotatePage(boxes)
        mold.in_front = lambda: tabs.value == "mold"
        annotate.in_front = lambda: tabs.value == "annotate"

    with StopServer(context.stop, where["host"], where["port"]) as stopping:
        serve_pages(lambda: build(stopping.script), title="jshape studio", **where)
