"""Point clouds and meshes on disk, and the goals that they become."""

import io
import struct
import time

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from jshape import PAPER_BOX, Camera
from jshape.errors import BadFile, BadImage, JShapeError
from jshape.io import mesh
from jshape.io.mesh import depth_of_faces
from jshape.io.points import depth_of_points, read_cloud, read_mesh

SMALL = Camera(40, 30, 50.0, 50.0, 19.5, 14.5, 0.4, 0.5)


def read_points(path):
    return read_mesh(path)[0]


@pytest.fixture
def cloud(rng):
    return rng.uniform((-0.1, -0.1, 0.41), (0.1, 0.1, 0.49), (200, 3)).astype(np.float32)


def put(folder, name, content):
    (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return folder / name


def pcd(points, data="ascii", fields="x y z", kind="F", size=4, extra=()):
    """A PCD whose fields other than x, y, z are zeros."""
    names = fields.split()
    code = {("F", 4): "<f4", ("F", 8): "<f8", ("I", 4): "<i4"}[kind, size]
    table = np.zeros(len(points), [(n, code) for n in names])
    for k, axis in enumerate("xyz"):
        if axis in names:
            table[axis] = points[:, k]
    lines = [
        "# .PCD v0.7 - Point Cloud Data file format", "VERSION 0.7", f"FIELDS {fields}",
        "SIZE " + " ".join([str(size)] * len(names)), "TYPE " + " ".join([kind] * len(names)),
        "COUNT " + " ".join(["1"] * len(names)), f"WIDTH {len(points)}", "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0", f"POINTS {len(points)}", *extra, f"DATA {data}",
    ]  # fmt: skip
    head = ("\n".join(lines) + "\n").encode()
    if data == "binary":
        return head + table.tobytes()
    if data == "binary_compressed":
        plain = b"".join(table[name].tobytes() for name in names)  # field by field
        packed = lzf(plain)
        return head + struct.pack("<II", len(packed), len(plain)) + packed
    return head + "\n".join(" ".join(repr(float(x)) for x in row) for row in table).encode()


def lzf(data):
    """What the format's rules allow, greedily: copies of 3 to 264 bytes, up to 8 KiB back."""
    out, at, fresh = b"", 0, b""

    def flush(fresh):
        runs = [fresh[k : k + 32] for k in range(0, len(fresh), 32)]
        return b"".join(bytes([len(run) - 1]) + run for run in runs)

    while at < len(data):
        length, back = 0, 0
        for near in range(1, min(at, 64) + 1):  # near enough for zeros and repeated numbers
            k = 0
            while k < 264 and at + k < len(data) and data[at + k] == data[at - near + k]:
                k += 1
            length, back = max((length, back), (k, near))
        if length < 3:
            fresh, at = fresh + data[at : at + 1], at + 1
            continue
        more, far = length - 2, back - 1
        code = bytes([more << 5 | far >> 8]) if more < 7 else bytes([7 << 5 | far >> 8, more - 7])
        out, fresh, at = out + flush(fresh) + code + bytes([far & 255]), b"", at + length
    return out + flush(fresh)


def ply(points, faces=None, encoding="binary"):
    if faces is None:
        return trimesh.PointCloud(points).export(file_type="ply", encoding=encoding)
    mesh = trimesh.Trimesh(points, faces, process=False)
    return mesh.export(file_type="ply", encoding=encoding)


@pytest.mark.parametrize("encoding", ["binary", "ascii"])
def test_ply(tmp_path, cloud, encoding):
    found = read_points(put(tmp_path, "a.PLY", ply(cloud, encoding=encoding)))
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, cloud, atol=1e-6)


@pytest.mark.parametrize("encoding", ["binary", "ascii"])
def test_the_vertices_of_a_mesh_are_its_points(tmp_path, encoding):
    box = trimesh.creation.box()
    found = read_points(put(tmp_path, "a.ply", ply(box.vertices, box.faces, encoding)))
    np.testing.assert_allclose(found, box.vertices, atol=1e-6)


@pytest.mark.parametrize("size", [4, 8])
@pytest.mark.parametrize("data", ["ascii", "binary", "binary_compressed"])
@pytest.mark.parametrize("fields", ["x y z", "rgb z y intensity x"])
def test_pcd(tmp_path, cloud, data, fields, size):
    found = read_points(put(tmp_path, "a.pcd", pcd(cloud, data, fields, size=size)))
    np.testing.assert_allclose(found, cloud, rtol=1e-6)


def test_pcd_without_count_and_points_and_with_wide_fields(tmp_path):
    text = "VERSION .7\nFIELDS n x y z\nSIZE 4 4 4 4\nTYPE F F F F\nWIDTH 2\nHEIGHT 1\nDATA ascii\n"
    found = read_points(put(tmp_path, "a.pcd", text + "9 1 2 3\n\n9 4 5 nan\n"))
    np.testing.assert_array_equal(found, [[1, 2, 3]])
    wide = text.replace("WIDTH", "COUNT 3 1 1 1\nWIDTH") + "9 9 9 1 2 3\n9 9 9 4 5 6\n"
    found = read_points(put(tmp_path, "b.pcd", wide))
    np.testing.assert_array_equal(found, [[1, 2, 3], [4, 5, 6]])


def test_points_that_are_not_finite_are_dropped(tmp_path, cloud):
    cloud[3], cloud[7, 1], cloud[9, 2] = np.nan, np.inf, -np.inf
    kept = np.delete(cloud, [3, 7, 9], 0)
    for name, content in (("a.pcd", pcd(cloud, "binary")), ("a.ply", ply(cloud))):
        np.testing.assert_allclose(read_points(put(tmp_path, name, content)), kept, atol=1e-6)


def packed_pcd(packed, count):
    """A compressed PCD that claims so many points of three numbers."""
    head = pcd(ONE, "binary_compressed").split(b"_compressed\n")[0] + b"_compressed\n"
    head = head.replace(b"POINTS 1", b"POINTS %d" % count)
    return head + struct.pack("<II", len(packed), 12 * count) + packed


ONE = np.array([[0.0, 0.0, 0.45]])
PLY_HEAD = "ply\nformat ascii 1.0\nelement vertex {}\n"
XYZ = "property float x\nproperty float y\nproperty float z\nend_header\n"
BAD = {
    "empty.ply": (b"", "empty"),
    "empty.pcd": (b"", "empty"),
    "text.ply": (b"hello", "not a PLY"),
    "text.pcd": (b"hello", "has no DATA"),
    "head.ply": (b"ply\n", "damaged"),
    "none.ply": (PLY_HEAD.format(0) + XYZ, "no points"),
    "x.ply": (PLY_HEAD.format(3) + "property float x\nend_header\n1\n2\n3\n", "damaged"),
    "short.ply": (ply(np.ones((9, 3)))[:-5], "damaged"),
    "claims.ply": (
        b"ply\nformat binary_little_endian 1.0\nelement vertex 999999999\n" + XYZ.encode() + b"x",
        "damaged",
    ),
    "face.ply": (
        PLY_HEAD.format(3) + XYZ.replace("end_header", "element face 1\nproperty list uchar int "
        "vertex_indices\nend_header") + "0 0 1\n1 0 1\n0 1 1\n3 0 1 99\n", "face",
    ),
    "nan.ply": (ply(np.full((4, 3), np.nan)), "none of its 4 points is finite"),
    "nan.pcd": (pcd(ONE * np.nan), "none of its 1 points is finite"),
    "zero.pcd": (pcd(ONE[:0]), "no points"),
    "packed.pcd": (pcd(ONE, "binary_compressed")[:-1], "cut off"),
    "damaged.pcd": (packed_pcd(b"\xe0\xff\xff", 1), "damaged"),
    "more.pcd": (packed_pcd(b"\1ab\xe0\xff\0", 1), "damaged"),
    "claims.pcd": (
        packed_pcd(b"\0\0\0", 99_999_999),
        "unpacks to 1,199,999,988 bytes; at most 134,217,728 are read",
    ),
    "data.pcd": (pcd(ONE, "base64"), "'base64'; allowed: ascii, binary"),
    "xy.pcd": (pcd(ONE, fields="x y"), "x, y and z are needed"),
    "int.pcd": (pcd(ONE, kind="I"), "must each be one F4 or F8"),
    "cut.pcd": (pcd(ONE, "binary")[:-1], "cut off"),
    "cut_ascii.pcd": (pcd(np.repeat(ONE, 3, 0)).rsplit(b"\n", 1)[0], "3 points of 3 numbers"),
    "width.pcd": (pcd(ONE) + b" 7", "points of 3 numbers"),
    "word.pcd": (pcd(ONE).replace(b"0.4499", b"deep"), "could not convert"),
    "points.pcd": (pcd(ONE).replace(b"POINTS 1", b"POINTS many"), "invalid literal"),
    "size.pcd": (pcd(ONE).replace(b"SIZE 4 4 4", b"SIZE 4 4"), "damaged"),
    "type.pcd": (pcd(ONE).replace(b"TYPE F F F", b"TYPE F F Q"), "<q4"),
    "many.pcd": (pcd(ONE, "binary").replace(b"POINTS 1", b"POINTS 9999999999"), "cut off"),
    "cloud.xyz": (b"1 2 3", "allowed: .ply, .obj, .stl, .pcd"),
    "cloud": (b"1 2 3", "allowed: .ply, .obj, .stl, .pcd"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_a_wrong_file_is_refused_in_one_line(tmp_path, name, capfd):
    content, match = BAD[name]
    path = put(tmp_path, name, content)
    with pytest.raises(BadFile) as info:
        read_points(path)
    message = str(info.value)
    assert message.startswith(f"{path}: ") and match in message and "\n" not in message
    assert capfd.readouterr() == ("", "")


@settings(max_examples=80)
@given(st.data(), st.sampled_from(["a.ply", "b.ply", "a.pcd", "b.pcd"]))
def test_a_damaged_file_never_escapes_as_another_error(tmp_path_factory, data, name):
    points = np.arange(12.0).reshape(4, 3)
    content = bytearray(
        {
            "a.ply": ply(points), "b.ply": ply(points, [[0, 1, 2]], "ascii"),
            "a.pcd": pcd(points), "b.pcd": pcd(points, "binary"),
        }[name]
    )  # fmt: skip
    for _ in range(data.draw(st.integers(1, 3))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    try:
        read_points(put(tmp_path_factory.getbasetemp(), name, bytes(content)))
    except JShapeError as problem:
        assert "\n" not in str(problem)


@pytest.mark.parametrize("name", ["none.ply", "folder.ply", "none.pcd"])
def test_no_such_file(tmp_path, name):
    (tmp_path / "folder.ply").mkdir()
    with pytest.raises(BadFile):
        read_points(tmp_path / name)


def test_a_cloud_of_what_the_camera_saw_gives_it_back(tmp_path, rng):
    level = rng.integers(0, 256, SMALL.shape)
    cloud = np.asarray(SMALL.points(level)).reshape(-1, 3)
    depth = read_cloud(put(tmp_path, "a.pcd", pcd(cloud, "binary")), SMALL)
    assert depth.dtype == np.float32
    np.testing.assert_allclose(depth, SMALL.depth(level), atol=1e-6)


def test_points_fall_where_the_camera_projects_them(cloud):
    depth = depth_of_points(cloud, SMALL)
    level = np.asarray(SMALL.project(cloud, quantize=False))
    np.testing.assert_array_equal(np.isnan(depth), level == 0)
    np.testing.assert_allclose(
        np.nan_to_num(SMALL.luminance(depth, quantize=False)), level, atol=0.01
    )


def test_pixels_without_a_point_are_missing_and_not_black():
    level = np.full(SMALL.shape, 100)
    level[0, :5] = 0  # at the far end of the range: black, and seen
    cloud = np.asarray(SMALL.points(level)).reshape(SMALL.shape + (3,))
    seen = np.ones(SMALL.shape, bool)
    seen[10:12, 20:25] = False
    depth = depth_of_points(cloud[seen], SMALL)
    np.testing.assert_array_equal(np.isnan(depth), ~seen)
    np.testing.assert_allclose(depth[0, :5], 0.5, rtol=1e-6)


def test_the_nearest_point_wins_and_the_far_ones_stay_far():
    points = np.array([[0, 0, 0.48], [0, 0, 0.45], [0.09, 0, 0.9], [0, 0, -1]], np.float32)
    depth = depth_of_points(points, SMALL)
    found = depth[np.isfinite(depth)]
    np.testing.assert_allclose(np.sort(found), [0.45, 0.9], rtol=1e-5)


@pytest.mark.parametrize(
    "point", [(0, 0, 0.9), (0, 0, 0.2), (0, 0, -0.45), (9, 0, 0.45), (0, 0, 0), (0, 0, 1e30)]
)
def test_a_cloud_out_of_view_or_range_is_refused(point):
    with pytest.raises(BadImage, match="no point is in view") as info:
        depth_of_points(np.array([point], np.float32), SMALL, "cloud.ply")
    assert "0.4 to 0.5 m" in str(info.value) and "\n" not in str(info.value)


def test_without_the_range_something_must_still_be_in_view(tmp_path):
    far, aside = np.array([[[0, 0, 0.9]], [[9, 0, 0.45]]], np.float32)
    depth = depth_of_points(far, SMALL, check_range=False)
    np.testing.assert_allclose(depth[np.isfinite(depth)], [0.9])
    path = put(tmp_path, "far.ply", ply(far))
    np.testing.assert_array_equal(read_cloud(path, SMALL, check_range=False), depth)
    with pytest.raises(BadImage, match="no point is in view of the camera; the points") as info:
        depth_of_points(aside, SMALL, "cloud.ply", check_range=False)
    assert "\n" not in str(info.value)


def test_a_mesh_mostly_out_of_range_keeps_its_depths(tmp_path):
    """So that whoever asks how much of it is out of range gets a true answer."""
    slab = np.array([[-1, -1, 0.9], [1, -1, 0.9], [1, 1, 0.9], [-1, 1, 0.9]])
    chip = np.array([[-0.01, -0.01, 0.45], [0.01, -0.01, 0.45], [0, 0.01, 0.45]])
    faces = [[0, 1, 2], [0, 2, 3], [4, 5, 6]]
    path = put(tmp_path, "a.ply", ply(np.concatenate([slab, chip]), faces))
    depth = read_cloud(path, SMALL)
    assert set(np.round(depth.ravel(), 5).tolist()) == {np.float32(0.9), np.float32(0.45)}
    assert np.mean(depth > 0.5) > 0.98
    path = put(tmp_path, "b.ply", ply(slab, faces[:2]))
    with pytest.raises(BadImage, match="no point is in view"):
        read_cloud(path, SMALL)
    np.testing.assert_allclose(read_cloud(path, SMALL, check_range=False), 0.9, rtol=1e-5)


@pytest.mark.parametrize("z", [1e6, 3e38])
def test_a_far_point_does_not_spoil_the_near_ones(cloud, z):
    far = np.concatenate([cloud, [[0, 0, z]]]).astype(np.float32)
    near, both = depth_of_points(cloud, SMALL), depth_of_points(far, SMALL)
    assert np.sum(~np.isclose(near, both, rtol=1e-6, equal_nan=True)) <= 1  # its own pixel


def test_the_faces_of_a_mesh_fill_the_image(tmp_path):
    corners = np.array([[-1, -1, 0.42], [1, -1, 0.42], [1, 1, 0.48], [-1, 1, 0.48]])
    path = put(tmp_path, "slab.ply", ply(corners, [[0, 1, 2], [0, 2, 3]]))
    depth = read_cloud(path, PAPER_BOX)
    assert not np.isnan(depth).any()
    # The plane z = 0.45 + 0.03 y along the ray y = t z.
    t = np.asarray(PAPER_BOX.rays()[1])
    plane = np.broadcast_to(0.45 / (1 - 0.03 * t), depth.shape)
    np.testing.assert_allclose(depth, plane, rtol=1e-5)


def test_faces_are_drawn_as_rays_meet_them(rng):
    """Against one ray at a time, in plain NumPy."""
    points = rng.uniform((-0.3, -0.2, 0.3), (0.3, 0.2, 0.6), (30, 3)).astype(np.float32)
    points[:3, 2] -= 0.7  # behind the camera
    faces = rng.integers(0, 30, (8, 3))
    depth = depth_of_faces(points, faces, SMALL)
    x, y = (np.asarray(a, np.float64) for a in SMALL.rays())
    expected = np.full(SMALL.shape, np.nan)
    for corners in points[faces].astype(np.float64):
        if (corners[:, 2] <= 0).any() or np.linalg.matrix_rank(corners) < 3:
            continue
        for v, u in np.ndindex(SMALL.shape):
            share = np.linalg.solve(corners.T, [x[0, u], y[v, 0], 1.0])
            if (share >= 0).all():
                expected[v, u] = np.fmin(expected[v, u], 1 / share.sum())
    assert 0.1 < np.isnan(expected).mean() < 0.9
    differs = ~np.isclose(depth, expected, rtol=1e-5, equal_nan=True)
    assert differs.mean() < 0.002  # a ray that grazes an edge


def test_a_fine_mesh_and_a_coarse_one_of_the_same_plane_agree():
    corners = np.array([[-1, -1, 0.42], [1, -1, 0.42], [1, 1, 0.48], [-1, 1, 0.48]])
    coarse = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    fine = coarse.subdivide().subdivide().subdivide().subdivide().subdivide()
    images = [
        depth_of_faces(np.asarray(m.vertices, np.float32), np.asarray(m.faces), SMALL)
        for m in (coarse, fine)
    ]
    np.testing.assert_allclose(*images, rtol=1e-5)
    assert not np.isnan(images[0]).any()


def test_a_mesh_out_of_view_or_too_costly_is_refused(tmp_path, monkeypatch):
    corners = np.array([[-1, -1, 0.45], [1, -1, 0.45], [0, 1, 0.45]])
    with pytest.raises(BadImage, match="no point is in view"):
        read_cloud(put(tmp_path, "a.ply", ply(corners + [0, 0, 1], [[0, 1, 2]])), SMALL)
    monkeypatch.setattr(mesh, "_MOST", 1000)
    with pytest.raises(BadFile, match="simplify it"):
        read_cloud(put(tmp_path, "a.ply", ply(corners, [[0, 1, 2]])), SMALL)


def test_nothing_that_a_ply_names_is_opened(tmp_path, cloud, monkeypatch):
    content = ply(cloud, encoding="binary").replace(
        b"element vertex", b"comment TextureFile /etc/passwd\nelement vertex", 1
    )
    path = put(tmp_path, "a.ply", content)
    opened = []
    real_open = io.open
    monkeypatch.setattr("builtins.open", lambda p, *a, **k: opened.append(p) or real_open(p, *a))
    assert len(read_points(path)) == len(cloud)
    assert not any("passwd" in str(p) for p in opened)


def test_measured_dough(shared_data):
    found = sorted(shared_data.glob("real/dough/*.ply"))
    assert found
    for path in found:
        points = read_points(path)
        assert points.shape == (4096, 3) and np.ptp(points, 0).max() < 0.2
    with pytest.raises(BadImage, match="no point is in view"):
        read_cloud(found[0], PAPER_BOX)  # z is height above the table there, not depth


def test_a_count_of_a_field_is_checked(tmp_path):
    content = pcd(ONE).replace(b"COUNT 1 1 1", b"COUNT 1 1 -1")
    with pytest.raises(BadFile, match="damaged"):
        read_points(put(tmp_path, "a.pcd", content))


TETRAHEDRON = np.array([[0, 0, 0], [40, 0, 0], [0, 40, 0], [0, 0, 15]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])


def solids():
    """The same tetrahedron as people's programs write it, by file name."""
    corners = "".join(f"v {x} {y} {z}\n" for x, y, z in TETRAHEDRON)
    faces = [f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in FACES]
    groups = "mtllib none.mtl\no one\n{}usemtl red\ng a\n{}{}usemtl blue\ns 1\n{}{}"
    half = trimesh.Trimesh(TETRAHEDRON, FACES[:2], process=False)
    rest = trimesh.Trimesh(TETRAHEDRON, FACES[2:], process=False)
    whole = trimesh.Trimesh(TETRAHEDRON, FACES, process=False).export(file_type="stl")
    texts = [part.export(file_type="stl_ascii") for part in (half, rest)]
    return {
        "two.OBJ": groups.format(corners, *faces).encode(),
        "thousands.obj": (corners + "".join(
            f"usemtl m{k}\n{face}" for k, face in enumerate(faces * 2_000)
        )).encode(),
        "two.STL": "\n".join(texts).encode(),
        "trailing.stl": whole + b"made by a slicer\n",
        "named_solid.stl": b"solid".ljust(80) + whole[80:],
        "mesh.PLY": ply(TETRAHEDRON, FACES),
    }  # fmt: skip


@pytest.mark.parametrize("name", solids())
def test_a_solid_is_read_whole(tmp_path, name):
    start = time.monotonic()
    points, faces = read_mesh(put(tmp_path, name, solids()[name]))
    assert time.monotonic() - start < 5, "20,000 materials took 8 minutes"
    found = points[faces].astype(float)
    volume = np.abs(np.einsum("fi,fi->f", found[:, 0], np.cross(found[:, 1], found[:, 2])).sum())
    assert volume / 6 == pytest.approx((2_000 if "thousands" in name else 1) * 4000)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("cut.stl", solids()["trailing.stl"][:150], "STL is damaged, cut off or holds no points"),
        ("claims.stl", b"x" * 80 + b"\xff" * 4 + b"y" * 50, "STL is damaged, cut off"),
        ("word.stl", b"solid a\nvertex 0 0 0\nvertex 1 0 zero\nvertex 1 1 0", "STL is damaged"),
        ("huge.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 999999999\n", "OBJ is damaged"),
    ],
)
def test_a_damaged_solid_is_refused_in_one_line(tmp_path, name, content, said):
    with pytest.raises(BadFile, match=said) as problem:
        read_mesh(put(tmp_path, name, content))
    assert "\n" not in str(problem.value)
