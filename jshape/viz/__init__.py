"""Pictures of plans and runs."""

from importlib.util import find_spec

from jshape.errors import JShapeError

if find_spec("matplotlib") is None:  # loading it is for whoever draws
    raise JShapeError("drawing needs matplotlib: pip install 'jshape[cli]'")
