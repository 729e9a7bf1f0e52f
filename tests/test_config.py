"""jshape.toml: what it may say, whom it reaches, what beats it, and every refusal."""

import json
import os
import re
from types import SimpleNamespace

import numpy as np
import pytest

from jshape import PAPER_BOX
from jshape.cli import settings
from jshape.cli.commands import build_app, leaves
from jshape.cli.config import EXAMPLE, default_of
from jshape.cli.main import main
from jshape.cli.parser import parse, value_of
from jshape.errors import BadSetting
from jshape.io.cameras import write_camera
from jshape.robot.cameras.base import CameraSettings


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """A folder of its own to work in, and no file named elsewhere."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv(settings.VARIABLE, raising=False)
    return tmp_path


@pytest.fixture
def asked(monkeypatch):
    """What a command was run with, instead of running it."""
    seen = []

    def run(*words):
        def without_work(words):
            asked = parse(words)
            seen.append(SimpleNamespace(**vars(asked.options), values=asked.values))
            return asked._replace(run=lambda *values, options: {"good": True})

        monkeypatch.setattr("jshape.cli.parser.parse", without_work)
        assert main(list(words)) == 0
        return seen[-1]

    return run


def write(text, name="jshape.toml"):
    with open(name, "w") as file:
        file.write(text)


PLAN = ("plan", "a.png", "b.png")
MOLD = ("mold", "b.png", "--out", "run")


def test_keys_reach_every_command_that_has_the_option(asked, capsys):
    write(
        'bank = "my-bank"\ncamera = "realsense"\ncamera-file = "c.json"\narm = "sim:3"\n'
        'planner = "careful"\nmaterial = "sand"\nmax_missing = 0.3\nstrengths = [0.5, 1]\n'
        'window = "1,2,30x40"\ndepth-range = [0.4, 0.5]\nfill-holes = true\n'
    )
    plan = asked(*PLAN)
    assert (plan.bank, plan.planner, plan.max_missing) == ("my-bank", "careful", 0.3)
    assert plan.strengths == [0.5, 1.0]
    assert plan.camera_file == "c.json", "the camera is a device, and a plan wants its description"
    mold = asked(*MOLD)
    assert (mold.camera, [*map(str, mold.camera_file)]) == (["realsense"], ["c.json"])
    assert mold.arm == "sim:3"
    assert mold.window == (1, 2, 30, 40) and mold.depth_range == (0.4, 0.5)
    assert mold.fill_holes is True
    assert mold.material == "sand" and mold.bank == "my-bank"
    record = asked("record", "--out", "r")
    assert (record.values, [*map(str, record.camera_file)]) == ((["realsense"],), ["c.json"])
    assert asked("setup").values == ("realsense",)
    said = capsys.readouterr().err.splitlines()
    assert said[0].startswith("settings of jshape.toml: bank, camera-file, planner")
    assert "arm" not in said[0].split() and "arm," in said[1].split()


def test_the_unit_of_images_is_not_that_of_a_bag(asked):
    write("depth-unit = 0.0001\n")
    assert asked(*PLAN).depth_unit == 1e-4
    assert asked("record", "a.bag", "--out", "r").depth_unit is None


def test_the_command_line_beats_the_table_and_the_table_the_rest(asked):
    write('planner = "careful"\nmaterial = "sand"\n[mold]\nplanner = "refine"\nout = "there"\n')
    assert asked(*PLAN).planner == "careful"
    assert asked(*PLAN, "--planner", "greedy").planner == "greedy"
    assert asked(*MOLD).planner == "refine" and asked(*MOLD).material == "sand"
    assert str(asked("mold", "b.png").out) == "there", "what is required may stand in the file"
    assert str(asked(*MOLD, "--material", "dough").out) == "run"


def test_what_excludes_each_other(asked):
    write("stride = 8\n")
    assert (asked(*PLAN).stride, asked(*PLAN).positions) == (8, None)
    given = asked(*PLAN, "--positions", "9x7")
    assert (given.stride, given.positions) == (None, "9x7"), "the command line beats the file"
    write('stride = 8\n[plan]\npositions = "9x7"\n')
    assert (asked(*PLAN).stride, asked(*PLAN).positions) == (None, "9x7")
    assert asked(*MOLD).stride == 8


def test_data_and_measurements_read_only_their_own_table(asked):
    write('material = "sand"\nbank = "x"\n[dataset-simulate]\nmaterial = "dough"\npairs = 3\n')
    assert asked("dataset", "simulate", "out").material == "dough"
    assert asked("dataset", "simulate", "out").pairs == 3
    assert asked("dataset", "simulate-recording", "out").material == "flour"
    assert asked("evaluate", "pairs").bank is None


def test_files_are_relative_to_the_file(asked, here, monkeypatch):
    (here / "set-up" / "my-bank").mkdir(parents=True)
    for name in ("film.db3", "area.json"):
        (here / "set-up" / name).touch()
    write('bank = "my-bank"\nbase = "base.json"\ncamera = "realsense:film.db3"\n'
          'reachable = "area.json"\n[plan]\npositions = "9x7"\n', "set-up/lab.toml")  # fmt: skip
    where = ("--config", "set-up/lab.toml")
    assert asked(*where, *PLAN).bank == "set-up/my-bank"
    assert asked(*PLAN, *where).positions == "9x7", "a grid is not a file"
    assert str(asked(*MOLD, *where).base) == "set-up/base.json"
    assert asked(*MOLD, *where).reachable == "set-up/area.json"
    assert asked(*MOLD, *where).camera == ["realsense:set-up/film.db3"]
    monkeypatch.setenv(settings.VARIABLE, str(here / "set-up" / "lab.toml"))
    assert asked(*PLAN).bank == str(here / "set-up" / "my-bank")
    assert asked("--config", "off", *PLAN).bank is None
    monkeypatch.setenv(settings.VARIABLE, "off")
    assert asked(*PLAN).bank is None and asked(*PLAN, *where).bank == "set-up/my-bank"


BAD = {
    "no TOML": ("bank = \n", "jshape.toml: not TOML that can be read"),
    "no text": ("bank = '\udcff'", "jshape.toml: not TOML that can be read"),
    "unknown key": ('plannr = "x"', "jshape.toml: unknown key 'plannr'; did you mean planner?"),
    "far from any": ("zzzz = 1", "unknown key 'zzzz'; allowed: a"),
    "unknown table": ("[plam]\nstride = 1", "unknown table 'plam'; allowed: demo, samples, plan"),
    "key of another": ('[plan]\narm = "sim"', "[plan] unknown key 'arm'"),
    "near in a table": ("[plan]\nstrid = 1", "[plan] unknown key 'strid'; did you mean stride?"),
    "yes": ("yes = true", "yes is not taken from a file: --yes is said each time"),
    "yes in a table": ("[mold]\nyes = true", "yes is not taken from a file"),
    "overwrite": ("overwrite = false", "overwrite is not taken from a file"),
    "restart": ("[train]\nrestart = true", "restart is not taken from a file"),
    "twice": ("max_steps = 1\nmax-steps = 2", "max-steps is there twice"),
    "a number for a name": ("bank = 3", "jshape.toml: bank: 3 is not text"),
    "text for a truth": ('[mold]\nfill-holes = "yes"', "fill-holes: 'yes' is not true or false"),
    "a number for a truth": ("[mold]\nfill-holes = 1", "fill-holes: 1 is not true or false"),
    "an option that was": ("reproject = true", "unknown key 'reproject'"),
    "a truth for a number": ("max-steps = true", "max-steps: true is not a number or text"),
    "no whole number": ("max-steps = 2.5", "max-steps: '2.5' is not a whole number"),
    "a list for one": ("max-steps = [1, 2]", "max-steps: '1,2' is not a whole number"),
    "a list of names": ('bank = ["a", "b"]', "bank: ['a', 'b'] is not text"),
    "no list": ("[plan]\nmax-uses = 'knock=2'", "[plan] max-uses: 'knock=2' is not a list"),
    "no choice": ('planner = "gredy"', "unknown value 'gredy'; allowed: greedy, careful, "
                  "refine; did you mean greedy?"),
    "a table for a value": ("[plan.bank]\nx = 1", "[plan] bank: a table is not text"),
    "2,000 dots": (".".join(["a"] * 2000) + " = 1", "unknown table 'a'"),
    "2,000 dots in a table": ("[plan]\nbank = [{" + ".".join(["a"] * 2000) + " = 1}]", "not text"),
    "a long number": ("max-steps = " + "9" * 5000, "not TOML that can be read"),
    "both": ('[plan]\nstride = 8\npositions = "9x7"', "excludes"),
    "a date": ("bank = 2026-01-01", "is not text"),
}  # fmt: skip


@pytest.mark.full
@pytest.mark.parametrize("case", BAD)
def test_what_is_wrong_is_said_in_one_line(case, capsys):
    text, words = BAD[case]
    with open("jshape.toml", "wb") as file:
        file.write(text.encode(errors="surrogateescape"))
    tables = {"[train]": ("train", "x", "--out", "y"), "[mold]": MOLD}
    command = tables.get(text.split("\n")[0], PLAN)
    assert main([*command]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and err.startswith("jshape: error: jshape.toml: ")
    assert words in err
    assert main(["config"]) == 2, "and `jshape config` says so too"
    assert words in capsys.readouterr().err


def test_help_and_other_commands_do_not_stumble_over_a_broken_file(capsys):
    write("nonsense")
    assert main(["--version"]) == 0
    assert main(["plan", "--help"]) == 0
    assert "Usage: jshape plan" in capsys.readouterr().out


def test_a_file_that_is_named_must_be_there(capsys, monkeypatch):
    assert main(["--config", "lab.toml", *PLAN]) == 2
    assert "lab.toml: no such configuration file (--config off" in capsys.readouterr().err
    monkeypatch.setenv(settings.VARIABLE, "gone.toml")
    assert main([*PLAN]) == 2 and "gone.toml: no such" in capsys.readouterr().err
    monkeypatch.delenv(settings.VARIABLE)
    assert main([*PLAN, "--conf", "off"]) == 2
    assert "unknown option --conf; did you mean --config?" in capsys.readouterr().err


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir, lambda name: os.symlink("gone", name)])
def test_what_is_there_and_no_file_is_not_passed_over(capsys, make):
    make("jshape.toml")
    for words in (PLAN, ["--config", "jshape.toml", *PLAN]):
        assert main([*words]) == 2
        assert re.search("jshape.toml: is (not a regular|a folder|a link)", capsys.readouterr().err)


def test_an_empty_file_sets_nothing(asked, capsys):
    write("")
    assert main(["config"]) == 0 and "jshape.toml sets nothing" in capsys.readouterr().out
    assert asked(*PLAN).bank is None and capsys.readouterr().err == ""


@pytest.mark.full
def test_config_says_what_applies_and_where_it_is_from(capsys):
    assert main(["config"]) == 0
    assert "no jshape.toml here; jshape config --init writes one" in capsys.readouterr().out
    write('bank = "flour-robot"\n[plan]\nstride = 8\n[dataset-simulate]\npairs = 3\n')
    assert main(["config", "--json"]) == 0
    found = {row["key"]: row for row in json.loads(capsys.readouterr().out)["settings"]}
    assert set(found) == {"bank", "stride", "pairs"}
    assert {"demo", "plan", "mold", "execute"} <= set(found["bank"]["of"])
    assert "evaluate" not in found["bank"]["of"] and found["bank"]["from"] == "jshape.toml"
    assert (found["stride"]["of"], found["stride"]["from"]) == (["plan"], "jshape.toml [plan]")
    assert found["pairs"]["of"] == ["dataset simulate"]
    assert main(["config", "plan"]) == 0
    rows = {line.split()[0]: line.split()[1:] for line in capsys.readouterr().out.splitlines()}
    assert rows["stride"] == ["8", "jshape.toml", "[plan]"] and rows["max-steps"] == [
        "16",
        "default",
    ]
    assert main(["config", "dataset", "simulate"]) == 0
    assert re.search(r"pairs +3 +jshape.toml \[dataset-simulate\]", capsys.readouterr().out)
    assert main(["config", "plam"]) == 2
    assert "unknown command 'plam'" in capsys.readouterr().err
    write("[dataset-simulat]\npairs = 3\n")
    assert main(["config"]) == 2
    assert "did you mean dataset-simulate?" in capsys.readouterr().err


def test_init_writes_an_example_once(here, capsys):
    assert main(["config", "--init"]) == 0
    assert "jshape.toml" in capsys.readouterr().out
    assert [p.name for p in here.iterdir()] == ["jshape.toml"]
    (here / "jshape.toml").write_text("# mine\n")
    assert main(["config", "--init"]) == 2
    assert "exists and is not replaced" in capsys.readouterr().err
    assert (here / "jshape.toml").read_text() == "# mine\n"
    assert main(["config", "--init", "--config", "lab.toml"]) == 0
    assert (here / "lab.toml").read_text() == EXAMPLE


def test_the_example_is_right_behind_its_signs(asked, capsys):
    write(EXAMPLE)
    assert asked(*PLAN).bank is None, "as it is written it sets nothing"
    keys = re.sub(r"^#(?=[a-z\[])", "", EXAMPLE, flags=re.MULTILINE)
    assert keys.count("\n#") < EXAMPLE.count("\n#") - 12
    write(keys)
    assert main(["config"]) == 0
    assert asked(*MOLD).frames == 15 and asked(*PLAN).positions == "41x31"
    assert asked(*MOLD).depth_range == (0.42, 0.47)


def test_every_option_of_a_file_reads_what_its_default_says():
    """Whatever a command's own default is, the file can say it too, and means the same."""
    read = 0
    for leaf in leaves(build_app()):
        for key, argument in leaf.settable.items():
            said = default_of(argument)
            if isinstance(said, bool | int | float | list):
                tokens = settings.tokens_of(argument, key, said, settings.Path(), "file: ")
                default = argument.field_info.default
                assert value_of(argument, tokens) == default, (leaf.table, key)
                read += 1
    assert read > 80


def test_no_command_lets_a_file_answer_for_people():
    found = list(leaves(build_app()))
    for leaf in found:
        assert not {"yes", "overwrite", "resume", "restart"} & leaf.settable.keys()
    assert any("yes" in leaf.arguments for leaf in found)
    temporal = next(leaf for leaf in found if leaf.words == ("mold",)).arguments["temporal"]
    with pytest.raises(BadSetting, match="is not true or false"):
        settings.tokens_of(temporal, "temporal", 1, settings.Path(), "")


def test_a_mold_looks_through_a_window_as_a_recording_does(monkeypatch, here, capsys):
    """The options of `jshape record` for looking reach the camera of `jshape mold`."""
    seen = {}

    def opened(name, settings, window):
        seen.update(name=name, settings=settings, window=window)
        raise BadSetting("seen")

    monkeypatch.setattr("jshape.robot.cameras.names.open_camera", opened)
    np.save("goal.npy", np.full(PAPER_BOX.shape, 0.45, np.float32))
    words = ["mold", "goal.npy", "--out", "run", "--yes", "--bank", "flour-robot"]
    look = ["--topic", "/d", "--window", "1,2,480x395", "--depth-range", "0.4,0.5"]
    assert main([*words, "--camera", "x.bag", *look, "--no-temporal"]) == 2
    assert (seen["name"], seen["window"]) == ("x.bag", (1, 2, 480, 395))
    assert seen["settings"] == CameraSettings(topic="/d", z_range=(0.4, 0.5), temporal=False)
    assert main([*words, "--camera", "x.bag"]) == 2 and seen["settings"].temporal is True
    capsys.readouterr()
    assert main([*words, "--arm", "sim", *look]) == 2
    assert ": only with --camera; the arm's own camera takes none" in capsys.readouterr().err
    write_camera(here / "camera.json", PAPER_BOX, 1e-4)
    assert main([*words, "--camera", "camera.json"]) == 2
    said = capsys.readouterr().err
    assert "camera.json: describes a camera and is none: --camera-file takes it" in said


def test_a_camera_must_be_named_somewhere(capsys):
    assert main(["record", "--out", "r"]) == 2
    assert "which camera? name one, or set camera in jshape.toml" in capsys.readouterr().err
