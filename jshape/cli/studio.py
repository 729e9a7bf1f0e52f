"""`jshape studio`: a local web page to load, draw, plan, edit, carry out and annotate."""

from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jshape.app.ports import free_port
from jshape.cli.names import Uses
from jshape.cli.options import Port, Serves
from jshape.cli.robot import Arm, Robots, robot_of
from jshape.data.view import image_of_depth
from jshape.errors import needs
from jshape.planning.options import DEFAULT_BANK
from jshape.robot.cameras.simulated import levelled_world


@dataclass(frozen=True, kw_only=True)
class StudioOptions(Uses, Robots, Serves):
    """Of `jshape studio`."""

    arm: Arm | None = None
    dataset: Path | None = None
    """Folder with pairs.csv to annotate."""
    out: Path = Path("studio")
    """Folder for runs and what is saved."""
    port: Port = 8077


def studio(
    initial: Path | None = None,
    desired: Path | None = None,
    /,
    options: StudioOptions = StudioOptions(),
) -> dict[str, Any]:
    """Open the page; it runs until Ctrl-C.

    Args:
      initial: Depth image of the bed.
      desired: Depth image wanted, PLY or PCD.
    """
    with needs("studio", "the studio"):
        from jshape.app.studio_page import serve_studio
    from jshape.app.annotation import Annotation
    from jshape.app.context import AppContext
    from jshape.app.editor_state import EditorState

    editor = EditorState(options.bank or DEFAULT_BANK, material=options.material)
    described = str(options.camera_file[0]) if options.camera_file else None
    if initial is not None:
        editor.load_bed(initial, described)
    elif options.arm is None and options.dataset is None:
        depth = levelled_world().look()
        editor.see(image_of_depth(depth, editor.camera, where="simulated bed").image, "simulated")
    if desired is not None:
        editor.load_goal(desired, described)
    port = free_port(options.host, options.port)
    boxes = None if options.dataset is None else Annotation(options.dataset)
    context = AppContext(None, "", options.out, described)
    opened: Any = nullcontext()
    if options.arm is not None:
        out = context.next_run()  # that it can be written shows before the arm is opened
        opened = robot_of(options, out, editor.bank)
    with opened as robot:
        context.robot, context.arm = robot, options.arm or ""
        serve_studio(editor, context, boxes, host=options.host, port=port, show=not options.no_open)
        context.end()
    return {"out": str(context.out)}
