"""Where bed and goal come from: files, the camera."""

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from nicegui import ui

from jshape.app.bench import Bench
from jshape.app.desk import Desk
from jshape.app.molder import seen
from jshape.app.page import upload
from jshape.errors import JShapeError
from jshape.io import cameras

ACCEPT = ".png,.tif,.tiff,.npy,.exr,.ply,.pcd,.json"
"""What can be dropped: frames, point clouds, and the camera.json of frames."""


class LoadingPanel:
    """Loads, looks and saves; says what is on the desk."""

    def __init__(self, desk: Desk, bench: Bench, changed: Callable[[], None]):
        """Build it where the caller is; `changed` is called when the desk was."""
        self._desk, self._bench, self._changed = desk, bench, changed
        self._where = ui.label().classes("text-sm").props("data-name=where")
        self._told = ui.label().classes("text-xs text-orange-9").props("data-name=told")
        with ui.row().classes("w-full no-wrap items-center gap-2"):
            self._path = ui.input("depth image on this computer").props("dense").classes("grow")
            self._path.tooltip(f"Path of a file: {ACCEPT.replace(',', ' ')}")
            for words, load in (("is the bed", desk.load_bed), ("is the goal", desk.load_goal)):
                button = ui.button(words, on_click=partial(self._typed, load))
                button.props("dense no-caps").style("flex: none")
        with ui.row().classes("w-full no-wrap gap-2"):
            upload("or drop the bed here", partial(self._dropped, desk.load_bed), ACCEPT)
            upload("or drop the goal here", partial(self._dropped, desk.load_goal), ACCEPT)
        with ui.row().classes("items-center gap-2"):
            if bench.robot is not None:
                ui.button("look with the camera", on_click=self._look).props("dense no-caps")
            save = ui.button("save bed, goal and plan", on_click=self._save)
            save.props("dense no-caps outline").tooltip(f"In {bench.out / 'desk'}")

    def show(self) -> None:
        """Say what may have changed."""
        desk, camera = self._desk, self._bench.camera
        how = "" if camera is None else f"; files are read with {camera}"
        if desk.bed is None:
            look = "" if self._bench.robot is None else ", or look with the camera"
            self._where.text = f"no bed yet: load a depth image{look}{how}"
            return
        out, into = desk.to_move_cm3
        self._where.text = (
            f"bed: {desk.came_from}; {desk.distance_mm:.3f} mm from the goal on average, which "
            f"takes {out:.0f} cm³ away and brings {into:.0f} cm³{how}"
        )
        self._told.text = "; ".join(desk.told)

    async def _typed(self, load: Callable[..., None]) -> None:
        words = str(self._path.value or "").strip()
        if not words:
            ui.notify("type the path of a depth image first", type="warning")
            return
        await self._load(lambda **how: load(Path(words).expanduser(), **how))

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
            if load == self._desk.load_bed:
                self._desk.came_from = path.name

        await self._load(work)

    def _use_camera(self, path: Path) -> None:
        """Read the files that are loaded from now on with a camera.json that was dropped."""
        camera, unit = cameras.read_camera(path)
        kept = self._bench.out / cameras.CAMERA
        cameras.write_camera(kept, camera, unit)
        self._bench.camera = str(kept)

    async def _load(self, load: Callable[..., None]) -> None:
        how: dict[str, Any] = {"camera": self._bench.camera, "reproject": self._bench.reproject}
        await self._bench.guard("reading", partial(load, **how), self._changed)

    async def _look(self) -> None:
        robot = self._bench.robot
        assert robot is not None
        desk, hands = self._desk, self._bench.hands

        def work() -> None:
            desk.check_free()  # a run looks by itself
            desk.see(seen(robot), robot.eye.name)

        await self._bench.guard("looking", work, self._changed, hands)

    async def _save(self) -> None:
        folder, saved = self._bench.out / "desk", []

        def work() -> None:
            self._desk.save(folder, overwrite=True)
            saved.append(folder)

        await self._bench.guard("saving", work)
        if saved:
            ui.notify(f"bed, goal and plan: {folder}")
