"""Carrying out: in simulation or with the arm, one question before each action."""

from functools import partial

import numpy as np
from nicegui import ui

from jshape.app.bench import Bench
from jshape.app.desk import Desk
from jshape.app.molder import Molder, State, simulated_robot
from jshape.errors import JShapeError

POLL = 0.3
"""Seconds between two looks at a run."""


class ActingPanel:
    """Starts a run, answers its questions, shows what came out."""

    def __init__(self, desk: Desk, bench: Bench):
        """Build it where the caller is."""
        self._desk, self._bench = desk, bench
        self._known = 0  # lines of the run that are shown
        self._asked = 0  # number of the question that is shown
        where = {"sim": "in simulation, on this bed"}
        if bench.robot is not None:
            where["arm"] = f"with {bench.arm}"
        with ui.row().classes("items-center gap-2"):
            self._arm = ui.radio(where, value="sim").props("dense inline")
            self._anew = ui.checkbox("plan anew after each look").props("dense")
            self._anew.tooltip("As jshape mold does; else the plan is gone through as it is")
        with ui.row().classes("items-center gap-2"):
            start = ui.button("start", on_click=self._start).props("dense no-caps")
            start.tooltip("Look, then ask before each action")
            self._act = ui.button("act", on_click=lambda: self._answer(True))
            self._act.props("dense no-caps color=positive").tooltip("Do the action that is asked")
            self._end = ui.button("end", on_click=lambda: self._answer(False))
            self._end.props("dense no-caps outline").tooltip("End the run without it")
            self._state = ui.label("nothing is carried out").classes("text-sm")
            self._state.props("data-name=state")
        with ui.element("div").classes("w-full").style("container-type: inline-size"):
            self._log = ui.log(max_lines=200).classes("w-full h-32").props("data-name=log")
            self._log.style("font-size: clamp(8px, 2.25cqw, 12px); padding: 4px")  # whole lines
        ui.timer(POLL, self._poll)

    async def _start(self) -> None:
        molder = self._bench.molder
        if molder is not None and molder.running:
            ui.notify("a run is going on", type="warning")
            return
        self._log.clear()
        self._known = 0
        anew, with_arm = bool(self._anew.value), self._arm.value == "arm"
        await self._bench.guard("starting", lambda: self._begin(anew, with_arm))

    def _begin(self, anew: bool, with_arm: bool) -> None:
        desk, bench = self._desk, self._bench
        bed, goal = desk.bed, desk.goal
        if bed is None or goal is None:
            raise JShapeError("there is no bed yet: load one, or look with a camera")
        if not desk.changed:
            raise JShapeError("the goal is the bed as it is: draw, write or load one first")
        if not anew and not desk.plan:
            raise JShapeError("there is no plan to carry out: plan first")
        robot = bench.robot if with_arm else None
        if robot is None:
            robot = simulated_robot(desk.depth_of(bed), desk.bank, desk.material)
        arm = bench.arm if with_arm else "sim"
        bench.molder = Molder(
            robot, desk.bank, goal, bench.next_run(),
            meta={"what": "mold", "bank": desk.bank_name, "arm": arm},
            plan=None if anew else desk.plan, ask_first=with_arm, on_look=partial(_seen, desk),
            hands=bench.hands if with_arm else None, search=desk.keywords,
        )  # fmt: skip
        desk.lock("a run goes on: end it first")

    def _answer(self, act: bool) -> None:
        """The answer to the question that this page shows."""
        if self._bench.molder is not None:
            self._bench.molder.answer(act, self._asked)

    def _poll(self) -> None:
        """Show how far the run is."""
        molder = self._bench.molder
        asking = molder is not None and molder.state is State.ASKING
        self._act.set_enabled(asking)
        self._end.set_enabled(asking)
        if molder is None:
            return
        for text in molder.lines[self._known :]:
            self._log.push(text)
        self._known = len(molder.lines)
        ahead, number = molder.ahead, molder.number
        if asking:
            self._state.text = molder.question
            if number != self._asked and ahead is not None:
                self._desk.follow(ahead)
            self._asked = number
        else:
            ended = f": {molder.why} ({molder.folder})" if molder.why else ""
            self._state.text = f"{molder.state}{ended}"
        if not molder.running:
            self._desk.lock("")


def _seen(desk: Desk, image: np.ndarray) -> None:
    """A look of the run becomes the bed, for all pages; the goal stays."""
    desk.see(image, "the run's last look", same_goal=True)
