"""Where bed and goal come from: files, the camera."""

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from nicegui import ui

from jshape.app.context import AppContext
from jshape.app.editor_state import EditorState
from jshape.app.widgets import buttons, small, upload
from jshape.errors import JShapeError
from jshape.io import cameras

ACCEPT = ".png,.tif,.tiff,.npy,.ply,.pcd,.json"
"""What can be dropped: frames, point clouds, and the camera.json of frames."""


class LoadingPanel:
    """Loads, looks and saves; says what is loaded."""

    def __init__(self, editor: EditorState, context: AppContext, changed: Callable[[], None]):
        """Build it where the caller is; `changed` is called when the state was."""
        self._editor, self._context, self._changed = editor, context, changed
        self._where = ui.label().classes("text-sm").props("data-name=where")
        self._told = small("", "told", "text-orange-9")
        bed, goal = editor.load_bed, editor.load_goal
        with ui.row().classes("w-full no-wrap items-center gap-2"):
            self._path = ui.input("depth image on this computer").classes("grow")
            self._path.tooltip(f"Path of a file: {ACCEPT.replace(',', ' ')}")
            for button in buttons(
                ("is the bed", partial(self._typed, bed), "Load it as the bed"),
                ("is the goal", partial(self._typed, goal), "Load it as the goal"),
            ):
                button.style("flex: none")
        with ui.row().classes("w-full no-wrap gap-2"):
            upload("or drop the bed here", partial(self._dropped, bed), ACCEPT)
            upload("or drop the goal here", partial(self._dropped, goal), ACCEPT)
        with ui.row().classes("items-center gap-2"):
            if context.robot is not None:
                buttons(("look with the camera", self._look, "What it sees becomes the bed"))
            saved = f"In {context.saved}"
            buttons(("save bed, goal and plan", self._save, saved), props="outline")

    def show(self) -> None:
        """Say what may have changed."""
        editor, camera = self._editor, self._context.camera
        how = "" if camera is None else f"; files are read with {camera}"
        if editor.bed is None:
            look = "" if self._context.robot is None else ", or look with the camera"
            self._where.text = f"no bed yet: load a depth image{look}{how}"
            return
        out, into = editor.to_move_cm3
        self._where.text = (
            f"bed: {editor.came_from}; {editor.distance_mm:.3f} mm from the goal on average, which "
            f"takes {out:.0f} cm³ away and brings {into:.0f} cm³{how}"
        )
        self._told.text = "; ".join(editor.warnings)

    async def _typed(self, load: Callable[..., None]) -> None:
        if not (words := str(self._path.value or "").strip()):
            ui.notify("type the path of a depth image first", type="warning")
            return
        await self._load(partial(load, Path(words).expanduser()))

    async def _dropped(self, load: Callable[..., None], path: Path) -> None:
        def work(**how: Any) -> None:
            """What goes wrong is told of the file that was dropped, not of where it was put."""
            try:
                if path.suffix.lower() == ".json":
                    self._use_camera(path)
                    return
                load(path, **how)
            except JShapeError as problem:
                said = str(problem).replace(f"{path.parent}{os.sep}", "")
                if "depth_unit" in said or cameras.CAMERA in said:
                    said += f"; here: drop the {cameras.CAMERA} of the frames first"
                raise JShapeError(said) from None
            if load == self._editor.load_bed:
                self._editor.came_from = path.name

        await self._load(work)

    def _use_camera(self, path: Path) -> None:
        """Read the files that are loaded from now on with a camera.json that was dropped."""
        camera, unit = cameras.read_camera(path)
        kept = self._context.out / cameras.CAMERA
        cameras.write_camera(kept, camera, unit)
        self._context.camera = str(kept)

    async def _load(self, load: Callable[..., None]) -> None:
        work = partial(load, camera=self._context.camera)
        await self._context.do("reading", work, self._changed)

    async def _look(self) -> None:
        robot, editor = self._context.robot, self._editor
        assert robot is not None

        def work() -> None:
            editor.check_free()  # a run looks by itself
            editor.look(robot)

        await self._context.do("looking", work, self._changed, self._context.robot_thread)

    async def _save(self) -> None:
        folder = self._context.saved
        work = partial(self._editor.save, folder, overwrite=True)
        if await self._context.do("saving", work):
            ui.notify(f"bed, goal and plan: {folder}")
