"""Carrying out: in simulation or with the arm, one question before each action."""

from functools import partial

import numpy as np
from nicegui import ui

from jshape.app.context import AppContext
from jshape.app.editor_state import EditorState
from jshape.app.run_controller import RunController, State, over_simulated, simulated_robot
from jshape.app.widgets import buttons
from jshape.errors import JShapeError

POLL = 0.3
"""Seconds between two looks at a run."""


class RunPanel:
    """Starts a run, answers its questions, shows what came out."""

    def __init__(self, editor: EditorState, context: AppContext):
        """Build it where the caller is."""
        self._editor, self._context = editor, context
        self._known = 0  # lines of the run that are shown
        self._asked = 0  # number of the question that is shown
        where = {"sim": "in simulation, on this bed"}
        if context.robot is not None:
            where["arm"] = f"with {context.arm}"
        with ui.row().classes("items-center gap-2"):
            self._arm = ui.radio(where, value="sim").props("inline")
            self._replans = ui.checkbox("plan anew after each look")
            self._replans.tooltip("As jshape mold does; else the plan is gone through as it is")
        with ui.row().classes("items-center gap-2"):
            buttons(("start", self._start, "Look, then ask before each action"))
            self._act, self._end = buttons(
                ("act", lambda: self._answer(True), "Do the action that is asked"),
                ("end", lambda: self._answer(False), "End the run without it"),
            )
            self._act.props("color=positive")
            self._end.props("outline")
            self._state = ui.label("nothing is carried out").classes("text-sm")
            self._state.props("data-name=state")
        with ui.element("div").classes("w-full").style("container-type: inline-size"):
            self._log = ui.log(max_lines=200).classes("w-full h-32").props("data-name=log")
            self._log.style("font-size: clamp(8px, 2.25cqw, 12px); padding: 4px")  # whole lines
        ui.timer(POLL, self._poll)

    async def _start(self) -> None:
        if self._context.running:
            ui.notify("a run is going on", type="warning")
            return
        self._log.clear()
        self._known = 0
        work = partial(self._begin, bool(self._replans.value), self._arm.value == "arm")
        await self._context.do("starting", work)

    def _begin(self, replans: bool, with_arm: bool) -> None:
        editor, context = self._editor, self._context
        editor.check_changed()
        bed, goal = editor.both()
        if not replans and not editor.plan:
            raise JShapeError("there is no plan to carry out: plan first")
        robot, arm = (context.robot, context.arm) if with_arm else (None, "sim")
        bank, plan = editor.bank, editor.plan
        if robot is None:
            bank, plan = over_simulated(bank, plan)
            depth, stock = editor.depth_of(bed), editor.stock or 0.0
            robot = simulated_robot(depth, bank, editor.material, stock_cm3=stock)
        else:
            editor.show_to(robot)
        context.controller = RunController(
            robot,
            bank,
            goal,
            context.next_run(),
            meta={"what": "mold", "bank": editor.bank_name, "arm": arm},
            plan=None if replans else plan,
            search=editor.keywords,
            ask_first=with_arm,
            on_look=partial(_seen, editor),
            thread=context.robot_thread if with_arm else None,
        )
        editor.lock("a run goes on: end it first")

    def _answer(self, act: bool) -> None:
        """The answer to the question that this page shows."""
        if self._context.controller is not None:
            self._context.controller.answer(act, self._asked)

    def _poll(self) -> None:
        """Show how far the run is."""
        run = self._context.controller
        asking = run is not None and run.state is State.ASKING
        self._act.set_enabled(asking)
        self._end.set_enabled(asking)
        if run is None:
            return
        for text in run.lines[self._known :]:
            self._log.push(text)
        self._known = len(run.lines)
        ahead, number = run.ahead, run.number
        if asking:
            self._state.text = run.question
            if number != self._asked and ahead is not None:
                self._editor.follow(ahead)
            self._asked = number
        else:
            self._state.text = f"{run.state}: {run.why} ({run.folder})" if run.why else run.state
        if not run.running:
            self._editor.lock("")


def _seen(editor: EditorState, image: np.ndarray) -> None:
    """A look of the run becomes the bed, for all pages; the goal stays."""
    editor.see(image, "the run's last look", same_goal=True)
