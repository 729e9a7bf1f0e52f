"""Folders of frames before and after, made here in small, as data sets; and data sets joined."""

import json

import cv2
import numpy as np
import pytest

from jshape import Camera, load_pairs
from jshape.cli.main import main
from jshape.io.annotations import boxes_by_hand
from jshape.io.cameras import write_camera

CAMERA = Camera(80, 60, 90.0, 90.0, 39.5, 29.5, 0.4, 0.5)


@pytest.fixture(params=["suffixes", "folders"])
def before_after(request, tmp_path, rng):
    folder = tmp_path / "frames"
    for name, deeper in (("a", 90), ("b", 60)):
        for state in ("before", "after"):
            counts = np.rint(4500 + 2 * rng.standard_normal(CAMERA.shape)).astype(np.uint16)
            counts[20:35, 30:50] += deeper * (state == "after")
            path = folder / (
                f"{name}_{state}.png" if request.param == "suffixes" else f"{state}/{name}.png"
            )
            path.parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(path), counts)
    write_camera(folder / "camera.json", CAMERA, 1e-4)
    return folder


SAID = ("--agent", "human", "--material", "sand")


def import_frames(source, out, *more):
    arguments = ["dataset", "import", source, out, *more]
    return main([str(a) for a in arguments])


@pytest.mark.full
def test_before_and_after_frames_become_a_data_set(before_after, tmp_path, capsys):
    out = tmp_path / "out"
    assert import_frames(before_after, out, "--action", "poke", *SAID) == 0
    assert "2 pairs; next: jshape dataset annotate" in capsys.readouterr().out
    pairs = load_pairs(out)
    assert pairs.id.tolist() == ["a", "b"] and set(pairs.material) == {"sand"}
    first = pairs.centre - pairs.size // 2
    assert (first <= (30, 20)).all() and (first + pairs.size >= (50, 35)).all()
    assert main(["dataset", "annotate", str(out), str(tmp_path / "boxes")]) == 0
    np.testing.assert_allclose(load_pairs(tmp_path / "boxes").centre, [(40, 27)] * 2, atol=2)


def test_labels_by_name(before_after, tmp_path, capsys):
    labels = tmp_path / "labels.csv"
    labels.write_text("name,action\nb,knock\na,-\n")
    assert import_frames(before_after, tmp_path / "out", "--labels", labels, *SAID) == 0
    assert load_pairs(tmp_path / "out").action.tolist() == ["knock"]
    capsys.readouterr()
    for text, words in (
        ("name,action\nb,knock\n", "no row for 'a'"),
        ("name,action\na,x\nb,x\nc,x\n", "no frames for 'c'"),
        ("action\nx\n", "expected name,action"),
    ):
        labels.write_text(text)
        assert import_frames(before_after, tmp_path / "new", "--labels", labels, *SAID) == 2
        assert words in capsys.readouterr().err
    assert import_frames(before_after, tmp_path / "new", *SAID) == 2
    assert "give --action, or --labels" in capsys.readouterr().err


def one_of(folder, name, state):
    return next(p for p in (folder / f"{name}_{state}.png", folder / state / f"{name}.png")
                if p.exists())  # fmt: skip


@pytest.mark.parametrize(
    "unit, said",
    [
        (None, "depth_unit is missing: metres per count of the frames; 0.0001 would fit: the "),
        (0.001, "depth_unit 0.0001 instead of 0.001 would fit it"),
    ],
)
def test_no_unit_or_a_wrong_one_is_refused_with_the_one_that_fits(
    before_after, tmp_path, capsys, unit, said
):
    path = before_after / "camera.json"
    fields = {k: v for k, v in json.loads(path.read_text()).items() if k != "depth_unit"}
    path.write_text(json.dumps(fields | ({} if unit is None else {"depth_unit": unit})))
    assert import_frames(before_after, tmp_path / "out", "--action", "poke", *SAID) == 2
    text = capsys.readouterr().err
    assert said in text and text.count("\n") == 1 and not (tmp_path / "out").exists()


def test_pixels_without_depth_are_counted_by_reason(before_after, tmp_path, capsys):
    path = one_of(before_after, "a", "before")
    counts = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    counts[:5, :5] = 65535
    cv2.imwrite(str(path), counts)
    assert import_frames(before_after, tmp_path / "out", "--action", "poke", *SAID) == 0
    said = "25 pixels without depth (of them 25 at 65535 (the largest uint16))"
    assert said in capsys.readouterr().out
    assert (load_pairs(tmp_path / "out").prior[0, :5, :5] == 0).all()


def test_damage_is_named(before_after, tmp_path, capsys):
    path = one_of(before_after, "b", "after")
    good = path.read_bytes()

    def refused(words):
        assert import_frames(before_after, tmp_path / "out", "--action", "x", *SAID) == 2
        text = capsys.readouterr().err
        assert words in text and text.count("\n") == 1
        assert not (tmp_path / "out").exists()

    for content, words in (
        (b"", "empty"),
        (good[:-30], "cut off"),
        (cv2.imencode(".png", np.ones((9, 9), np.uint16))[1].tobytes(), "has 9x9 pixels"),
        (cv2.imencode(".png", np.zeros(CAMERA.shape, np.uint16))[1].tobytes(), "no pixel"),
    ):
        path.write_bytes(content)
        refused(words)
    path.unlink()
    refused("has no frame after the action")
    path.write_bytes(good)
    (before_after / "camera.json").unlink()
    refused("camera.json: no such file; it (or --camera FILE)")


def test_merge_joins_data_sets_of_one_camera(before_after, tmp_path, capsys):
    for action in ("poke", "knock"):
        assert import_frames(before_after, tmp_path / action, "--action", action, *SAID) == 0
    parts = [str(tmp_path / a) for a in ("poke", "knock")]
    assert main(["dataset", "merge", str(tmp_path / "all"), *parts]) == 0
    pairs = load_pairs(tmp_path / "all")
    assert pairs.id.tolist() == ["a", "b", "knock/a", "knock/b"]
    assert pairs.action.tolist() == ["poke"] * 2 + ["knock"] * 2
    assert not boxes_by_hand(tmp_path / "all").any()
    fields = json.loads((tmp_path / "knock" / "camera.json").read_text())
    (tmp_path / "knock" / "camera.json").write_text(json.dumps(fields | {"fx": 95.0}))
    capsys.readouterr()
    assert main(["dataset", "merge", str(tmp_path / "more"), *parts]) == 2
    assert "another camera: its fx is 95.0, that of" in capsys.readouterr().err
