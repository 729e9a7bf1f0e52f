"""The authors' layout, made here in small, as a data set."""

import shutil

import cv2
import numpy as np
import pytest

from benchmarks.authors_data import authors_pairs, depth_unit_for, main, place_of_r, read_annotation
from jshape import D435_BAZAR, D435_NOMINAL, Camera, load_pairs, metric
from jshape.errors import BadDataset
from jshape.io.annotations import boxes_by_hand

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
    return main([str(source), str(out), *more])


@pytest.mark.full
def test_the_authors_layout_becomes_a_data_set(authors, tmp_path, capsys):
    assert import_authors(authors, tmp_path / "out") == 0
    assert "2 pairs (2 human fist)" in capsys.readouterr().out
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
    "objects": (lambda h: spoil_r(h, np.array([[None]])), "Object arrays cannot be loaded"),
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
