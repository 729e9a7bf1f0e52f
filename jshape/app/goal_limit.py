"""What no plan can go below, looked for beside the page once a goal has stood still."""

import threading
import time
from concurrent.futures import CancelledError
from typing import Any

from jshape.app.editor_state import EditorState
from jshape.errors import told
from jshape.planning.limit import Limit, limit_images

Task = tuple[int, dict[str, Any]]
"""What is wanted, as `EditorState.revision`, and how plans for it are made."""
STILL = 0.7
"""Seconds without a change before a limit is looked for: strokes follow each other."""


class GoalLimit:
    """The limit of the goal that is edited.

    It takes 4 to 11 s of one core.  One is looked for at a time, none beside a search for a plan or
    a run; one of a goal that is no longer wanted ends at once.
    """

    def __init__(self) -> None:
        self._task: Task = (-1, {})
        self._since = 0.0
        self._answer: tuple[Task | None, Limit | str] = (None, "")
        self._thread = threading.Thread()

    def ask(self, editor: EditorState) -> Limit | str:
        """The limit of what is wanted now, or why there is none; "": not known, or nothing to do.

        Asked often, it begins to look for it.
        """
        how = {name: how for name, how in editor.keywords.items() if name != "planner"}
        task = editor.revision, how
        if task != self._task:
            self._task, self._since = task, time.monotonic()
        asked, found = self._answer
        if asked is self._task:
            return found
        still = editor.bed is not None and time.monotonic() - self._since >= STILL
        if still and not _busy(editor) and not self._thread.is_alive():
            self._thread = threading.Thread(target=self._find, args=[editor, self._task])
            self._thread.start()
        return ""

    def _find(self, editor: EditorState, task: Task) -> None:
        def check() -> None:
            """End what nobody waits for: another goal, a plan or a run, Ctrl-C."""
            wanted = self._task is task and editor.revision == task[0] and not _busy(editor)
            if not wanted or not threading.main_thread().is_alive():
                raise CancelledError

        found: Limit | str = ""
        try:
            bed, goal = editor.both()
            if editor.changed:
                found = limit_images(editor.bank, bed, goal, None, check=check, **task[1])
        except CancelledError:
            return
        except Exception as problem:  # the person at the page must hear of it
            found = told(problem, 300)
        self._answer = task, found


def _busy(editor: EditorState) -> bool:
    return editor.search is not None or bool(editor.locked)
