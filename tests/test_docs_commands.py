"""Every command of the documentation is carried out, as it stands there, with real inputs.

`python -m pytest -m slow tests/test_docs_commands.py` runs those that take longer.
"""

import inspect
import io
import itertools
import re
import shlex
import shutil
import sys
import time
import tomllib
import webbrowser
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import pytest

from benchmarks import grid
from benchmarks.experiments import __main__ as experiments
from jshape.cli import main as cli
from jshape.cli.commands import build_app, leaf_of
from jshape.cli.parser import parse
from tests import docs_inputs
from tests.conftest import ROOT, SHARED
from tests.docs_inputs import INPUTS, input_of
from tests.documentation import PAGES, blocks, commands, spoken

PLACEHOLDERS = {"PAIRS": "pairs", "BANK": "my-bank", "DIR": "data"}
"""What stands for a name of the reader's own."""
ALSO = {"jshape view": "--port 0"}
"""Words added to commands by how they begin: tests run side by side, a port is anybody's."""
NEEDS = {
    "session.db3": "pyrealsense2",
    "session.mcap": "rosbags",
    "mujoco:3": "mujoco",
    "ray": "ray",
    "--save": "rerun",
    "view": "nicegui",
    "studio": "nicegui",
}
"""The package without which a command with that word cannot run."""
PARSED = {
    "jshape record realsense:LEFT": "needs two cameras of the SDK",
    "python -m benchmarks.grid train pairs --kinds CR DCR --out": "needs a cluster of Ray",
}
"""Commands that are only parsed, by how they begin, and why."""
QUICK_NETWORKS = "--width 4 --epochs 1 --partitions 1"
SLOW = {
    "jshape plan now.png wanted.png --positions paper": "",
    "jshape plan now.png wanted.png --planner refine": "",
    "jshape limit now.png wanted.png --max-steps": "",
    "jshape plan now.png wanted.png --bank moving-flour-robot": "",
    "jshape plan my-goal/now.png my-goal/goal.png": "",
    "jshape plan now.npz wanted.npz": "",
    "jshape mold wanted.png --arm sim:3": "--max-steps 2",
    "jshape mold wanted.png --arm mujoco:3": "--max-steps 1",
    "jshape mold wanted.png --arm dry": "",
    "jshape mold wanted.npz --arm sim:3": "--max-steps 1",
    "jshape mold wanted.npz --arm dry": "--max-steps 1",
    "jshape demo": "",
    "jshape evaluate PAIRS --kinds C CR DC DCR": QUICK_NETWORKS,
    "jshape evaluate PAIRS --kinds D P --sizes": "",
    "jshape evaluate PAIRS --kinds D P --across-agents": "",
    "jshape evaluate PAIRS --start": "",
    "jshape evaluate pokes": QUICK_NETWORKS,
    "jshape dataset simulate pokes": "--pairs 4",
    "jshape dataset simulate uneven": "--pairs 4",
    "jshape evaluate uneven": "",
    "jshape evaluate pairs --kinds D P": "",
    "jshape evaluate pairs --start": "",
    "jshape record sim --frames 100": "",
    "jshape train pairs --kind P": "",
    "jshape train pairs --start": "",
    "jshape train both": "",
    "jshape train dough-pairs": "",
    "jshape train clay-pairs": "",
    "jshape train scraped": "",
    "jshape dataset simulate clay-pairs": "--pairs 4",
    "jshape dataset simulate scraped": "",
    "python -m benchmarks.grid train": QUICK_NETWORKS,
    "python -m benchmarks.grid simulate": "--pairs 2",
    "python -m benchmarks.experiments": "--quick",
}
"""By how they begin, commands of more than 15 s on two cores, and those that other pages have in
other words; with what makes them smaller."""
OTHERS = (
    "make ",
    "pip install ",
    "python -m ",
    ".venv/bin/python -m ",
    ".ci/run",
    "jupyter ",
    "ray ",
    "cd ",
)
"""How commands of other programs begin; the test of them says what holds."""

COMMANDS = {path: list(commands(path.read_text(encoding="utf-8"))) for path in PAGES}


def _parsed(words):
    """The options of a command line, and the folder that it writes if that is no option."""
    one = parse(words)
    names = [name for name in inspect.signature(one.run).parameters if name != "options"]
    where = {"out": one.values[names.index("out") - len(names)]} if "out" in names else {}
    return SimpleNamespace(**vars(one.options), **where)


PROGRAMS = {
    "jshape ": (cli.main, _parsed),
    "python -m benchmarks.experiments ": (
        experiments.main,
        lambda words: experiments.build_parser().parse_args(words),
    ),
    "python -m benchmarks.grid ": (grid.main, lambda words: grid.build_parser().parse_args(words)),
}
"""Our command lines, by how they begin."""
OURS = [
    (path, one)
    for path, page in COMMANDS.items()
    for one in page
    if one.startswith(tuple(PROGRAMS))
]


def _begins(command, table):
    """The key of a table with which a command begins."""
    return next((key for key in table if command.startswith(key)), None)


def _words(command, more=""):
    """A command as its `main` takes it, without what the shell does with its output."""
    begin = _begins(command, PROGRAMS)
    words = shlex.split(command.removeprefix(begin).partition(" > ")[0]) + shlex.split(more)
    return [PLACEHOLDERS.get(word, word) for word in words]


class Person(io.StringIO):
    """Somebody at the terminal who says yes."""

    def isatty(self):
        return True

    def readline(self, *_):
        return "yes\n"


@pytest.fixture(scope="session")
def kept(tmp_path_factory):
    """Inputs that were made; each page gets copies."""
    return tmp_path_factory.mktemp("inputs")


@pytest.fixture
def reader(tmp_path, monkeypatch, kept):
    """Carries a command out in a folder of its own; returns what it lacks here, if anything."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "stdin", Person())
    under_way = _stand_ins(monkeypatch)

    def supply(name, page):
        """Make an input, a page's own if it has one, unless it is there."""
        if Path(name).exists():
            return
        make = INPUTS.get(f"{page}: {name}") or INPUTS[name]
        made = kept / str(list(INPUTS.values()).index(make))
        if not made.exists():
            fresh = made.with_suffix(".new")
            fresh.mkdir()
            make(fresh)
            fresh.rename(made)  # whole
        shutil.copytree(made, ".", symlinks=True, dirs_exist_ok=True)  # with what belongs to it

    def carry_out(command, more="", supplied=True, page=""):
        main, parsed = PROGRAMS[_begins(command, PROGRAMS)]
        words = _words(command, more)
        named = [word.removeprefix("realsense:") for word in words]
        packages = [NEEDS[word] for word in named if word in NEEDS]
        if not all(map(find_spec, packages)):
            return packages[0]
        if "data" in words and not (SHARED / "data").is_dir():
            return "the shared data"
        also = _begins(command, ALSO)
        words += shlex.split(ALSO[also]) if also else []
        under_way[:] = words
        options = None if "--help" in words else parsed(words)
        out = getattr(options, "out", None)
        for name in [input_of(word) for word in words if word != str(out)]:
            if name is not None and supplied:
                supply(name, page)
        again = out is not None and out.exists()
        if again and getattr(options, "overwrite", None) is False:
            words.append("--overwrite")
        try:
            code = main(words)
        except SystemExit as ended:  # --help
            code = ended.code
        assert code == 0, f"{command}: exit code {code}"
        if out is not None and words[0] != "studio":  # which writes when somebody saves
            assert out.exists(), f"{command}: {out} was not written"
        return None

    return carry_out


def _stand_ins(monkeypatch):
    """For what nobody has here, or would not end; returns the list that the command's words go to.

    A camera is a simulated one with somebody who presses Ctrl-C when 20 frames are recorded; of
    the viewer and the studio all is real but their servers.
    """
    from jshape.robot.cameras import realsense

    words, real = [], realsense.realsense_camera

    def plugged(source, **options):
        if not isinstance(source, str):
            return real(source, **options)
        return docs_inputs.camera(source or None, 20 if words[0] == "record" else None)

    monkeypatch.setattr(realsense, "connected", lambda serial: serial)
    monkeypatch.setattr(realsense, "realsense_camera", plugged)
    monkeypatch.setattr(webbrowser, "open", lambda url: True)
    if find_spec("nicegui"):
        monkeypatch.setattr("jshape.app.view.page.serve_pages", lambda *more, **options: None)
        monkeypatch.setattr("jshape.app.studio_page.serve_studio", lambda *more, **options: None)
    return words


LONG = ("cameras", "recordings")
"""Pages whose quick commands are many: minutes in all."""


def _carried_out(slow):
    """The commands that are slow, or those that are not, with their pages."""
    return [(path, one) for path, one in OURS
            if not _begins(one, PARSED) and bool(_begins(one, SLOW)) == slow]  # fmt: skip


def _run_all(page, carry_out, slow):
    missing = []
    for command in (one for path, one in _carried_out(slow) if path == page):
        key = _begins(command, SLOW)
        begun = time.process_time()
        package = carry_out(command, SLOW[key] if key else "", page=page.stem)
        print(f"{time.process_time() - begun:5.1f} s of a core: {command}")  # with pytest -rA
        missing += [package] if package else []
    if missing:
        pytest.skip(f"the others ran; not here: {', '.join(sorted(set(missing)))}")


def _one_each(slow):
    pages = dict.fromkeys(path for path, _ in _carried_out(slow))
    marks = {
        page: pytest.mark.slow if slow or page.stem in LONG else pytest.mark.full for page in pages
    }
    params = [pytest.param(page, marks=mark, id=page.stem) for page, mark in marks.items()]
    return pytest.mark.parametrize("page", params)


@_one_each(slow=False)
def test_commands_of_a_page(page, reader):
    _run_all(page, reader, slow=False)


@_one_each(slow=True)
def test_slow_commands_of_a_page(page, reader):
    _run_all(page, reader, slow=True)


@pytest.mark.slow
def test_the_readme_runs_as_printed(reader, monkeypatch):
    """In one folder, in its order, with nothing but what its own commands made; Python last."""
    for command in COMMANDS[ROOT / "README.md"]:
        if command.startswith("cd "):
            monkeypatch.chdir(command[3:])
        elif command.startswith("jshape "):
            key = _begins(command, SLOW)
            assert reader(command, SLOW[key] if key else "", supplied=False) is None
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for block in blocks(text):
        if block.language == "python":
            exec(block.text, {})


@pytest.mark.parametrize(("page", "command"), OURS)
def test_every_command_parses(page, command):
    words, (_, parsed) = _words(command), PROGRAMS[_begins(command, PROGRAMS)]
    if "--help" not in words:
        assert parsed(words) is not None, f"{page.name}: {command}"


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)
def test_commands_within_sentences_have_these_options(page):
    """They may lack what is required, and say N for a number."""
    app = build_app()
    for command in spoken(page.read_text(encoding="utf-8")):
        words = [word.strip("[]") for word in shlex.split(command)[1:]]
        named = list(itertools.takewhile(lambda word: word.isalpha(), words))
        leaf, chain = leaf_of(app, named), app.parse_commands(named)[0]
        assert chain or not named, f"{command}: no such command"
        known = {"--help", "--version", "--config"}
        known |= {name for one in leaf.arguments.values() for name in one.names} if leaf else set()
        wrong = {w for w in words if w.startswith("--")} - known
        assert not wrong, f"{command}: no such option: {wrong}"


def test_commands_of_other_programs():
    """What they name is there: targets, extras, modules with these options, files."""
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = set(extras["optional-dependencies"])
    for path, page in COMMANDS.items():
        for command in page:
            if command.startswith(tuple(PROGRAMS)):
                continue
            begin = next((one for one in OTHERS if command.startswith(one)), None)
            assert begin, f"{path.name}: {command}: in none of the lists of this test"
            words = shlex.split(command)
            if begin == "make ":
                assert set(words[1:]) <= set(targets), command
            elif begin == "pip install ":
                assert set(re.findall(r"\[(\w+)\]", command)) <= extras, command
            elif " -- python -m benchmarks.grid " in command:
                grid.build_parser().parse_args(_words(command.rpartition(" -- ")[2]))
            elif "-m" in words:
                module = find_spec(words[2])
                text = Path(module.origin).read_text()
                assert all(f'"{w}"' in text for w in words if w.startswith("--")), command
            elif begin not in ("ray ", "cd "):
                assert (ROOT / words[-1]).exists(), command


def test_the_lists_hold_nothing_that_is_gone():
    ours = [command for _, command in OURS]
    for table in (PARSED, SLOW):
        for key in table:
            assert any(command.startswith(key) for command in ours), key
    written = " ".join(ours)
    assert all(word in written for word in PLACEHOLDERS)
