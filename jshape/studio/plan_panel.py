"""Bank, planner, and the plan's actions, each to be moved, changed or dropped."""

from collections.abc import Callable
from functools import partial
from typing import Any

from nicegui import events, ui

from jshape.planners import PLANNERS
from jshape.store import banks
from jshape.studio.bench import Bench
from jshape.studio.desk import Desk


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
        with ui.row().classes("w-full no-wrap items-end gap-2"):
            names = sorted({*banks.list_banks(), desk.bank_name})
            bank = ui.select(names, value=desk.bank_name, label="bank", on_change=self._banked)
            bank.props("dense").classes("grow")
            self._planner = ui.select(list(PLANNERS), value="greedy", label="planner")
            self._planner.props("dense")
            self._most = ui.number("at most", value=8, min=1, max=50, step=1, format="%d")
            self._most.props("dense").style("width: 5em")
            ui.button("plan", on_click=self._plan).props("dense no-caps")
        self._said = ui.label().classes("text-sm").props("data-name=said")
        self._steps = ui.column().classes("w-full gap-0")

    def show(self) -> None:
        """Draw what may have changed."""
        plan = self._desk.plan
        self._steps.clear()
        if plan is None:
            self._said.text = "no plan yet"
            return
        d = plan.distances_mm
        self._said.text = (
            f"{len(plan)} actions, {d[0]:.3f} -> {d[-1]:.3f} mm: {plan.status.meaning}"
        )
        with self._steps:
            self._row(0, "before all of them", d[0])
            for k, name in enumerate(plan.actions):
                u, v = plan.exact_positions[k]
                self._row(k + 1, f"{k + 1}. {name} ({u:.0f}, {v:.0f})", d[k + 1])

    def _row(self, done: int, words: str, mm: float) -> None:
        """The line of the image after `done` actions, with the buttons of the last of them."""
        chosen = " bg-blue-100" if done == self._desk.selected else ""
        row = ui.row().classes(f"w-full no-wrap items-center gap-1{chosen}")
        with row.props(f"data-name=step-{done}"):
            label = ui.label(words).classes("grow cursor-pointer text-sm")
            label.on("click", lambda: self._select(done))
            if done:
                self._buttons(done)
            ui.label(f"{mm:.3f} mm").classes("text-sm text-right").style("width: 5.5em; flex: none")

    def _buttons(self, done: int) -> None:
        desk, k = self._desk, done - 1
        assert desk.plan is not None
        deep = ui.number(value=round(float(desk.plan.strengths[k]), 2), min=0.1, step=0.1)
        deep.props(f'dense borderless prefix="x" aria-label="strength of {done}"')
        deep.style("width: 4.2em; margin: -6px 0").on("change", partial(self._deepen, k, deep))
        for icon, what, act in (
            ("arrow_upward", "earlier", partial(desk.move, k, -1)),
            ("arrow_downward", "later", partial(desk.move, k, 1)),
            ("delete", "drop", partial(desk.drop, k)),
        ):
            button = ui.button(
                icon=icon, on_click=partial(self._bench.guard, "predicting", act, self._changed)
            )
            button.props(f'dense flat size=sm aria-label="{what} {done}"')

    async def _deepen(self, k: int, number: ui.number) -> None:
        work = partial(self._desk.deepen, k, float(number.value or 0))
        await self._bench.guard("predicting", work, self._changed)

    async def _banked(self, event: events.ValueChangeEventArguments) -> None:
        work = partial(self._desk.use_bank, str(event.value))
        await self._bench.guard("loading the bank", work, self._changed)

    async def _plan(self) -> None:
        options: dict[str, Any] = {"planner": str(self._planner.value)}
        options["max_steps"] = int(self._most.value or 1)
        made = self._desk.plan
        await self._bench.guard("planning", lambda: self._desk.make_plan(**options), self._changed)
        found = self._desk.plan
        if found is not None and found is not made:
            self._select(len(found))
