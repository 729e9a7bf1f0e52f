"""Point clouds and meshes on disk, and as depth images.

Points are (P, 3) float32 in metres, in the camera's frame where they become an image: X along the
columns, Y along the rows, Z along the optical axis.
"""

import io
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from jshape._typing import Float, Int
from jshape.camera import Camera
from jshape.data.depth import outside_range
from jshape.errors import BadFile, BadImage, needs, told
from jshape.io.files import read_bytes
from jshape.io.mesh import depth_of_faces
from jshape.io.pcd import parse_pcd

FILE_LIMIT = 512 * 2**20
"""Largest point cloud file that is read, bytes."""
SUFFIXES = (".ply", ".pcd")
"""Files that are read as point clouds; everything else is taken for an image."""

_FACE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("colour", "<u2")])
_VERTEX = re.compile(
    rb"^[ \t]*vertex[ \t]+(\S+)[ \t]+(\S+)[ \t]+(\S+)", re.IGNORECASE | re.MULTILINE
)
_GROUPS = re.compile(rb"^[ \t]*(?:usemtl|mtllib|o|g|s)\b[^\n]*$", re.MULTILINE)


def read_cloud(
    path: str | os.PathLike, camera: Camera, *, check_range: bool = True
) -> Float[np.ndarray, "H W"]:
    """What a camera would see of the points or mesh of a file in its frame; see `depth_of_points`.

    Raises BadFile: it cannot be read; BadImage: nothing of it is in view.
    """
    points, faces = read_mesh(path)
    return depth_of_points(points, camera, str(path), faces=faces, check_range=check_range)


def depth_of_points(
    points: Float[np.ndarray, "P 3"],
    camera: Camera,
    where: str = "points",
    *,
    faces: Int[np.ndarray, "F 3"] | None = None,
    check_range: bool = True,
) -> Float[np.ndarray, "H W"]:
    """The depth image of points, or of the faces between them, in the camera's frame.

    As `Camera.project` in metres, except that a pixel that nothing reaches is NaN and not black,
    and that a depth beyond the camera's range stays what it is.

    Raises BadImage: nothing is in view and, if `check_range`, within the camera's range.
    """
    if faces is None or not len(faces):
        depth = _nearest(points, camera)
    else:
        depth = depth_of_faces(points, faces, camera, where)
    seen = ~outside_range(depth, camera) & (depth > 0) if check_range else depth >= 0
    if seen.any():
        return depth
    within = f" within {float(camera.z_min):g} to {float(camera.z_max):g} m" if check_range else ""
    low, high = points.min(0), points.max(0)
    span = ", ".join(f"{axis} {low[k]:.3g} to {high[k]:.3g}" for k, axis in enumerate("XYZ"))
    raise BadImage(
        f"{where}: no point is in view of the camera{within}; the points span {span} m "
        "(camera frame: Z along the optical axis)"
    )


def _nearest(points: np.ndarray, camera: Camera) -> np.ndarray:
    x, y, z = points[points[:, 2] > 0].T
    # Far to the side of a point at the lens a quotient overflows: infinity is not in the image.
    with np.errstate(over="ignore"):
        u, v = (np.rint(at) for at in camera.pixel(x, y, z))
    seen = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    depth = np.full(camera.shape, np.float32(np.inf))
    np.minimum.at(depth, (v[seen].astype(int), u[seen].astype(int)), z[seen])
    return np.where(np.isfinite(depth), depth, np.float32(np.nan))


def read_mesh(
    path: str | os.PathLike,
) -> tuple[Float[np.ndarray, "P 3"], Int[np.ndarray, "F 3"] | None]:
    """Points in the file's own unit, and the faces of a mesh (None: the file has none).

    Points with a coordinate that is not finite are dropped.

    Raises BadFile: the file cannot be read, is of another kind, damaged, or holds no point.
    """
    path = Path(path)
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise BadFile(f"{path}: is no point cloud or mesh; allowed: {', '.join(_READERS)}")
    points, faces = reader(path, read_bytes(path, limit=FILE_LIMIT))
    points = np.asarray(points)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0:
        raise BadFile(f"{path}: holds no points")
    with np.errstate(over="ignore"):
        points = points.astype(np.float32)
    finite = np.isfinite(points).all(1)
    if not finite.any():
        raise BadFile(f"{path}: none of its {len(points):,} points is finite")
    if finite.all():
        return points, faces
    if faces is not None:
        whole = np.take(finite, faces).all(1)
        faces = np.take(np.cumsum(finite) - 1, faces[whole])
    return points[finite], faces


def _stl(path: Path, data: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Corners and faces of an STL: of all its solids; bytes may follow (not in trimesh)."""
    count = int.from_bytes(data[80:84], "little")
    if 0 < 50 * count <= len(data) - 84:  # a text's bytes 80 to 84 would say half a billion faces
        corners = np.frombuffer(data, _FACE, count, 84)["corners"].reshape(-1, 3)
    else:
        words = _VERTEX.findall(data) if data.lstrip()[:5].lower() == b"solid" else []
        if not words or len(words) % 3:
            raise BadFile(
                f"{path}: the STL is damaged, cut off or holds no points (it has no face)"
            )
        try:
            corners = np.array(words).astype(np.float64)
        except ValueError:
            raise BadFile(f"{path}: the STL is damaged: a corner is not a number") from None
    return corners, np.arange(len(corners)).reshape(-1, 3)


def _ply_or_obj(path: Path, data: bytes) -> tuple[np.ndarray, np.ndarray | None]:
    """Points and faces of a PLY or OBJ."""
    kind = path.suffix.lower()[1:]
    name = kind.upper()
    with needs("mesh", f"{path}: reading {name}"):
        import trimesh
    if kind == "ply" and not data.startswith(b"ply"):
        raise BadFile(f"{path}: is not a PLY file")
    if kind == "obj":  # one mesh: trimesh makes one of each material, of thousands in minutes
        data = _GROUPS.sub(b"", data)
    try:
        # From memory and without a resolver: a texture that the file names is not looked for.
        found: Any = trimesh.load(
            io.BytesIO(data), file_type=kind, process=False, skip_materials=True
        )
        if isinstance(found, trimesh.Scene):
            raise BadFile("it has no face")
        points, faces = np.asarray(found.vertices), getattr(found, "faces", None)
        faces = None if faces is None else np.asarray(faces)
    except Exception as problem:  # trimesh promises no type for a damaged file
        reason = told(problem, 100)
        raise BadFile(f"{path}: the {name} is damaged or holds no points ({reason})") from None
    if faces is not None and len(faces) and not 0 <= faces.min() <= faces.max() < len(points):
        raise BadFile(f"{path}: a face of the {name} names a point that is not there")
    return points, faces


_READERS: dict[str, Callable[[Path, bytes], tuple[np.ndarray, np.ndarray | None]]] = {
    ".ply": _ply_or_obj,
    ".obj": _ply_or_obj,
    ".stl": _stl,
    ".pcd": lambda path, data: (parse_pcd(path, data), None),
}
"""The reader of each format: points, and faces if it has any."""
