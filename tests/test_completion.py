"""`jshape completion`: the scripts, and what a real bash makes of them."""

import re
import shutil
import subprocess
from typing import get_args

import pytest

from jshape.cli import COMMANDS
from jshape.cli.main import main

TRY = """
source {script}
COMP_WORDS=({words})
COMP_CWORD=$(( ${{#COMP_WORDS[@]}} - 1 ))
_jshape jshape "${{COMP_WORDS[COMP_CWORD]}}"
if [[ ${{#COMPREPLY[@]}} == 0 && "$(complete -p jshape)" == *"-o default"* ]]; then
    COMPREPLY=($(compgen -f -- "${{COMP_WORDS[COMP_CWORD]}}"))  # as bash itself does then
fi
printf '%s\\n' "${{COMPREPLY[@]}}"
"""


@pytest.fixture(scope="module")
def scripts(tmp_path_factory):
    """The scripts of all shells, as files."""
    from jshape.cli.completion import Shell, script_of

    folder = tmp_path_factory.mktemp("scripts")
    for shell in get_args(Shell):
        (folder / shell).write_text(script_of(shell))
    return folder


@pytest.fixture
def tab(scripts, tmp_path):
    """What a TAB behind some words offers in bash, in a folder with a picture, without Python."""
    (tmp_path / "now.png").touch()
    bash = shutil.which("bash")
    if bash is None:
        pytest.skip("there is no bash here")

    def press(words):
        done = subprocess.run(
            [bash, "--norc", "-c", TRY.format(script=scripts / "bash", words=words)],
            cwd=tmp_path, env={"PATH": ""}, capture_output=True, text=True, timeout=30,
        )  # fmt: skip
        assert done.stderr == ""
        return done.stdout.split()

    return press


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("jshape pl", {"plan"}),
        ("jshape ''", set(COMMANDS)),
        ("jshape dataset simulate-", {"simulate-recording"}),
        ("jshape plan --planner ''", {"careful", "greedy", "refine"}),
        ("jshape plan now.png b.png --bank pressed-f",
         {"pressed-flour-human", "pressed-flour-robot"}),
        ("jshape dataset simulate out --actions kn", {"knock"}),
        ("jshape record rea", {"realsense"}),
        ("jshape plan --camera-file d435_b", {"d435_bazar"}),
        ("jshape mold --arm ''", {"dry", "sim", "mujoco"}),
        ("jshape mold --material s", {"sand"}),
        ("jshape completion ''", {"bash", "zsh", "fish"}),
        ("jshape plan no", {"now.png"}),
        ("jshape plan --bank no", {"now.png"}),
    ],
)  # fmt: skip
def test_a_tab_in_bash(tab, words, offered):
    found = set(tab(words))
    assert offered <= found
    assert found - offered <= {"-h", "--help", "--version", "--config"}


def test_options_are_offered(tab):
    assert {"--planner", "--positions", "--camera-file", "--overwrite"} <= set(
        tab("jshape plan --")
    )
    assert "--max-steps" in tab("jshape plan now.png --max") and tab("jshape plan --zzz") == []


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_scripts_are_in_order(scripts, shell):
    text = (scripts / shell).read_text()
    assert all(name in text for name in (*COMMANDS, "pressed-flour-robot", "realsense"))
    program = shutil.which(shell)
    if program is None:
        # No such shell: at least a bank may be a name or a folder, and an arm only a name.
        names = {"fish": (r"-l bank -r -a '[\w -]*pressed-flour-robot", "-l arm -x -a 'dry sim"),
                 "zsh": (r"--bank\[.*{compadd -- .*pressed-flour-robot.*; _files}\"",
                         r"--arm\[.*:\(dry sim mujoco\)")}  # fmt: skip
        assert all(re.search(pattern, text) for pattern in names[shell])
    else:
        done = subprocess.run([program, "-n", str(scripts / shell)], capture_output=True, text=True)
        assert (done.returncode, done.stderr) == (0, "")


def test_the_command_prints_the_script(scripts, capsys):
    assert main(["completion", "bash"]) == 0
    assert capsys.readouterr().out.rstrip("\n") == (scripts / "bash").read_text().rstrip("\n")
    assert main(["completion", "bsh"]) == 2
    assert "did you mean bash?" in capsys.readouterr().err
