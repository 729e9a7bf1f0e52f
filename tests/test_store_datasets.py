"""Data sets on disk: there and back, pair by pair, and every damage named."""

import csv
import json
import os
import pickle
from collections import Counter
from dataclasses import replace

import cv2
import numpy as np
import pytest

from jshape import PAPER_BOX, Camera, load_pairs, save_pairs
from jshape.cli.main import main
from jshape.data.pairs import Frames, Pairs
from jshape.errors import BadCamera, BadDataset, BadFile, BadImage, JShapeError, quoted
from jshape.io import datasets
from jshape.io.annotations import boxes_by_hand, write_boxes
from jshape.io.datasets import COLUMNS, dataset_writer
from jshape.io.formats import encode_png
from jshape.io.images import read_counts

SMALL = Camera(40, 30, 50.0, 50.0, 19.5, 14.5, 0.4, 0.5)
FIELDS = ("prior", "posterior", "action", "agent", "material", "centre", "size", "id", "strength")
FIELDS += ("path_mm",)


def make_pairs(rng, count=4, camera=SMALL):
    frames = rng.integers(4000, 5000, (2, count, *camera.shape)).astype(np.uint16)
    frames[:, :, :3] = 0
    return Pairs(
        camera=camera,
        depth_unit=0.0001,
        prior=frames[0],
        posterior=frames[1],
        action=np.array(["poke", "knock"] * count)[:count],
        agent=np.array(["robot"] * count),
        material=np.array(['sand, "kinetic"'] * count),
        centre=np.stack([np.arange(count) + 10, np.arange(count) + 9], -1).astype(np.int32),
        size=np.array([[5, 8]] * count, np.int32),
        id=np.array([f"poke/{k} é" for k in range(count)]),
    )


@pytest.fixture
def folder(tmp_path, rng):
    return save_pairs(make_pairs(rng), tmp_path / "set")


def same(a, b):
    assert (a.camera, a.depth_unit) == (b.camera, b.depth_unit)
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def rewrite(folder, change):
    """Change the rows (header first) of pairs.csv."""
    path = folder / "pairs.csv"
    rows = list(csv.reader(path.read_text().splitlines()))
    rows = change(rows) or rows
    with path.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)


def cell(row, column, value):
    def change(rows):
        rows[row][rows[0].index(column)] = value

    return change


def test_round_trip(tmp_path, rng):
    pairs = make_pairs(rng)
    folder = save_pairs(pairs, tmp_path / "deep" / "set")
    found = load_pairs(folder)
    same(found, pairs)
    assert (found.prior.dtype, found.centre.dtype) == (np.uint16, np.int32)
    same(load_pairs(save_pairs(found, tmp_path / "again")), pairs)
    assert (folder / "pairs.csv").read_text().startswith(",".join(COLUMNS) + "\n")
    frame = cv2.imread(str(folder / "frames" / "00000_prior.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(frame, pairs.prior[0])


def test_pairs_of_one_action_can_be_saved(tmp_path, rng):
    pairs = make_pairs(rng)
    same(load_pairs(save_pairs(pairs.of("knock"), tmp_path / "knock")), pairs.of("knock"))


def test_an_existing_data_set_is_replaced_only_on_demand(folder, rng):
    other = make_pairs(rng, 1)
    with pytest.raises(BadFile, match="exists"):
        save_pairs(other, folder)
    assert len(load_pairs(folder)) == 4
    save_pairs(other, folder, overwrite=True)
    same(load_pairs(folder), other)
    (folder / "notes.md").write_text("mine")
    with pytest.raises(BadFile, match="also holds notes.md"):
        save_pairs(make_pairs(rng), folder, overwrite=True)
    assert (folder / "notes.md").read_text() == "mine" and len(load_pairs(folder)) == len(other)


def test_a_folder_that_is_no_data_set_is_not_replaced(tmp_path, rng):
    (tmp_path / "thesis.txt").write_text("years of work")
    with pytest.raises(BadFile, match="not replaced"):
        save_pairs(make_pairs(rng), tmp_path, overwrite=True)
    assert os.listdir(tmp_path) == ["thesis.txt"]


def pair(rng, **change):
    frame = rng.integers(4000, 5000, SMALL.shape).astype(np.uint16)
    values = dict(
        id="a", action="poke", agent="robot", material="sand", prior=frame, posterior=frame,
        u=10, v=9, width=5, height=8,
    )  # fmt: skip
    return values | change


def test_the_writer_holds_one_pair_at_a_time(tmp_path, rng):
    with dataset_writer(tmp_path / "set", SMALL, 1e-4) as add:
        for k in range(3):
            add(**pair(rng, id=str(k), u=10 + k))
            assert not (tmp_path / "set").exists()
            assert not any(isinstance(held, np.ndarray) for held in vars(add).values())
    assert load_pairs(tmp_path / "set").centre[:, 0].tolist() == [10, 11, 12]


def test_a_failure_in_the_middle_leaves_nothing_new_and_the_old_intact(tmp_path, folder, rng):
    before = load_pairs(folder)
    for target, overwrite in ((folder, True), (tmp_path / "new", False)):
        with pytest.raises(RuntimeError):
            with dataset_writer(target, SMALL, 1e-4, overwrite=overwrite) as add:
                add(**pair(rng))
                raise RuntimeError("the robot fell over")
    assert os.listdir(tmp_path) == ["set"]
    same(load_pairs(folder), before)


@pytest.mark.parametrize(
    "change, match",
    [
        ({"id": ""}, "id is ''"),
        ({"id": "a\nb"}, "line of text"),
        ({"action": " "}, "action is ' '"),
        ({"u": 3.5}, "u is 3.5"),
        ({"width": True}, "width is True"),
        ({"width": 0}, "sides must be positive"),
        ({"u": 39}, "leaves the 40x30 image"),
        ({"v": 3}, "leaves the 40x30 image"),
        ({"prior": np.zeros(SMALL.shape, np.uint16)}, "no pixel of prior"),
        ({"prior": np.ones(SMALL.shape, np.float32)}, "float32; expected"),
        ({"posterior": np.ones((9, 9), np.uint16)}, "posterior has shape (9, 9)"),
    ],
)
def test_a_pair_that_could_not_be_read_again_is_not_written(tmp_path, rng, change, match):
    values = pair(rng)
    with pytest.raises(Exception) as info:  # the tests' shape checker may be the first to object
        with dataset_writer(tmp_path / "set", SMALL, 1e-4) as add:
            add(**values)
            add(**values | {"id": "b"} | change)
    if isinstance(info.value, JShapeError):
        assert match in str(info.value) and "\n" not in str(info.value)
    else:
        assert type(info.value).__name__ == "TypeCheckError"
    assert os.listdir(tmp_path) == []


def test_ids_and_emptiness_of_the_writer(tmp_path, rng):
    with pytest.raises(BadDataset, match="twice"):
        with dataset_writer(tmp_path / "set", SMALL, 1e-4) as add:
            add(**pair(rng))
            add(**pair(rng))
    with pytest.raises(BadDataset, match="no pairs were added"):
        with dataset_writer(tmp_path / "set", SMALL, 1e-4):
            pass
    with pytest.raises(BadDataset, match="no pairs"):
        save_pairs(make_pairs(rng).select(np.zeros(4, bool)), tmp_path / "set")
    with pytest.raises(BadCamera):
        with dataset_writer(tmp_path / "set", replace(SMALL, fx=-1.0), 1e-4):
            pass
    assert os.listdir(tmp_path) == []


def refused(folder, match, error=BadDataset):
    with pytest.raises(error) as info:
        load_pairs(folder)
    message = str(info.value)
    assert match in message and "\n" not in message and str(folder.name) in message
    return message


def test_no_folder(tmp_path):
    (tmp_path / "file").write_text("x")
    (tmp_path / "empty").mkdir()
    refused(tmp_path / "none", "no such folder")
    refused(tmp_path / "file", "is a file")
    refused(tmp_path / "file" / "below", "no such folder")
    refused(tmp_path / "empty", "no camera.json")


@pytest.mark.parametrize("name", ["camera.json", "pairs.csv"])
def test_a_missing_file_is_named(folder, name):
    (folder / name).unlink()
    refused(folder, f"has no {name}")
    (folder / name).mkdir()
    refused(folder, f"has no {name}")


@pytest.mark.parametrize("name", ["camera.json", "pairs.csv"])
def test_an_empty_or_binary_file_is_named(folder, name):
    (folder / name).write_bytes(b"")
    refused(folder, "empty")
    (folder / name).write_bytes(b"\xff\xfe\x00")
    refused(folder, "UTF-8")


def test_a_bad_camera_is_named(folder):
    fields = json.loads((folder / "camera.json").read_text())
    (folder / "camera.json").write_text(json.dumps(fields | {"fx": -1}))
    refused(folder, "fx", BadCamera)


@pytest.mark.parametrize("column", COLUMNS)
def test_a_missing_column_is_named(folder, column):
    k = COLUMNS.index(column)
    rewrite(folder, lambda rows: [row[:k] + row[k + 1 :] for row in rows])
    refused(folder, f"the header lacks {column};")


def test_columns_in_another_order_and_others_besides(folder):
    before = load_pairs(folder)
    rewrite(folder, lambda rows: [[*reversed(row), "note"] for row in rows])
    same(load_pairs(folder), before)
    text = "\r\n".join((folder / "pairs.csv").read_text().splitlines()) + "\r\n\r\n"
    (folder / "pairs.csv").write_bytes(b"\xef\xbb\xbf" + text.encode())
    same(load_pairs(folder), before)


@pytest.mark.parametrize("separator", [";", "\t", ","])
def test_a_table_as_spreadsheets_write_it(tmp_path, rng, separator):
    pairs = replace(make_pairs(rng), strength=np.array([0.5, 1.0, 2.0, 0.25], np.float32))
    table = save_pairs(pairs, tmp_path / "set") / "pairs.csv"
    rows = list(csv.reader(table.read_text().splitlines()))
    quote = [",".join(f'"{cell.replace(chr(34), 2 * chr(34))}"' for cell in row) for row in rows]
    text = "\r\n".join(line.replace('","', f'"{separator}"') for line in quote)
    for old, new in (("0.5", "0,5"), ("0.25", "0,25")):
        text = text.replace(f'"{old}"', f'"{new}"')
    end = separator * 10 + "\r\n"
    table.write_text("\ufeff" + text.replace("\r\n", separator + "\r\n") + f"\r\n{end}{end}\r\n")
    same(load_pairs(tmp_path / "set"), pairs)


def test_own_columns_are_kept(folder, tmp_path, capsys):
    notes = ["", 'deep, "wet"', " two\nlines ", "é"]
    rewrite(folder, lambda rows: [[*row, n] for row, n in zip(rows, ["note", *notes], strict=True)])
    pairs = load_pairs(folder)
    assert pairs.extra["note"].tolist() == notes
    assert pairs.of("knock").extra["note"].tolist() == notes[1::2]
    again = load_pairs(save_pairs(pairs, tmp_path / "again"))
    assert again.extra["note"].tolist() == notes and list(again.extra) == ["note"]
    write_boxes(folder, {"poke/0 é": (8, 5, 6, 8)})
    changed = load_pairs(folder)
    assert changed.extra["note"].tolist() == notes
    assert changed.centre[0].tolist() == [11, 9] and changed.size[0].tolist() == [6, 8]
    assert main(["dataset", "merge", str(tmp_path / "all"), *[str(tmp_path / "again")] * 2]) == 0
    merged = load_pairs(tmp_path / "all")
    assert merged.extra["note"].tolist() == 2 * notes and merged.extra["found"].tolist() == [""] * 8
    assert boxes_by_hand(tmp_path / "all").all()


def test_many_rows_of_the_same_frames_do_not_fill_the_memory(folder, monkeypatch):
    def many(rows):
        return [rows[0], *([str(k), *rows[1 + k % 2][1:]] for k in range(500))]

    rewrite(folder, many)
    read = []
    kept = datasets.read_counts
    monkeypatch.setattr(
        datasets, "read_counts", lambda path, why=None: read.append(path) or kept(path, why)
    )
    held = load_pairs(folder)
    assert len(read) == 5, "the first to check the size, then each of four files once"
    monkeypatch.setattr(datasets, "IN_MEMORY", 10_000)
    asked = load_pairs(folder)
    assert isinstance(asked.prior, Frames) and isinstance(held.prior, np.ndarray)
    assert asked.prior.shape == held.prior.shape == (500, 30, 40)
    assert asked.select(np.arange(2)).prior.shape == (2, 30, 40)
    few = np.array([3, 0, 499])
    for name in ("prior", "posterior"):
        frames = getattr(asked.select(few), name)
        np.testing.assert_array_equal(np.asarray(frames), getattr(held, name)[few])
    np.testing.assert_array_equal(asked.prior[7], held.prior[7])
    sent = pickle.loads(pickle.dumps(asked.prior[few]))
    np.testing.assert_array_equal(sent, held.prior[few])
    monkeypatch.setattr(datasets, "IN_MEMORY", 0)
    (folder / "frames" / "00001_posterior.png").unlink()
    refused(folder, "line 3: posterior: ")


def test_a_name_of_an_action_has_a_letter(folder, tmp_path, rng):
    for dash in ("-", "\u2013", "--", "\u200b"):
        rewrite(folder, cell(1, "action", dash))
        refused(folder, f"line 2: action is {quoted(dash)}; a name has a letter or a digit")
        with pytest.raises(BadDataset, match="a name has a letter or a digit"):
            with dataset_writer(tmp_path / "new", SMALL, 1e-4) as add:
                add(**pair(rng) | {"action": dash})


def test_strengths_are_a_column_if_there_are_several(tmp_path, rng):
    pairs = make_pairs(rng)
    table = save_pairs(pairs, tmp_path / "one") / "pairs.csv"
    assert table.read_text().splitlines()[0] == ",".join(COLUMNS)
    np.testing.assert_array_equal(load_pairs(tmp_path / "one").strength, np.ones(4, np.float32))
    strength = np.array([0.3, 1.0, 2.0, 1 / 3], np.float32)
    several = replace(pairs, strength=strength)
    table = save_pairs(several, tmp_path / "several") / "pairs.csv"
    assert table.read_text().splitlines()[0] == ",".join((*COLUMNS, "strength"))
    assert table.read_text().splitlines()[1].endswith(",0.3")
    found = load_pairs(tmp_path / "several")
    same(found, several)
    assert found.strength.dtype == np.float32
    np.testing.assert_array_equal(found.of(action="knock").strength, strength[1::2])


@pytest.mark.full
def test_simulated_strengths_from_the_command_line(tmp_path, capsys):
    """Drawn, written, told by info, kept by merge; beds, places and looks before stay the same."""
    simulate = ["dataset", "simulate", "--pairs", "3", "--actions", "poke", "--frames", "1"]
    for name, more in (("one", []), ("several", ["--strengths", "0.2", "2.0"])):
        assert main([*simulate, str(tmp_path / name), *more]) == 0
    one, several = (load_pairs(tmp_path / name) for name in ("one", "several"))
    assert (one.strength == 1).all() and len(set(several.strength.tolist())) == 3
    assert 0.2 <= several.strength.min() and several.strength.max() <= 2.0
    np.testing.assert_array_equal(one.prior, several.prior)
    rois = several.rois("poke")
    change = np.nanmean(np.abs(rois.posterior - rois.prior), (1, 2))
    assert (np.argsort(change) == np.argsort(several.strength)).all()
    capsys.readouterr()
    assert main(["dataset", "info", str(tmp_path / "one")]) == 0
    assert "strength" not in capsys.readouterr().out
    parts = [str(tmp_path / name) for name in ("one", "several")]
    assert main(["dataset", "merge", str(tmp_path / "all"), *parts]) == 0
    merged = load_pairs(tmp_path / "all")
    np.testing.assert_array_equal(merged.strength, np.append(one.strength, several.strength))
    assert boxes_by_hand(tmp_path / "all").all()
    capsys.readouterr()
    assert main(["dataset", "info", str(tmp_path / "all")]) == 0
    told = f"{merged.strength.min():.2g} to {merged.strength.max():.2g}"
    assert told in capsys.readouterr().out
    assert main([*simulate, str(tmp_path / "new"), "--strengths", "2", "0.2"]) == 2
    assert "strengths are (2.0, 0.2); expected two rising" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("text", ["", "x", "-1", "0", "nan", "inf", "1e1", "101", "0.00001", "٣"])
def test_a_bad_strength_is_named(tmp_path, rng, text):
    pairs = replace(make_pairs(rng), strength=np.full(4, 0.5, np.float32))
    folder = save_pairs(pairs, tmp_path / "set")
    rewrite(folder, cell(3, "strength", text))
    assert "expected a number from 0.001 to 100" in refused(folder, "line 4: strength is ")


def test_strengths_that_could_not_be_read_again(tmp_path, rng):
    for bad in (0.0, -1.0, np.nan, np.inf, 1000.0):
        with pytest.raises(BadDataset, match="strength is .*; expected a number from"):
            with dataset_writer(tmp_path / "set", SMALL, 1e-4) as add:
                add(**pair(rng), strength=bad)


def test_paths_are_a_column_if_an_action_has_one(tmp_path, rng, capsys):
    paths = np.array([80.0, 0.0, 80.0, 62.5], np.float32)
    dragged = replace(make_pairs(rng), path_mm=paths)
    folder = save_pairs(dragged, tmp_path / "set")
    lines = (folder / "pairs.csv").read_text().splitlines()
    assert lines[0] == ",".join((*COLUMNS, "path_mm"))
    assert [line.rsplit(",", 1)[1] for line in lines[1:]] == ["80", "0", "80", "62.5"]
    same(load_pairs(folder), dragged)
    rewrite(folder, cell(2, "path_mm", ""))  # a knock has none
    same(load_pairs(folder), dragged)
    same(load_pairs(folder).of_usual_paths(), dragged.select(np.arange(3)))  # the knock of 62.5 mm
    assert main(["dataset", "info", str(folder), "--json"]) == 0
    groups = json.loads(capsys.readouterr().out)["groups"]
    told = {row["action"]: row["path_mm"] for row in groups}
    assert told == {name: [float(of.path_mm.min()), float(of.path_mm.max())]
                    for name, of in dragged.by_action()}  # fmt: skip
    assert main(["dataset", "info", str(folder)]) == 0
    head, *rows = capsys.readouterr().out.splitlines()[-1 - len(groups) :]
    assert head.endswith("path (mm)")
    for row, name in zip(rows, told, strict=True):
        least, most = told[name]
        assert row.endswith(f"{least:.0f} to {most:.0f}"), row
    save_pairs(make_pairs(rng), tmp_path / "presses")
    assert main(["dataset", "info", str(tmp_path / "presses")]) == 0
    assert "path" not in capsys.readouterr().out.splitlines()[-2]


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("x", "expected a number from 0 to 2000"),
        ("-1", "expected a number from 0 to 2000"),
        ("2001", "expected a number from 0 to 2000"),
        ("0.08", "less than 2 mm looks like metres: times 1000"),
    ],
)
def test_a_bad_path_is_named(tmp_path, rng, text, match):
    folder = save_pairs(replace(make_pairs(rng), path_mm=np.full(4, 80.0)), tmp_path / "set")
    rewrite(folder, cell(3, "path_mm", text))
    assert match in refused(folder, "line 4: path_mm is ")


@pytest.mark.full
def test_the_table_itself(folder):
    text = (folder / "pairs.csv").read_text()
    head, *rows = text.splitlines()
    for content, match in (
        (head, "no rows"),
        (head + "\n\n,,,,,,,,,\n", "no rows"),
        ("\n".join([head + ",u", *rows]), "names u twice"),
        ("\n".join([head, rows[0] + ",1"]), "line 2: has 11 columns; the header has 10"),
        ("\n".join([head, rows[0], rows[0]]), "line 3: id 'poke/0 é' is already on line 2"),
        (head + '\n"a', "not CSV"),
        ("\n".join(rows), "the header lacks"),
        (head + ",note,note\n" + rows[0] + ",1,2", "names note twice"),
        (head + ",strength\n" + rows[0] + ",0,5", "(a decimal comma takes"),
        (head.replace(",", ";") + "\n" + rows[0], "separated by ';'"),
        ("\n".join([head, rows[0].replace("poke/0", "x" * 300)]), "at most 200 characters"),
        (head + "\n" + (rows[0] + "\n") * 200_001, "line 200002: at most 200,000 rows are read"),
    ):
        (folder / "pairs.csv").write_text(content)
        refused(folder, match)


@pytest.mark.parametrize("column", ["u", "v", "width", "height"])
@pytest.mark.parametrize("value", ["", "x", "3.5", "nan", "1e1", "1_0", "٣", "99999999", "--1"])
def test_a_bad_number_is_named_by_line_and_column(folder, column, value):
    rewrite(folder, cell(3, column, value))
    refused(folder, f"line 4: {column} is {value!r}; expected a whole number")


@pytest.mark.parametrize("column, value", [("u", "1"), ("v", "29"), ("width", "41"), ("u", "-5")])
def test_a_roi_that_leaves_the_image(folder, column, value):
    rewrite(folder, cell(2, column, value))
    assert "line 3" in refused(folder, "leaves the 40x30 image")


def test_a_roi_has_positive_sides(folder):
    rewrite(folder, cell(1, "height", "0"))
    refused(folder, "line 2: the ROI is 5x0")


@pytest.mark.parametrize("column", ["id", "action", "agent", "material", "prior"])
def test_an_empty_name_is_named(folder, column):
    rewrite(folder, cell(1, column, " "))
    refused(folder, f"line 2: {column} is ''; expected a line of text")


@pytest.mark.parametrize(
    "path", ["/etc/passwd", "../other.png", "frames/../../x.png", "C:\\x.png", "out/x.png", ".."]
)
def test_paths_do_not_leave_the_folder(folder, path):
    (folder / "out").symlink_to(folder.parent)
    rewrite(folder, cell(1, "posterior", path))
    refused(folder, "line 2: posterior: ")
    assert "not allowed" in refused(folder, repr(path))


def frame(array):
    return cv2.imencode(".png", array)[1].tobytes()


@pytest.mark.parametrize(
    "content, match",
    [
        (None, "no such file"),
        (b"", "empty"),
        (b"x", "not an image"),
        (frame(np.ones((30, 40), np.uint8)), "holds uint8; a frame is 16-bit"),
        (frame(np.ones((30, 40, 3), np.uint16)), "colour"),
        (frame(np.ones((40, 30), np.uint16)), "has 30x40 pixels; the camera makes 40x30"),
        (frame(np.zeros((30, 40), np.uint16)), "no pixel has a reading"),
        (frame(np.ones((30, 40), np.uint16))[:-20], "cut off"),
    ],
    ids=lambda v: v if isinstance(v, str) else "",
)
def test_a_bad_frame_is_named_by_line_and_column(folder, content, match):
    path = folder / "frames" / "00002_posterior.png"
    path.unlink()
    if content is not None:
        path.write_bytes(content)
    refused(folder, match)
    refused(folder, "line 4: posterior: ")


@pytest.mark.parametrize(
    "change, match",
    [
        ({"depth_unit": None}, "depth_unit is missing.*; 0.0001 would fit: the frames then"),
        ({"depth_unit": 0.001}, "depth_unit 0.0001 instead of 0.001 would fit it"),
    ],
)
def test_a_set_of_no_or_the_wrong_unit_is_refused(folder, change, match):
    fields = json.loads((folder / "camera.json").read_text()) | change
    text = json.dumps({k: v for k, v in fields.items() if v is not None})
    (folder / "camera.json").write_text(text)
    with pytest.raises(JShapeError, match=match):
        load_pairs(folder)


def test_pairs_beyond_the_range_are_no_examples(folder):
    fields = json.loads((folder / "camera.json").read_text()) | {"z_min": 0.6, "z_max": 0.7}
    (folder / "camera.json").write_text(json.dumps(fields))
    with pytest.raises(BadDataset, match="pairs of poke: 100% of their readings lie beyond .* 0.6"):
        load_pairs(folder).rois("poke")


def test_why_pixels_are_no_readings_is_added_up(folder):
    path = folder / "frames/00001_prior.png"
    counts = read_counts(path)
    counts[5, :7] = 65535
    path.write_bytes(encode_png(counts))
    left_out = Counter()
    pairs = load_pairs(folder, left_out)
    assert left_out == {"0": 8 * 3 * 40, "at 65535 (the largest uint16)": 7}
    assert (pairs.prior[1, 5, :7] == 0).all()


def test_an_absurd_camera_asks_for_no_memory(folder):
    fields = json.loads((folder / "camera.json").read_text())
    fields |= {"width": 65535, "height": 65535}
    (folder / "camera.json").write_text(json.dumps(fields))
    refused(folder, "the camera makes 65535x65535")


def test_too_little_memory_is_reported(folder, monkeypatch):
    def none_left(*_):
        raise MemoryError

    monkeypatch.setattr(datasets.np, "empty", none_left)
    refused(folder, "do not fit into memory")


@pytest.mark.full
@pytest.mark.parametrize("noise", ["pairs", "pairs_noisy"])
def test_every_group_of_shared_pairs(shared_data, noise):
    groups = sorted(shared_data.glob(f"mpm/{noise}/*"))
    assert len(groups) == 4
    for group in groups:
        found = load_pairs(group)
        assert found.camera == PAPER_BOX and found.depth_unit == 0.0001
        assert found.actions == ("grasp", "knock", "pinch", "poke", "press")
        assert (found.prior > 0).any((1, 2)).all()
        prior, posterior, *_ = found.rois("poke")
        assert prior.shape == posterior.shape and np.isfinite(prior).mean() > 0.9


def test_the_smallest_shared_group_there_and_back(shared_data, tmp_path):
    found = load_pairs(shared_data / "mpm/pairs/flat_flour_human").of("poke")
    same(load_pairs(save_pairs(found, tmp_path / "set")), found)


def test_errors_are_of_one_family():
    assert issubclass(BadDataset, JShapeError) and issubclass(BadImage, JShapeError)
