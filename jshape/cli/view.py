"""`jshape view RUN`: a plan or a run in 3-D, in the browser or as a Rerun recording."""

import argparse
import signal
import sys
import webbrowser
from pathlib import Path
from typing import Any

from jshape.app.ports import LOCAL
from jshape.cli import arguments
from jshape.io.cameras import read_camera

PORT = 8080


def view(options: argparse.Namespace) -> dict[str, Any]:
    """Read the story; write it, or show it until Ctrl-C."""
    from jshape.app.view.read import read_story
    from jshape.app.view.recording import check_target, write_recording

    if options.save is not None:
        check_target(options.save, options.overwrite)
    camera = None if options.camera_file is None else read_camera(options.camera_file, 1.0)[0]
    story = read_story(options.run_folder, camera=camera)
    if not options.json:
        print("\n".join([story.title, *story.notes]), flush=True)
    result = {
        "title": story.title,
        "steps": [moment.words for moment in story.moments],
        "notes": list(story.notes),
    }
    if options.save is None:
        return result | {"url": _show(story, options)}
    out = write_recording(options.save, story, overwrite=options.overwrite)
    if not options.json:
        print(f"Rerun recording: {out}")
    return result | {"recording": str(out)}


def _show(story: Any, options: argparse.Namespace) -> str:
    """Serve the story until Ctrl-C; returns where it was."""
    from jshape.app.view.browser import Viewer

    before = signal.signal(signal.SIGTERM, _interrupt)
    try:
        with Viewer(story, host=options.host, port=options.port) as viewer:
            try:
                if options.host not in LOCAL:
                    print(f"anybody who reaches {options.host} can look", file=sys.stderr)
                print(f"it is at {viewer.url}; Ctrl-C ends it", file=sys.stderr, flush=True)
                if not options.no_open:
                    webbrowser.open(viewer.url)
                viewer.wait()
            except KeyboardInterrupt:
                pass  # the way to end it
            return viewer.url
    finally:
        signal.signal(signal.SIGTERM, before)


def _interrupt(number: int, frame: Any) -> None:
    raise KeyboardInterrupt


def add(commands: Any) -> None:
    """The parser of `jshape view`."""
    parser = arguments.command(commands, "view", view)
    parser.add_argument(
        "run_folder", type=Path, metavar="RUN", help="a run's or a plan's folder, or plan.json"
    )
    parser.add_argument(
        "--save", type=Path, metavar="FILE.rrd", help="write a Rerun recording, open no browser"
    )
    parser.add_argument("--host", default="127.0.0.1", help="to listen at (127.0.0.1: only here)")
    parser.add_argument(
        "--port", type=arguments.port, default=PORT, help=f"to listen at ({PORT}; 0: any free one)"
    )
    parser.add_argument("--no-open", action="store_true", help="open no browser")
    parser.add_argument(
        "--camera-file", type=Path, metavar="FILE", help="camera.json, if the run's bank is gone"
    )
