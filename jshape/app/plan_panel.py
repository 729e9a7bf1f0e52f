"""Bank, planner, and the plan's actions, each to be moved, changed or dropped."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from nicegui import events, ui

from jshape.app.advice import why_empty
from jshape.app.bench import Bench
from jshape.app.desk import Desk
from jshape.io import banks
from jshape.planning.options import STRIDE, SearchSpace, StopCriteria
from jshape.planning.search import PLANNERS

POLL = 0.3
"""Seconds between two looks at a search."""


class PlanPanel:
    """Makes a plan and edits it; d follows at once."""

    def __init__(
        self,
        desk: Desk,
        bench: Bench,
        changed: Callable[[], None],
        select: Callable[[int], None],
    ):
        """Build it where the caller is.

        Args:
          desk: whose plan.
          bench: does one thing at a time.
          changed: called when the desk was.
          select: called to look at the image after so many actions.
        """
        self._desk, self._bench, self._changed, self._select = desk, bench, changed, select
        space = SearchSpace()
        with ui.row().classes("w-full items-end gap-2"):
            ui.button("plan", on_click=self._plan).props("dense no-caps").tooltip(
                f"Search for actions: every {STRIDE} px, "
                f"{', '.join(f'x{x:g}' for x in space.strengths)} as deep as trained"
            )
            self._most = ui.number(
                "at most", value=StopCriteria().max_steps, min=1, max=50, step=1, suffix="actions"
            )
            self._most.props("dense").style("width: 7.2em").tooltip("Length of the plan, 1 to 50")
            self._turns = ui.select([1, 2, 4, 8], value=desk.yaws, label="yaws")
            self._turns.props("dense").style("width: 6em").on_value_change(self._turned)
            self._turns.tooltip("Of the hand, over half a turn: 4 are 0°, 45°, 90° and 135°")
            self._planner = ui.select(list(PLANNERS), value="greedy", label="planner")
            self._planner.props("dense").tooltip("greedy is the quickest; the others look farther")
            names = sorted({*banks.list_banks(), desk.bank_name})
            self._bank = ui.select(names, value=desk.bank_name, label="bank")
            self._bank.props("dense").classes("grow").on_value_change(self._banked)
            self._bank.tooltip("What is known of material and hand")
        with ui.row().classes("w-full items-center gap-2") as self._going:
            ui.spinner(size="sm")
            self._since = ui.label().classes("text-sm").props("data-name=since")
            ui.button("cancel", on_click=self._cancel).props("dense no-caps outline").tooltip(
                "Go on without a plan"
            )
        self._said = ui.label().classes("text-sm").props("data-name=said")
        self._why = ui.label().classes("text-xs text-orange-9").props("data-name=why")
        self._steps = ui.column().classes("w-full gap-0")
        ui.timer(POLL, self._poll)
        self._poll()

    def _poll(self) -> None:
        """How far a search is, whichever page began it."""
        search = self._desk.search
        self._going.set_visibility(search is not None)
        if search is not None:
            self._since.text = search.said

    def _cancel(self) -> None:
        if search := self._desk.search:
            search.give_up()

    def show(self) -> None:
        """Draw what may have changed."""
        plan = self._desk.plan
        self._bank.value = self._desk.bank_name
        turns = self._desk.bank.turns
        self._turns.value = self._desk.yaws if turns else 1
        self._turns.set_enabled(turns)
        self._why.text = self._desk.advice
        self._steps.clear()
        if plan is None:
            self._said.text = "no plan yet"
            return
        d = plan.distances_mm
        self._said.text = (
            f"{len(plan)} actions, {d[0]:.3f} -> {d[-1]:.3f} mm from the goal: "
            f"{plan.status.meaning}"
        )
        with self._steps:
            self._row(0, "before all of them", d[0])
            for k, name in enumerate(plan.actions):
                (u, v), yaw = plan.exact_positions[k], np.degrees(plan.yaws[k])
                turned = f" {yaw:.0f}°" if yaw else ""
                self._row(k + 1, f"{k + 1}. {name} ({u:.0f}, {v:.0f}) px{turned}", d[k + 1])

    def _row(self, done: int, words: str, mm: float) -> None:
        """The line of the image after `done` actions, with the buttons of the last of them."""
        chosen = " bg-blue-100" if done == self._desk.selected else ""
        row = ui.row().classes(f"w-full no-wrap items-center gap-1{chosen}")
        with row.props(f"data-name=step-{done}"):
            label = ui.label(words).classes("grow cursor-pointer text-sm")
            label.on("click", lambda: self._select(done))
            if done:
                self._buttons(done)
            ui.label(f"{mm:.3f} mm").classes("text-sm text-right").style("width: 4.8em; flex: none")

    def _buttons(self, done: int) -> None:
        desk, k = self._desk, done - 1
        assert desk.plan is not None
        deep = ui.number(value=round(float(desk.plan.strengths[k]), 2), min=0.1, step=0.1)
        deep.props(f'dense borderless prefix="x" aria-label="strength of {done}"')
        deep.style("width: 3.8em; margin: -6px 0").on("change", partial(self._deepen, k, deep))
        deep.tooltip("Times as deep as the trained action")
        for icon, what, act in (
            ("arrow_upward", "earlier", partial(desk.move, k, -1)),
            ("arrow_downward", "later", partial(desk.move, k, 1)),
            ("delete", "drop", partial(desk.drop, k)),
        ):
            button = ui.button(
                icon=icon, on_click=partial(self._bench.guard, "predicting", act, self._changed)
            )
            button.props(f'dense flat size=sm aria-label="{what} {done}"').tooltip(what)

    async def _deepen(self, k: int, number: ui.number) -> None:
        work = partial(self._desk.deepen, k, float(number.value or 0))
        await self._bench.guard("predicting", work, self._changed)

    def _turned(self, event: events.ValueChangeEventArguments) -> None:
        if self._desk.bank.turns:
            self._desk.yaws = int(event.value)

    async def _banked(self, event: events.ValueChangeEventArguments) -> None:
        if event.value != self._desk.bank_name:
            work = partial(self._desk.use_bank, str(event.value))
            await self._bench.guard("loading the bank", work, self._changed)

    async def _plan(self) -> None:
        desk, made = self._desk, self._desk.plan
        options: dict[str, Any] = {"planner": str(self._planner.value)}
        options["max_steps"] = int(self._most.value or 1)

        def work() -> None:
            desk.make_plan(**options)
            desk.advice = why_empty(desk)

        await self._bench.guard("planning", work, self._changed)
        if desk.plan is not None and desk.plan is not made:
            self._select(len(desk.plan))
