"""Pairs of others: the authors' layout and folders of before/after frames, made here in small."""

import json
import shutil

import cv2
import numpy as np
import pytest

from jshape import D435_BAZAR, D435_NOMINAL, Camera, load_pairs, metric
from jshape.cli.main import main
from jshape.errors import BadDataset
from jshape.io.annotations import boxes_by_hand
from jshape.io.authors import authors_pairs, depth_unit_for, place_of_r, read_annotation
from jshape.io.cameras import write_camera

W, H = 60, 44
PLACES = {"0001": (200, 150), "0002": (788, 436)}  # the second in the last corner
XML = (
    "<root><action>{action}</action><name>img_0001.png</name><bbox><xmin>{0}</xmin>"
    "<ymin>{1}</ymin><xmax>{2}</xmax><ymax>{3}</ymax></bbox></root>"
)


def level(depth):
    """8-bit luminance of the paper's camera."""
    return np.rint(255 * (0.47 - depth) / 0.05).astype(np.uint8)


@pytest.fixture
def authors(tmp_path, rng):
    """The authors' layout: one agent, one action, an instance to train and one to test."""
    home = tmp_path / "src" / "human"
    rays = np.asarray(metric.ray_lengths(D435_NOMINAL))
    for split, name in (("train", "0001"), ("test", "0002")):
        left, top = PLACES[name]
        for state, deeper in (("beg", 0.0), ("end", 0.01)):
            folder = home / "data" / "fist" / split / state / f"{name}{state}"
            folder.mkdir(parents=True)
            depth = np.full((H, W), 0.45)
            depth[10:30, 15:45] += deeper
            for frame in range(6):
                noisy = depth + 0.0004 * rng.standard_normal(depth.shape)
                cv2.imwrite(str(folder / f"{name}{state}_{frame}.png"), level(noisy))
            r = home / "r_value" / "fist" / split / state
            r.mkdir(parents=True)
            crop = rays[top : top + H, left : left + W, None]
            np.save(r / f"{name}.npy", crop.astype(np.float64))
            notes = home / "annotation" / "fist" / state
            notes.mkdir(parents=True, exist_ok=True)
            box = (left, top, left + W, top + H)
            (notes / f"{name}{state}_1.xml").write_text(XML.format(*box, action="fist"))
    return tmp_path / "src"


def import_authors(source, out, *more):
    return main(["dataset", "import", str(source), str(out), "--layout", "authors", *more])


def test_the_authors_layout_becomes_a_data_set(authors, tmp_path, capsys):
    assert import_authors(authors, tmp_path / "out", "--json") == 0
    assert json.loads(capsys.readouterr().out)["groups"] == {"human fist": 2}
    pairs = load_pairs(tmp_path / "out")
    assert pairs.camera == D435_BAZAR and pairs.depth_unit == 1e-5
    assert pairs.id.tolist() == ["human_fist_train_0001", "human_fist_test_0002"]
    for k, name in enumerate(("0001", "0002")):
        left, top = PLACES[name]
        assert pairs.centre[k].tolist() == [left + W // 2, top + H // 2]
        assert pairs.size[k].tolist() == [W, H]
        window = np.s_[top : top + H, left : left + W]
        for frames, deeper in ((pairs.prior, 0.0), (pairs.posterior, 0.01)):
            depth = frames[k][window] * 1e-5
            # 0.2 mm a level and 0.4 mm noise, averaged over 6 frames
            assert depth[15:25, 20:40].mean() == pytest.approx(0.45 + deeper, abs=1e-4)
            outside = frames[k].copy()
            outside[window] = 0
            assert not outside.any() and depth.std() < 0.01
    prior, posterior = pairs.rois("fist")[:2]
    assert prior.shape == (2, H, W) and np.isfinite(posterior).all()
    assert boxes_by_hand(tmp_path / "out").all(), "the authors drew their boxes"
    # One agent's folder alone serves as well.
    assert import_authors(authors / "human", tmp_path / "one") == 0
    assert "2 pairs (2 human fist)" in capsys.readouterr().out


@pytest.mark.parametrize("lacking", ["r_value", "annotation"])
def test_either_r_or_the_annotation_says_the_place(authors, tmp_path, lacking):
    shutil.rmtree(authors / "human" / lacking)
    assert import_authors(authors, tmp_path / "out") == 0
    found = load_pairs(tmp_path / "out").centre
    expected = [(PLACES[n][0] + W // 2, PLACES[n][1] + H // 2) for n in ("0001", "0002")]
    np.testing.assert_array_equal(found, expected)


def test_r_tells_its_place_and_its_camera():
    for camera in (D435_NOMINAL, D435_BAZAR):
        rays = np.asarray(metric.ray_lengths(camera), np.float64)
        for left, top in ((0, 0), (400, 200), (790, 430)):
            crop = rays[top : top + 45, left : left + 40]
            assert place_of_r(crop, D435_BAZAR, "r") == (left, top)
    other = np.asarray(metric.ray_lengths(Camera(640, 480, 600.0, 600.0, 320.0, 240.0, 0.4, 0.5)))
    with pytest.raises(BadDataset, match="fx 60[0-9], fy .*; expected 433, 433 or 415, 373"):
        place_of_r(other[100:200, 100:200], D435_BAZAR, "r")
    with pytest.raises(BadDataset, match="expected|8x8"):
        place_of_r(np.ones((45, 40)), D435_BAZAR, "r")


def spoil_png(home, content):
    (home / "data/fist/train/beg/0001beg/0001beg_3.png").write_bytes(content)


def spoil_r(home, array):
    np.save(home / "r_value/fist/train/beg/0001.npy", array, allow_pickle=array.dtype == object)


def spoil_note(home, text):
    for path in (home / "annotation/fist/beg").glob("0001*"):
        path.write_text(text)


def lose(home, name):
    shutil.rmtree(home / name)


SPOILED = {
    "cut off": (lambda h: spoil_png(h, cv2.imencode(".png", np.ones((H, W), np.uint8))[1].tobytes()
                                    [:-20]), "0001beg_3.png: the PNG is cut off"),
    "another size": (lambda h: spoil_png(h, cv2.imencode(".png", np.ones((H, 9), np.uint8))[1]
                                         .tobytes()), "9x44 pixels; the first of its folder 60x44"),
    "16 bits": (lambda h: spoil_png(h, cv2.imencode(".png", np.ones((H, W), np.uint16))[1]
                                    .tobytes()), "the authors' crops have 8 bits"),
    "objects": (lambda h: spoil_r(h, np.array([[None]])), "Python objects, which are never loaded"),
    "R of another size": (lambda h: spoil_r(h, np.ones((9, 9))), "has shape (9, 9)"),
    "another place": (lambda h: spoil_note(h, XML.format(10, 10, 70, 54, action="fist")),
                      "puts it at (10, 10), but"),
    "no number": (lambda h: spoil_note(h, XML.format("x", 1, 2, 3, action="fist")),
                  "bbox/xmin is 'x'; it must be a whole number"),
    "empty box": (lambda h: spoil_note(h, XML.format(9, 1, 2, 3, action="fist")), "is empty"),
    "no XML": (lambda h: spoil_note(h, "<root>"), "not XML that can be read"),
    "no end": (lambda h: lose(h, "data/fist/train/end"), "instance 0001 is in beg but not in end"),
    "no data": (lambda h: lose(h, "data"), "holds no instances"),
    "no place": (lambda h: (lose(h, "annotation"), lose(h, "r_value")), "says where it lies"),
}  # fmt: skip


@pytest.mark.parametrize("case", SPOILED)
def test_what_is_wrong_with_the_authors_files_is_said(authors, tmp_path, capsys, case):
    spoil, words = SPOILED[case]
    spoil(authors / "human")
    assert import_authors(authors, tmp_path / "out") == 2
    text = capsys.readouterr().err
    assert words in text and text.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("start", [
    '<!DOCTYPE root [<!ENTITY a "aaaa">]>', '<?xml version="1.0"?><!doctype root>', "<! ENTITY x>",
])  # fmt: skip
def test_annotations_declare_no_entities(tmp_path, start):
    path = tmp_path / "0001.xml"
    path.write_text(start + XML.format(1, 2, 30, 40, action="poke"))
    with pytest.raises(BadDataset, match="document type or entities"):
        read_annotation(path)
    path.write_text(XML.format(1, 2, 30, 40, action="poke"))
    assert read_annotation(path) == ("poke", (1, 2, 30, 40))
    path.write_bytes((start + XML).encode("utf-16"))
    with pytest.raises(BadDataset, match="UTF-8"):
        read_annotation(path)
    path.write_text("<root>" + " " * 70_000 + "</root>")
    with pytest.raises(BadDataset, match="at most 65,536 are read"):
        read_annotation(path)


def test_depth_units_hold_the_range():
    assert depth_unit_for(D435_BAZAR) == 1e-5
    assert depth_unit_for(D435_NOMINAL) == 1e-4
    assert len(list(authors_pairs.__doc__)) > 0


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
    arguments = ["dataset", "import", source, out, "--layout", "before-after", *more]
    return main([str(a) for a in arguments])


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
        (None, "depth_unit is missing: metres per count of 16-bit frames; 0.0001 would fit: the "),
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
