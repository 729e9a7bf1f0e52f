"""Where bed and goal come from: files, the camera."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from nicegui import ui

from jshape.studio.bench import Bench
from jshape.studio.desk import Desk
from jshape.studio.molder import seen
from jshape.studio.page import upload

ACCEPT = ".png,.tif,.tiff,.npy,.exr,.ply,.pcd"


class LoadingPanel:
    """Loads, looks and saves; says what is on the desk."""

    def __init__(self, desk: Desk, bench: Bench, changed: Callable[[], None]):
        """Build it where the caller is; `changed` is called when the desk was."""
        self._desk, self._bench, self._changed = desk, bench, changed
        self._where = ui.label().classes("text-sm").props("data-name=where")
        self._told = ui.label().classes("text-xs text-orange-9").props("data-name=told")
        with ui.row().classes("w-full no-wrap items-center gap-2"):
            path = ui.input("depth image on this computer").props("dense").classes("grow")

            def typed(load: Callable[..., None]) -> Callable[[], Any]:
                return lambda: self._load(Path(path.value or "."), load)

            ui.button("is the bed", on_click=typed(desk.load_bed)).props("dense no-caps")
            ui.button("is the goal", on_click=typed(desk.load_goal)).props("dense no-caps")
        with ui.row().classes("w-full no-wrap gap-2"):
            upload("or drop the bed here", lambda p: self._load(p, desk.load_bed), ACCEPT)
            upload("or drop the goal here", lambda p: self._load(p, desk.load_goal), ACCEPT)
        with ui.row().classes("items-center gap-2"):
            if bench.robot is not None:
                ui.button("look with the camera", on_click=self._look).props("dense no-caps")
            ui.button("save bed, goal and plan", on_click=self._save).props("dense no-caps outline")

    def show(self) -> None:
        """Say what may have changed."""
        desk = self._desk
        if desk.bed is None:
            camera = "" if self._bench.robot is None else ", or look with the camera"
            self._where.text = f"no bed yet: load a depth image{camera}"
            return
        out, into = desk.to_move_cm3
        self._where.text = (
            f"bed: {desk.came_from}; {desk.distance_mm:.3f} mm from the goal, which takes "
            f"{out:.0f} cm³ away and brings {into:.0f} cm³"
        )
        self._told.text = "; ".join(desk.told)

    async def _load(self, path: Path, load: Callable[..., None]) -> None:
        bench = self._bench
        await bench.guard(
            "reading", lambda: load(path, bench.camera, reproject=bench.reproject), self._changed
        )

    async def _look(self) -> None:
        robot = self._bench.robot
        assert robot is not None
        desk, hands = self._desk, self._bench.hands

        def work() -> None:
            desk.check_free()  # a run looks by itself
            desk.see(seen(robot), robot.eye.name)

        await self._bench.guard("looking", work, self._changed, hands)

    async def _save(self) -> None:
        folder = self._bench.out / "desk"
        await self._bench.guard(
            "saving", lambda: self._desk.save(folder, overwrite=True),
            lambda: ui.notify(f"bed, goal and plan: {folder}"),
        )  # fmt: skip
