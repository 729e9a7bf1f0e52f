"""`jshape studio`: a local web page to load, draw, plan, edit, carry out and annotate."""

import argparse
import sys
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Any

from jshape.app.ports import LOCAL, free_port, url
from jshape.cli import arguments
from jshape.cli.robot import add_robot, robot_of
from jshape.data.view import image_of_depth
from jshape.errors import JShapeError
from jshape.planning.options import DEFAULT_BANK
from jshape.robot.cameras.simulated import levelled_world

PORT = 8077


def studio(options: argparse.Namespace) -> dict[str, Any]:
    """Open the page; it runs until Ctrl-C."""
    try:
        from jshape.app.server import serve
    except ModuleNotFoundError as problem:
        raise JShapeError(
            f"the studio needs {problem.name}: pip install 'jshape[studio]'"
        ) from None
    from jshape.app.annotation import Annotation
    from jshape.app.bench import Bench
    from jshape.app.desk import Desk

    desk = Desk(options.bank or DEFAULT_BANK, material=options.material)
    options.resume, options.yes, options.overwrite = False, True, False  # the page asks
    if options.initial is not None:
        desk.load_bed(options.initial, options.camera_file, reproject=options.reproject)
    elif options.arm is None and options.dataset is None:
        depth = levelled_world().look()
        desk.see(image_of_depth(depth, desk.camera, where="simulated bed").image, "simulated")
    if options.desired is not None:
        desk.load_goal(options.desired, options.camera_file, reproject=options.reproject)
    if options.host not in LOCAL:
        print(f"anybody who reaches {options.host} can use this page", file=sys.stderr)
    port = free_port(options.host, options.port)
    boxes = None if options.dataset is None else Annotation(options.dataset)
    bench = Bench(None, "", options.out, options.camera_file, options.reproject)
    opened: Any = nullcontext()
    if options.arm is not None:
        options.out = bench.next_run()  # that it can be written shows before the arm is opened
        opened = robot_of(options, desk.bank, lambda line: print(line, flush=True))
    with opened as robot:
        bench.robot, bench.arm = robot, options.arm or ""
        print(f"the studio is at {url(options.host, port)}; Ctrl-C ends it", flush=True)
        with suppress(KeyboardInterrupt):  # how people end it
            serve(desk, bench, boxes, host=options.host, port=port,
                  show=not options.no_open)  # fmt: skip
        bench.end()
    return {"out": str(bench.out)}


def add(commands: Any) -> None:
    """The parser of `jshape studio`."""
    parser = arguments.command(commands, "studio", studio, writes=False)
    parser.add_argument("initial", type=Path, nargs="?", help="depth image of the bed")
    parser.add_argument("desired", type=Path, nargs="?", help="depth image wanted, PLY or PCD")
    parser.add_argument("--dataset", type=Path, help="to annotate: a folder with pairs.csv")
    add_robot(parser, None)
    parser.add_argument("--bank", default=None, help="name or folder (default: the bundled one)")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("studio"),
        help="for runs and what is saved (studio)",
    )
    parser.add_argument("--host", default="127.0.0.1", help="to listen at (127.0.0.1: only here)")
    parser.add_argument(
        "--port", type=arguments.port, default=PORT, help=f"to listen at ({PORT}; 0: any free one)"
    )
    parser.add_argument("--no-open", action="store_true", help="open no browser")
