"""A story in the browser, in 3-D: a small web server of this computer's own."""

import contextlib
import io
import threading
from contextlib import AbstractContextManager
from functools import lru_cache
from typing import Any

import numpy as np
from matplotlib.colors import to_rgb

from jshape.app.ports import LOCAL, free_port, url
from jshape.app.view.curves import add_curves, with_mark
from jshape.app.view.door import door
from jshape.app.view.pictures import picture
from jshape.app.view.story import Story
from jshape.app.view.surfaces import difference_colours, height_colours, surface
from jshape.errors import JShapeError, escaped
from jshape.viz.pictures import COLOURS

PERIOD = 1.0
"""Seconds that a step is shown while it plays."""
BED, PREDICTED, GOAL, GAP, ERROR = "bed", "predicted", "goal", "bed - goal", "bed - predicted"
"""What can be shown."""
GOAL_COLOUR = (235, 90, 170)
GOAL_ABOVE = 0.001
"""Metres that the goal is drawn higher than it is: where the bed is right, it lies over it."""
NO_PICTURE = np.full((2, 2, 3), 255, np.uint8)


class Viewer(AbstractContextManager):
    """Serves a story until it is closed.  All browsers see the same step."""

    def __init__(self, story: Story, *, host: str = LOCAL[0], port: int = 0):
        """Begin to serve.

        Args:
          story: to show.
          host: to listen at.
          port: to listen at; 0 takes a free one.

        Raises:
          JShapeError: viser is not installed, or nothing can listen there.
        """
        viser = _viser()
        free_port(host, port)
        self._story = story
        self._closed, self._lock = threading.Event(), threading.RLock()
        self._playing, self._drawn = False, 0
        self._nodes: list[Any] = []
        with contextlib.redirect_stdout(io.StringIO()), door(host):  # it prints a banner
            self._server = viser.ViserServer(host, port, label="jshape", verbose=False)
        self.url = url(host, self._server.get_port())
        """What to open."""
        self._picture = lru_cache(maxsize=64)(self._draw_picture)
        self._look_from_above()
        self._add_controls(viser)
        self._show()
        threading.Thread(target=self._play, daemon=True).start()

    @property
    def step(self) -> int:
        """The step that is shown."""
        return int(self._slider.value)

    @step.setter
    def step(self, step: int) -> None:
        self._slider.value = min(max(step, 0), max(len(self._story), 1))

    @property
    def shown(self) -> str:
        """What is shown: one of "bed", "predicted", "goal", "bed - goal", "bed - predicted"."""
        return str(self._choice.value)

    @shown.setter
    def shown(self, name: str) -> None:
        self._choice.value = name

    def wait(self) -> None:
        """Return when somebody closes it."""
        while not self._closed.wait(0.5):  # so that Ctrl-C is heard on every platform
            pass

    def close(self) -> None:
        """Stop serving."""
        if not self._closed.is_set():
            self._closed.set()
            with contextlib.redirect_stdout(io.StringIO()):
                self._server.stop()

    def __exit__(self, *problem: object) -> None:
        self.close()

    def _look_from_above(self) -> None:
        """The camera's frame as it is, Z down; seen obliquely from the lower edge of the image."""
        camera, level = self._story.camera, self._story.level
        x, y = (np.asarray(ray).reshape(-1)[[0, -1]] * level for ray in camera.rays())
        middle, size = np.array([x.mean(), y.mean(), level]), float(np.ptp([*x]) + np.ptp([*y])) / 2
        self._server.scene.set_up_direction((0.0, 0.0, -1.0))
        view = self._server.initial_camera
        view.position = middle + size * np.array([0.0, 0.98, -1.0])
        view.look_at = middle + size * np.array([0.0, 0.04, 0.0])
        view.fov = float(np.radians(50))
        view.near, view.far = 0.01 * size, 100 * size
        self._server.scene.configure_environment_map(None)
        self._server.scene.configure_default_lights(True, cast_shadow=False)
        self._server.scene.add_light_ambient("/light", intensity=1.0)

    def _add_controls(self, viser: Any) -> None:
        gui, story = self._server.gui, self._story
        gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        gui.add_html(_lines(story.title, *story.notes))
        self._slider = gui.add_slider(
            "step", 0, max(len(story), 1), 1, 0, disabled=len(story) == 0,
            hint="0 is the start; arrow keys move it",
        )  # fmt: skip
        buttons = gui.add_button_group("go", ("back", "play", "next"))
        self._words = gui.add_html("")
        self._choice = gui.add_dropdown("show", self._choices(), initial_value=BED)
        self._image, self._pictured = gui.add_image(NO_PICTURE), None
        self._plots = add_curves(viser, gui, story)
        with gui.add_folder("more"):
            self._wanted = gui.add_checkbox(
                "goal over it", False, visible=story.goal is not None, hint="as a second surface"
            )
            self._boxes = gui.add_checkbox("actions", True)
            self._tall = gui.add_slider("height x", 1.0, 5.0, 0.5, 1.0, hint="heights exaggerated")
        buttons.on_click(lambda event: self._pressed(event.target.value))
        for control in (self._slider, self._choice, self._wanted, self._boxes, self._tall):
            control.on_update(lambda event: self._show())

    def _choices(self) -> tuple[str, ...]:
        """What the story has to show."""
        story = self._story
        foretold = any(moment.predicted is not None for moment in story.moments)
        there = {BED: True, PREDICTED: foretold, GOAL: story.goal is not None}
        there |= {GAP: there[GOAL], ERROR: foretold and story.is_run}
        return tuple(name for name, is_there in there.items() if is_there)

    def _pressed(self, button: str) -> None:
        if button == "play":
            if not self._playing and self.step == len(self._story):
                self.step = 0
            self._playing = not self._playing
        else:
            self._playing = False
            self.step += 1 if button == "next" else -1

    def _play(self) -> None:
        while not self._closed.wait(PERIOD):
            if self._playing and self.step >= len(self._story):
                self._playing = False
            elif self._playing:
                self.step += 1

    def _depth(self, step: int, name: str) -> tuple[np.ndarray | None, np.ndarray | None]:
        """(H, W) depth to show, metres, and the differences to colour it with, mm, if any."""
        story = self._story
        bed, foretold = story.last(step), story.moments[step].predicted
        if name == GOAL:
            return story.goal, None
        if name == PREDICTED:
            return foretold, None
        if name == GAP:
            return bed, story.too_high_mm(bed, story.goal)
        if name == ERROR:
            seen = story.moments[step].seen
            gap = story.too_high_mm(seen, foretold)
            return (None if gap is None else seen), gap
        return bed, None

    def _show(self) -> None:
        """Draw the step that the slider stands at."""
        with self._lock, self._server.atomic():
            if self._closed.is_set():
                return
            story, step = self._story, min(self.step, len(self._story))
            depth, gap = self._depth(step, self.shown)
            old, self._nodes = self._nodes, []
            self._drawn += 1
            if depth is not None:
                colours = (
                    height_colours(depth, story.range_m)
                    if gap is None
                    else difference_colours(gap, story.reach_mm)
                )
                self._add_surface(depth, colours)
            if self._wanted.value and story.goal is not None:
                self._add_goal(story.goal)
            if self._boxes.value:
                self._add_boxes(step)
            for node in old:
                node.remove()
            told = [f"step {step} of {len(story)}", story.moments[step].words]
            self._words.content = _lines(
                *told, *(() if depth is not None else ("not known at this step",))
            )
            self._image.visible = depth is not None
            pictured = (step, self.shown, self._boxes.value)
            if depth is not None and pictured != self._pictured:
                self._image.image, self._pictured = self._picture(*pictured), pictured
            for plot, series in self._plots:
                plot.data = with_mark(series, step)

    def _draw_picture(self, step: int, name: str, acts: bool) -> np.ndarray:
        depth, gap = self._depth(step, name)
        shown = depth if gap is None else gap
        assert shown is not None
        return picture(self._story, shown, step, differences=gap is not None, acts=acts)

    def _surface(self, depth: np.ndarray) -> Any:
        return surface(
            depth, self._story.camera, level=self._story.level, exaggeration=self._tall.value
        )

    def _add_surface(self, depth: np.ndarray, colours: np.ndarray) -> None:
        import trimesh

        points, faces, normals, pixels = self._surface(depth)
        mesh = trimesh.Trimesh(
            points, faces, vertex_normals=normals, vertex_colors=colours[pixels], process=False
        )
        self._nodes.append(self._server.scene.add_mesh_trimesh(f"/{self._drawn}/bed", mesh))

    def _add_goal(self, goal: np.ndarray) -> None:
        points, faces, _, _ = self._surface(goal - GOAL_ABOVE)
        self._nodes.append(
            self._server.scene.add_mesh_simple(
                f"/{self._drawn}/goal",
                points,
                faces,
                color=GOAL_COLOUR,
                opacity=0.55,
                side="double",
            )  # fmt: skip
        )

    def _add_boxes(self, step: int) -> None:
        """Boxes of the actions so far, the last one thick; at the start, of all of them."""
        story, scene = self._story, self._server.scene
        for k in range(1, (step or len(story)) + 1):
            act, box = story.moments[k].act, story.box(k)
            if act is None or box is None:
                continue
            corners = box.corners
            corners[:, 2] = story.level + self._tall.value * (corners[:, 2] - story.level)
            colour = colour_of(act.name)
            self._nodes.append(
                scene.add_line_segments(
                    f"/{self._drawn}/box{k}",
                    corners[EDGES].astype(np.float32),
                    colour,
                    thickness=3.5 if k == step else 1.5,
                    thickness_units="screen",
                )  # fmt: skip
            )
            top = corners[:2].mean(0)  # the upper edge that is far from who looks
            self._nodes.append(
                scene.add_label(
                    f"/{self._drawn}/name{k}",
                    f"{k} {act.name}",
                    position=tuple(top.tolist()),
                    anchor="bottom-center",
                    font_screen_scale=1.2 if k == step else 0.9,
                )  # fmt: skip
            )


EDGES = np.array([(a, b) for a in range(8) for b in range(a + 1, 8) if (a ^ b) in (1, 2, 4)])
"""(12, 2) corners of a box that an edge joins."""


def colour_of(action: str) -> tuple[int, int, int]:
    """RGB of an action, as on the project's pictures."""
    r, g, b = (round(255 * x) for x in to_rgb(COLOURS.get(action, "0.5")))
    return r, g, b


def _lines(head: str, *lines: str) -> str:
    """Lines of text as HTML, the first one bold.  viser's Markdown would run what a name says."""
    said = [f"<b>{escaped(head)}</b>", *map(escaped, lines)]
    style = "font-size: 14px; line-height: 1.45; overflow-wrap: anywhere; padding: 0 0.5em"
    return f'<div style="{style}">{"<br>".join(said)}</div>'


def _viser() -> Any:
    try:
        import viser
        import viser.uplot
    except ImportError as problem:
        raise JShapeError(
            f"the viewer needs viser, which does not import ({problem}): pip install 'jshape[view]'"
        ) from None
    return viser
