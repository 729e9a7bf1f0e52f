"""What each component of f_P brings: left out one at a time, and added one at a time to f_D."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.experiments import pages, studies
from benchmarks.experiments.ablation_figures import bars_figure
from benchmarks.experiments.components import MEAN, WHOLE, Trials, Variant, added, left_out
from benchmarks.experiments.samples import Asked, pairs_for, source
from jshape.data.pairs import Pairs
from jshape.learn.scores import Comparison, Trial, compare

FIGURES = ("components.png",)
PAIRS = {True: 8, False: 40}
"""Simulated pairs per action, of one strength and as many of several."""
STRENGTHS = (0.3, 2.0)
"""Least and greatest of the pairs of several strengths."""
ADDED, LEFT_OUT = "added", "left out"
"""The two parts of the experiment."""
CHANGES = {
    "changed": ("changed_by_mm", "changed_error_mm"),
    "over_whole": ("over_whole_mm", "over_whole_error_mm"),
}
"""Columns of a change of the error, and of its standard error: by the step, and from f_P."""


def run(out: Path, asked: Asked = Asked()) -> dict[str, Any]:
    """Errors of f_P without each of its components, and of all steps from f_D to f_P.

    Args:
      out: folder of the result.
      asked: quick: few pokes, two partitions.

    Returns:
      What `results.json` holds: a row per set of pairs, agent, action, part and component.

    Raises:
      BadDataset: the data set cannot be read or split.
      BadFile: the folder holds something else, or cannot be written.
      UnknownName: no such action.
    """
    pages.check(out, asked.overwrite, FIGURES)
    partitions = studies.partitions_of(asked)
    rows: list[dict[str, Any]] = []
    notes: list[str] = []
    sets = _sets(asked)
    for where, found in sets.items():
        kept, left = studies.enough(found)
        notes += left
        varied = bool((kept.strength != kept.strength[0]).any())
        steps = {ADDED: added(varied), LEFT_OUT: left_out(varied)}
        trials = Trials(
            kept, [v for several in steps.values() for v in several], partitions, asked.seed
        )
        asked.say(f"{len(trials)} fits to {where}, {len(kept)} pairs")
        rows += rows_of(where, steps, studies.trials_of(trials, "ablation", asked.progress), kept)
    means = [mean_over_actions(rows, *panel) for panel in _panels(rows)]
    result = pages.Result(
        title="What each component of f_P brings",
        paragraphs=words(means, partitions),
        rows=rows,
        tables=[_table(mean) for mean in means],
        pictures=[
            pages.Picture(
                FIGURES[0], partial(bars_figure, means, (ADDED, LEFT_OUT)),
                "Mean error over the actions, with the standard deviation of that mean over the "
                "partitions. Left: from f_D down, each bar has what is named more than the one "
                "above it. Right: f_P, and f_P with the change that is named; what goes far "
                "beyond the broken line is needed. The view from above comes with the depth of "
                "the places and with the mean change (the rims) on nodes of the ground, the "
                "absolute error with all fitting by descent; with the tool go the growing rims, "
                "which are of what it displaces; squares take the place of absolute errors.",
            )
        ],
        settings={"data": source(asked.data), "pairs": {w: len(p) for w, p in sets.items()},
                  "partitions": partitions, "seed": asked.seed},
        notes=[
            *notes,
            "Components share work: what two do alike is missed by neither alone, so the errors "
            "of leaving out need not add up. What a component changes is a mean over the pairs "
            "tested, each once however often it was; its ± is the standard error over them, a "
            "little too small, as they share training sets.",
        ],
    )  # fmt: skip
    return pages.write(result, out, overwrite=asked.overwrite)


def _sets(asked: Asked) -> dict[str, Pairs]:
    """The pairs by what they are called."""
    count = PAIRS[asked.quick]
    if asked.data is not None:
        return {source(asked.data): pairs_for(asked, count)}
    what: Any = {"usual": ("poke",) if asked.quick else None, "agents": ("robot",)}
    several = f"simulated pairs, strengths {STRENGTHS[0]:g} to {STRENGTHS[1]:g}"
    return {
        "simulated pairs": pairs_for(asked, count, **what),
        several: pairs_for(asked, count, strengths=STRENGTHS, **what),
    }


def rows_of(
    where: str, steps: dict[str, list[Variant]], trials: Sequence[Trial], pairs: Pairs
) -> list[dict[str, Any]]:
    """A row per action, agent and step, with what the step changes, pair by pair.

    What is added is compared with the step before it, what is left out with f_P; `over_whole_mm`
    compares every step with f_P.  `actions_std_mm` is the standard deviation over the partitions of
    the mean over the actions of an agent.
    """
    scores = {(s.predictor, s.agent, s.action): s for s in studies.scores_of(trials, pairs)}
    whole = {(c.predictor, c.agent, c.action): c for c in compare(trials, WHOLE)}
    rows = []
    for part, variants in steps.items():
        for k, variant in enumerate(variants):
            before = variants[k - 1 if part == ADDED else 0].name if k else ""
            both = [t for t in trials if t.predictor in (variant.name, before)]
            changes = {(c.agent, c.action): c for c in compare(both, before)}
            for (name, agent, action), score in scores.items():
                if name == variant.name:
                    told = {"set": where, "part": part, "step": k, "component": variant.said}
                    told |= {"actions_std_mm": _spread(trials, name, agent)}
                    told |= score._asdict() | _change(changes.get((agent, action)))
                    over = whole.get((name, agent, action))
                    told["over_whole_mm"] = over and over.difference_mm
                    told["over_whole_error_mm"] = over and over.error_mm
                    rows.append(told)
    return rows


def _spread(trials: Sequence[Trial], predictor: str, agent: str) -> float:
    """Standard deviation over the partitions of the mean error over the actions, mm."""
    means: dict[str, list[float]] = {}
    for trial in trials:  # partition by partition
        if (trial.predictor, trial.agent) == (predictor, agent):
            means.setdefault(trial.action, []).append(float(trial.error_mm.mean()))
    return float(np.mean(list(means.values()), 0).std())


def _change(found: Comparison | None) -> dict[str, Any]:
    names = ("changed_by_mm", "changed_error_mm", "better")
    values = (None,) * 3 if found is None else (found.difference_mm, found.error_mm, found.better)
    return dict(zip(names, values, strict=True))


def _panels(rows: Sequence[dict[str, Any]]) -> list[tuple[str, str]]:
    """Sets and agents."""
    return list(dict.fromkeys((row["set"], row["agent"]) for row in rows))


def mean_over_actions(
    rows: Sequence[dict[str, Any]], where: str, agent: str
) -> list[dict[str, Any]]:
    """The rows of a set and an agent, with means over their actions."""
    mine = [row for row in rows if (row["set"], row["agent"]) == (where, agent)]
    found = []
    for part, step in dict.fromkeys((row["part"], row["step"]) for row in mine):
        same = [row for row in mine if (row["part"], row["step"]) == (part, step)]
        line = {name: same[0][name] for name in ("set", "agent", "part", "step", "component",
                                                 "predictor")}  # fmt: skip
        line["std_mm"] = same[0]["actions_std_mm"]
        for name in ("mean_mm", "change_mm", "changed_by_mm", "better", "over_whole_mm"):
            line[name] = _mean([row[name] for row in same])
        for name in ("changed_error_mm", "over_whole_error_mm"):
            errors = [row[name] for row in same]
            known = None not in errors
            line[name] = float(np.linalg.norm(errors) / len(errors)) if known else None
        found.append(line)
    return found


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def words(means: Sequence[Sequence[dict[str, Any]]], partitions: int) -> list[str]:
    """What is seen, from the numbers."""
    text = [
        "f_P presses a learned tool into the ground seen from above; f_D adds the mean change of "
        "the image. Between them lie a few components. Each is left out of f_P by itself, and "
        "they are added to f_D one after the other; everything is fitted to three quarters of the "
        f"pairs and tested on the last quarter, in {partitions} random partitions.",
    ]
    for mean in means:
        by_name = {line["predictor"]: line["mean_mm"] for line in mean}
        whose = f"{mean[0]['set'].capitalize()}, {mean[0]['agent']}"
        up = [line for line in mean if line["part"] == ADDED]
        down = [line for line in mean if line["part"] == LEFT_OUT and line["step"]]
        gained, lost = _beyond(up, -1), _beyond(up, 1)
        text.append(
            f"{whose}: f_D {by_name[MEAN]:.2f} mm, f_P {by_name[WHOLE]:.2f} mm. Added one after "
            "the other, "
            + (
                f"most is gained by: {_listed(gained[:3])}. "
                if gained
                else "none gains more than twice its standard error. "
            )
            + (f"The error grows with: {_listed(lost)}. These are harmful there. " if lost else "")
        )
        ahead = _beyond(up, -1, "over_whole")
        if ahead:
            listed = _listed(ahead, "over_whole_mm", "predictor")
            text.append(f"Better than f_P with all its components: {listed}.")
        needed, harmful = _beyond(down, 1), _beyond(down, -1)
        others = [one["component"] for one in down if one not in (*needed, *harmful)]
        text.append(
            "Changed in f_P by itself, "
            + (
                f"the error grows: {_listed(needed)}. "
                if needed
                else "nothing grows the error by more than twice the standard error. "
            )
            + (
                f"The error falls: {_listed(harmful)}. What is left out there is harmful. "
                if harmful
                else ""
            )
            + (f"No change beyond twice the standard error: {', '.join(others)}." if others else "")
        )
    return [one.strip() for one in text]


def _beyond(
    lines: Sequence[dict[str, Any]], sign: int, what: str = "changed"
) -> list[dict[str, Any]]:
    """Lines whose error changes that way by more than twice the standard error, greatest first."""
    value, error = CHANGES[what]
    known = [line for line in lines if line[value] is not None and line[error] is not None]
    found = [line for line in known if sign * line[value] > 2 * line[error]]
    return sorted(found, key=lambda line: -sign * line[value])


def _listed(
    lines: Sequence[dict[str, Any]], value: str = "changed_by_mm", name: str = "component"
) -> str:
    return "; ".join(f"{line[name]} {line[value]:+.3f}" for line in lines) + " mm"


def _table(mean: Sequence[dict[str, Any]]) -> pages.Table:
    lines = []
    for line in mean:
        by, error = line["changed_by_mm"], line["changed_error_mm"]
        name = f"{line['predictor']}: " if not line["step"] else ""
        lines.append((
            line["part"], f"{name}{line['component']}",
            f"{line['mean_mm']:.3f} ± {line['std_mm']:.3f}",
            "-" if by is None else f"{by:+.3f} ± {error:.3f}",
            "-" if by is None else f"{100 * line['better']:.0f} %",
        ))  # fmt: skip
    head = ("", "predictor", "error (mm)", "changed by that (mm)", "better on")
    return pages.Table(f"{mean[0]['set'].capitalize()}, {mean[0]['agent']}", head, lines)
