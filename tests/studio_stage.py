"""A studio whose arm moves until it is stopped, and notes when that was.

python -m tests.studio_stage PORT FOLDER
"""

import sys
import threading
import time
from pathlib import Path

from jshape import plan
from jshape.data.view import image_of_depth
from jshape.robot.cameras.simulated import levelled_world
from jshape.robot.procedure_file import load_hand
from jshape.robot.robot import Robot
from tests import conftest
from tests.conftest import mm, paper
from tests.stage import PLACES, Arm, Eye

EVIL = (
    '<img src=x onerror="window.pwned=1">',
    '<iframe srcdoc="<script>parent.pwned=1</script>"></iframe>',
    "[x](javascript:window.pwned=1) ![x](http://203.0.113.9/x.png)",
    "{window.pwned=1}",
    "</script><script>window.pwned=1</script>",
)
"""Texts that try to do something where they should only be shown."""


class Endless(Arm):
    """Ends no motion by itself."""

    slowness = 1000.0  # nobody gives up on it

    def __init__(self, bank, eye, folder):
        super().__init__(bank, eye)
        self._folder, self._told = folder, threading.Event()

    def move(self, pose, *, speed, threshold):
        (self._folder / "moving").touch()
        self._told.wait(120)
        return super().move(pose, speed=speed, threshold=threshold)

    def stop(self):
        with (self._folder / "told").open("a") as file:
            file.write(f"{time.monotonic()}\n")
        self._told.set()
        super().stop()


def begin(folder):
    """A run in its first motion."""
    from jshape.app.run_controller import RunController, State

    bank = conftest.bank.__wrapped__()
    now, goal, _ = conftest.molded.__wrapped__(bank)
    eye = Eye(now.copy())
    robot = Robot(eye, Endless(bank, eye, folder), load_hand(), bank.camera, frames=3)
    made = plan(now, goal, bank=bank, **paper(positions=PLACES, min_gain_mm=mm(2e-5)))
    controller = RunController(
        robot, bank, goal, folder / "run", meta={"bank": "fixture"}, plan=made
    )
    while controller.state is not State.ASKING:
        time.sleep(0.01)
    controller.answer(True)
    return controller


def main(port, folder):
    """Serve until the process is ended."""
    from jshape.app import pages
    from jshape.app import studio_page as server
    from jshape.app.context import AppContext
    from jshape.app.editor_state import EditorState

    editor, context = EditorState("flour-robot"), AppContext(None, "", folder / "out")
    editor.see(image_of_depth(levelled_world(5).look(), editor.camera).image, "simulated")
    context.controller = begin(folder)
    pages.LOADED_WITHIN = 0.5  # the test's pages never come alive
    server.serve_studio(editor, context, None, host="127.0.0.1", port=port, show=False)
    context.end()


if __name__ == "__main__":
    main(int(sys.argv[1]), Path(sys.argv[2]))
