"""Every experiment that ends in a page, one after the other, and a page in front of them."""

import html
import time
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from benchmarks.experiments import EXPERIMENTS, LeftOut, pages, samples, studies
from benchmarks.experiments.samples import Progress, Say, silent, unheard
from jshape.errors import JShapeError, UnknownName, one_line
from jshape.io import files, folders

PROGRAM = ("python", "-m", "benchmarks.experiments")
"""The first words of the command that runs an experiment."""
INDEX, PAGE = "index.json", "index.html"
NOT_SAID = ("overwrite", "say", "progress")
"""Options of `run` that change nothing in a result."""


def run_one(name: str, out: Path, *, data: Path | None = None, **options: Any) -> dict[str, Any]:
    """Run one of `EXPERIMENTS`.

    Args:
      name: of the experiment.
      out: its folder.
      data: a data set, for those that take one.
      options: of its `run`.

    Returns:
      What its `results.json` holds.

    Raises:
      UnknownName: no such experiment.
      JShapeError: too few pairs are asked for; what the experiment raises.
    """
    if name not in EXPERIMENTS:
        raise UnknownName("experiment", name, EXPERIMENTS)
    row = EXPERIMENTS[name]
    pairs = options.get("pairs")
    if pairs is not None and pairs < studies.LEAST_PAIRS:
        raise JShapeError(
            f"--pairs {pairs}: must be at least {studies.LEAST_PAIRS}, to fit to and to test"
        )
    if row.data:
        options["data"] = data
    with pages.made_by(command_of(name, out, options)):
        module = import_module(f"benchmarks.experiments.{row.module or name}")
        return module.run(out, samples.Asked(**options))


def command_of(name: str, out: Path, options: Mapping[str, Any]) -> list[str]:
    """The words of the command that runs one experiment, or "all", with these options."""
    # Commands of their own do more than their part of a report.
    if name in EXPERIMENTS and EXPERIMENTS[name].own_command:
        name, options = "all", {"only": [name], **options}
    words = [*PROGRAM, name, "--out", Path(out).name]
    for key, value in options.items():
        if key in NOT_SAID or value is None or value is False:
            continue
        several = value if isinstance(value, list | tuple) else [value]
        words += [f"--{key}", *(str(one) for one in several if value is not True)]
    return words


def run_all(
    out: Path,
    *,
    names: Sequence[str] | None = None,
    data: Path | None = None,
    quick: bool = False,
    seed: int = 0,
    overwrite: bool = False,
    say: Say = unheard,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Run experiments into subfolders; the front page grows with each.

    One that fails is noted on the front page, and the others go on; so is one that needs what this
    machine does not have, which is no failure.

    Args:
      out: folder of the report.
      names: which; None is all.
      data: a data set, for those that take one.
      quick: few and small of everything.
      seed: of everything random.
      overwrite: replace an earlier report.
      say: told each line for people.
      progress: wraps what takes long.

    Returns:
      `experiments`: a row each with its name, title, seconds, and why it failed or was left out if
      it was.

    Raises:
      UnknownName: no such experiment.
      BadFile: the folder holds something else, or cannot be written.
      JShapeError: some experiment failed; the others are there.
    """
    asked = {"only": names, "data": data, "quick": quick, "seed": seed}
    names = list(dict.fromkeys(names or EXPERIMENTS))
    for name in names:
        if name not in EXPERIMENTS:
            raise UnknownName("experiment", name, EXPERIMENTS)
    folders.check_target(out, overwrite, contents=(INDEX, PAGE, *EXPERIMENTS))
    with pages.made_by(command_of("all", out, asked)):
        made = pages.made()
    content: dict[str, Any] = {"quick": quick, "seed": seed, "made": made, "experiments": []}
    found: dict[str, Mapping[str, Any]] = {}
    _write(out, content, found)
    common = {"quick": quick, "seed": seed, "overwrite": overwrite, "say": say}
    for name in names:
        say(f"{name}: {EXPERIMENTS[name].what}")
        start, failed, left_out, result = time.perf_counter(), None, None, None
        try:
            result = run_one(name, out / name, data=data, progress=progress, **common)
        except LeftOut as problem:
            left_out = one_line(problem, 200)
            say(f"{name}: left out: {left_out}")
        except JShapeError as problem:
            failed = one_line(problem, 200)
            say(f"{name}: {failed}")
        seconds = time.perf_counter() - start
        title = EXPERIMENTS[name].what if result is None else result["title"]
        row = {"name": name, "title": title, "seconds": seconds}
        content["experiments"].append(row | {"failed": failed, "left_out": left_out})
        if result is not None:
            found[name] = result
            say(f"{name}: {seconds:.0f} s")
        _write(out, content, found)
    samples.forget()
    wrong = [row["name"] for row in content["experiments"] if row["failed"]]
    if wrong:
        raise JShapeError(f"failed: {', '.join(wrong)}; the others are in {out}")
    return content


def _write(out: Path, content: dict[str, Any], found: Mapping[str, Mapping[str, Any]]) -> None:
    files.write_json(out / INDEX, content)
    parts = [pages.made_line(content["made"])]
    for row in content["experiments"]:
        name = row["name"]
        parts.append(f"<h2>{html.escape(row['title'])}</h2>")
        if row["failed"]:
            parts.append(pages.paragraph(f"Failed: {row['failed']}"))
            continue
        if row["left_out"]:
            parts.append(pages.paragraph(f"Left out: {row['left_out']}"))
            continue
        result = found[name]
        parts += [pages.paragraph(text) for text in result["paragraphs"]]
        for figure in result["figures"]:
            parts.append(pages.image(f"{name}/{figure['name']}", figure["caption"]))
        more = pages.link(f"{name}/{pages.PAGE}", "Tables, settings and all numbers")
        parts.append(f'<p class="small">{more}. It took {row["seconds"]:.0f} s.</p>')
    files.write_atomic(out / PAGE, pages.document("Experiments", "\n".join(parts)))
