"""`jshape view RUN`: a plan or a run in 3-D, in the browser or as a Rerun recording."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from jshape.app.ports import free_port, url
from jshape.cli.options import File, Serves, Writes
from jshape.errors import needs
from jshape.io.cameras import read_camera


@dataclass(frozen=True, kw_only=True)
class ViewOptions(Serves, Writes):
    """Of `jshape view`."""

    save: Annotated[Path | None, Parameter(metavar="FILE.rrd")] = None
    """Rerun recording to write instead of opening a browser."""
    camera_file: Annotated[Path | None, File] = None
    """camera.json of the run, where its bank is gone."""


def view(run: Path, /, options: ViewOptions = ViewOptions()) -> dict[str, Any]:
    """Read the episode; write it, or show it until Ctrl-C.

    Args:
      run: A run's or a plan's folder, or plan.json.
    """
    from jshape.app.view.read import read_episode
    from jshape.app.view.recording import check_target, write_recording

    if options.save is not None:
        check_target(options.save, options.overwrite)
    camera = None if options.camera_file is None else read_camera(options.camera_file, 1.0)[0]
    episode = read_episode(run, camera=camera)
    print("\n".join([episode.title, *episode.notes]), flush=True)
    result = {
        "title": episode.title,
        "steps": [episode.words(k) for k in range(len(episode.steps))],
        "notes": list(episode.notes),
    }
    if options.save is None:
        return result | {"url": _show(episode, options)}
    out = write_recording(options.save, episode, overwrite=options.overwrite)
    print(f"Rerun recording: {out}")
    return result | {"recording": str(out)}


def _show(episode: Any, options: ViewOptions) -> str:
    """Serve the episode until Ctrl-C; returns where it was."""
    with needs("studio", "the viewer"):
        from jshape.app.view.page import serve_episode
    port = free_port(options.host, options.port)
    serve_episode(episode, host=options.host, port=port, show=not options.no_open)
    return url(options.host, port)
