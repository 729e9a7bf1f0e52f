"""`jshape view RUN`: a plan or a run in 3-D, in the browser."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from jshape.app.ports import free_port, url
from jshape.cli.options import File, Serves
from jshape.errors import needs
from jshape.io.cameras import read_camera


@dataclass(frozen=True, kw_only=True)
class ViewOptions(Serves):
    """Of `jshape view`."""

    camera_file: Annotated[Path | None, File] = None
    """camera.json of the run, where its bank is gone."""


def view(run: Path, /, options: ViewOptions = ViewOptions()) -> dict[str, Any]:
    """Read the episode and show it until Ctrl-C.

    Args:
      run: A run's or a plan's folder, or plan.json.
    """
    from jshape.app.view.read import read_episode

    camera = None if options.camera_file is None else read_camera(options.camera_file, 1.0)[0]
    episode = read_episode(run, camera=camera)
    print("\n".join([episode.title, *episode.notes]), flush=True)
    with needs("studio", "the viewer"):
        from jshape.app.view.page import serve_episode
    port = free_port(options.host, options.port)
    serve_episode(episode, host=options.host, port=port, show=not options.no_open)
    return {
        "title": episode.title,
        "steps": [step.words for step in episode.steps],
        "notes": list(episode.notes),
        "url": url(options.host, port),
    }
