"""`jshape camera list`."""

from typing import Any

from cyclopts import App

from jshape.cli.options import Common
from jshape.cli.tables import print_table

camera = App(name="camera")


@camera.command(name="list")
def list_cameras(*, options: Common = Common()) -> dict[str, Any]:
    """The RealSense cameras that are connected, and what else opens."""
    from jshape.robot.cameras.names import names
    from jshape.robot.cameras.realsense import devices

    found = devices()
    if found:
        print_table(("camera", "name"), [(f"realsense:{d.serial}", d.name) for d in found])
    else:
        print("no RealSense camera is connected")
    print("\nwhat opens as a camera:")
    print_table(("name", "what it is"), names())
    return {"devices": [{"name": d.name, "serial": d.serial} for d in found]}
