"""Bank, planner, and the plan's actions, each to be moved, changed or dropped."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from nicegui import events, ui

from jshape.app.advice import how_good, why_empty
from jshape.app.context import AppContext
from jshape.app.editor_state import EditorState
from jshape.app.widgets import buttons, small
from jshape.errors import JShapeError
from jshape.io import banks
from jshape.planning import problem
from jshape.planning.options import STRIDE, SearchSpace
from jshape.planning.search import PLANNERS

POLL = 0.3
"""Seconds between two looks at a search."""


class PlanPanel:
    """Makes a plan and edits it; d follows at once."""

    def __init__(
        self,
        editor: EditorState,
        context: AppContext,
        changed: Callable[[], None],
        select: Callable[[int], None],
    ):
        """Build it where the caller is; `select` looks at the image after so many actions."""
        self._editor, self._context, self._changed, self._select = editor, context, changed, select
        deep = ", ".join(f"x{x:g}" for x in SearchSpace().strengths)
        with ui.row().classes("w-full items-end gap-2"):
            buttons(("plan", self._plan, f"Every {STRIDE} px, {deep} as deep as trained"))
            self._most = ui.number("at most", min=1, max=50, step=1, suffix="actions")
            self._most.on_value_change(self._set("max_steps", int))
            self._most.style("width: 7.2em").tooltip("Length of the plan, 1 to 50")
            self._yaws = ui.select([1, 2, 4, 8], label="yaws", on_change=self._turned)
            self._yaws.style("width: 6em")
            self._yaws.tooltip("Of the hand, over half a turn: 4 are 0°, 45°, 90° and 135°")
            self._planner = ui.select(list(PLANNERS), label="planner")
            self._planner.on_value_change(self._set("planner", str))
            self._planner.tooltip("greedy is the quickest; the others go on from its plan")
            names = sorted({*banks.list_banks(), editor.bank_name})
            self._bank = ui.select(names, label="bank", on_change=self._banked).classes("grow")
            self._bank.tooltip("What is known of material and hand")
        with ui.row().classes("w-full items-end gap-2") as self._moving:
            self._build_moving()
        with ui.row().classes("w-full items-center gap-2") as self._going:
            ui.spinner(size="sm")
            self._since = ui.label().classes("text-sm").props("data-name=since")
            buttons(("cancel", self._cancel, "Go on without a plan"), props="outline")
        self._said = ui.label().classes("text-sm").props("data-name=said")
        self._why = small("", "why", "text-orange-9")
        self._steps = ui.column().classes("w-full gap-0")
        ui.timer(POLL, self._poll)
        self._poll()

    def _build_moving(self) -> None:
        """What only banks have whose hand goes along a path, or carries material."""
        self._lengths = ui.input("stroke lengths", validation=_wrong)
        self._lengths.on_value_change(self._lengthened)
        self._lengths.props("debounce=300 hide-bottom-space").style("width: 9em")
        self._lengths.tooltip("Of the hand's path, times the trained one: one or more numbers")
        self._carries = ui.checkbox("carries", on_change=self._carried)
        self._carries.tooltip("A scoop and a pour as one; else each for itself")
        self._stock = ui.number("stock", min=0, step=50, suffix="cm³", placeholder="none")
        self._stock.on_value_change(self._stocked)
        self._stock.props("clearable").style("width: 8em")
        self._stock.tooltip("Material beside the bed, to pour from and to scoop to; empty: none")

    def _poll(self) -> None:
        """How far a search is, whichever page began it, and what is found beside it."""
        self._tell()
        search = self._editor.search
        self._going.set_visibility(search is not None)
        if search is not None:
            self._since.text = search.said

    def _cancel(self) -> None:
        if search := self._editor.search:
            search.cancel()

    def show(self) -> None:
        """Draw what may have changed."""
        editor = self._editor
        plan, turns = editor.plan, editor.bank.turns
        self._bank.value = editor.bank_name
        self._yaws.value = editor.yaws if turns else 1
        self._yaws.set_enabled(turns)
        self._most.value, self._planner.value = editor.max_steps, editor.planner
        self._carries.value, self._stock.value = editor.carries, editor.stock_cm3
        if _numbers(str(self._lengths.value or "")) != editor.lengths:
            self._lengths.value = ", ".join(f"{length:g}" for length in editor.lengths)
        self._lengths.set_visibility(editor.has_paths)
        for element in (self._carries, self._stock):
            element.set_visibility(editor.can_carry)
        self._moving.set_visibility(editor.has_paths or editor.can_carry)
        self._why.text = editor.advice
        self._steps.clear()
        if plan is None:
            self._said.text = "no plan yet"
            return
        d = plan.distances_mm
        self._tell()
        with self._steps:
            self._row(0, "before all of them", d[0], "")
            for k, act in enumerate(plan, 1):
                placed = replace(act, strength=1.0)  # the field beside it says how deep
                self._row(k, f"{k}. {placed.words(plan.camera)}", d[k], plan.interval_after(k))

    def _tell(self) -> None:
        """What the plan leaves, beside what any plan must leave once that is known."""
        if (plan := self._editor.plan) is not None:
            d, left = plan.distances_mm, how_good(plan, self._context.limit.ask(self._editor))
            way = f"{d[0]:.3f} -> {d[-1]:.3f} mm from the goal{plan.interval_after(len(plan))}"
            self._said.text = f"{len(plan)} actions, {way} ({left}): {plan.status.meaning}"

    def _row(self, done: int, words: str, mm: float, interval: str) -> None:
        """The line of the image after `done` actions, with the buttons of the last of them."""
        chosen = " bg-blue-100" if done == self._editor.selected else ""
        row = ui.row().classes(f"w-full no-wrap items-center gap-1{chosen}")
        with row.props(f"data-name=step-{done}"):
            label = ui.label(words).classes("grow cursor-pointer text-sm")
            label.on("click", lambda: self._select(done))
            if done:
                self._build_edits(done)
            far = ui.label(f"{mm:.3f} mm").classes("text-sm text-right")
            far.style("width: 4.8em; flex: none").tooltip(f"from the goal{interval}")

    def _build_edits(self, done: int) -> None:
        editor, k = self._editor, done - 1
        assert editor.plan is not None
        deep = ui.number(value=round(editor.plan[k].strength, 2), min=0.1, step=0.1)
        deep.props(f'borderless prefix="x" aria-label="strength of {done}"')
        deep.style("width: 3.8em; margin: -6px 0").tooltip("Times as deep as the trained action")
        deep.on("change", lambda: self._edit(editor.change, k, strength=float(deep.value or 0)))
        for icon, what, act in (
            ("arrow_upward", "earlier", partial(self._edit, editor.move, k, -1)),
            ("arrow_downward", "later", partial(self._edit, editor.move, k, 1)),
            ("delete", "drop", partial(self._edit, editor.drop, k)),
        ):
            button = ui.button(icon=icon, on_click=act).tooltip(what)
            button.props(f'flat size=sm aria-label="{what} {done}"')

    async def _edit(self, change: Callable[..., None], *given: int, **fields: float) -> None:
        await self._context.do("predicting", partial(change, *given, **fields), self._changed)

    def _turned(self, event: events.ValueChangeEventArguments) -> None:
        if self._editor.bank.turns:
            self._editor.yaws = int(event.value)

    def _set(self, name: str, kind: type) -> Callable[[events.ValueChangeEventArguments], None]:
        """Keep an option in the state, but not an empty field."""

        def keep(event: events.ValueChangeEventArguments) -> None:
            if event.value is not None:
                setattr(self._editor, name, kind(event.value))

        return keep

    def _carried(self, event: events.ValueChangeEventArguments) -> None:
        self._editor.carries = bool(event.value)
        self._stock.set_enabled(self._editor.carries)

    def _stocked(self, event: events.ValueChangeEventArguments) -> None:
        self._editor.stock_cm3 = event.value

    def _lengthened(self, event: events.ValueChangeEventArguments) -> None:
        words = str(event.value or "")
        if _wrong(words) is None:
            self._editor.lengths = _numbers(words)

    async def _banked(self, event: events.ValueChangeEventArguments) -> None:
        if event.value != self._editor.bank_name:
            work = partial(self._editor.use_bank, str(event.value))
            await self._context.do("loading the bank", work, self._changed)

    async def _plan(self) -> None:
        editor = self._editor

        def work() -> None:
            editor.make_plan()
            editor.advice = why_empty(editor)

        if await self._context.do("planning", work, self._changed) and editor.plan is not None:
            self._select(len(editor.plan))


def _numbers(words: str) -> tuple[float, ...]:
    """Numbers with commas or blanks between them; none, if one of the words is no number."""
    try:
        return tuple(float(word) for word in words.replace(",", " ").split())
    except ValueError:
        return ()


def _wrong(words: str | None) -> str | None:
    """What is said under lengths that cannot be tried; None: they can."""
    try:
        problem.lengths_to_try(_numbers(words or ""))
    except JShapeError:
        return "numbers above 0, such as 0.6, 1"
    return None
