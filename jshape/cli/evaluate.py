"""`jshape evaluate DATASET`."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from jshape.cli.names import Bank
from jshape.cli.options import PositiveCount, Several, Writes
from jshape.cli.tables import bar, print_table
from jshape.cli.train import Kind, Trains
from jshape.errors import JShapeError
from jshape.io import banks, datasets, files, folders

SCORES = ("scores.csv", "scores.png", "scores.md", "sizes.csv", "sizes.png", "transfer.csv",
          "transfer.png")  # fmt: skip
"""Files of an evaluation's folder."""
AT_FLOOR = 1.1
"""Times its noise floor: a predictor so near to it leaves nothing to win."""
LEARNING = ("width", "epochs", "batch", "learning_rate", "patience", "validation")
"""Options of training that make sense here; there is nothing to resume."""


@dataclass(frozen=True, kw_only=True)
class EvaluateOptions(Trains, Writes):
    """Of `jshape evaluate`."""

    at_once = True

    bank: Bank | None = None
    """Bank to test on the whole data set."""
    kind: Kind | None = None
    """Kind to fit to each partition (default: D)."""
    kinds: Annotated[list[Kind] | None, Several] = None
    """Kinds to fit to each partition and compare."""
    partitions: PositiveCount = 4
    """Number of random partitions into training and test pairs."""
    across_agents: bool = False
    """Test each agent's bank on the others too."""
    sizes: Annotated[list[PositiveCount] | None, Several] = None
    """Sizes of training sets to compare, pairs per action (the paper: 5 10 25 50 75)."""
    start: Bank | None = None
    """Bank to adapt with few pairs."""
    few: Annotated[list[PositiveCount] | None, Several] = None
    """Numbers of pairs per action to adapt with (default: 5 10 25)."""
    out: Path | None = None
    """Folder for the tables and pictures."""


def evaluate(dataset: Path, /, options: EvaluateOptions = EvaluateOptions()) -> dict[str, Any]:
    """Measure the errors, print and write them.

    Args:
      dataset: Folder with pairs.csv.
    """
    from jshape.learn import evaluate as evaluation
    from jshape.learn import report as scored
    from jshape.learn import scores as measure
    from jshape.learn.noise_floor import noise_floor

    _check(options)
    if options.out is not None:
        folders.check_target(options.out, options.overwrite, contents=SCORES)
    pairs = datasets.load_pairs(dataset)
    comparisons: list[Any] = []
    studies: dict[str, list[Any]] = {}
    notes: list[str] = []
    if options.bank is not None:
        how = f"bank {options.bank} on all pairs; std over the pairs"
        scores = evaluation.evaluate(banks.load_bank(options.bank), pairs)
    else:
        # All are made, and checked, before the first runs for hours.
        watch = _Watch()
        main, others = _studies(options, pairs, watch, notes)
        floors = noise_floor(pairs)
        trials = watch.trials("partitions", main)
        scores = measure.summarise(trials, floors)
        comparisons = measure.compare(trials, main.candidates[0].label)
        notes += _explained(scores, comparisons)
        for name, study in others.items():
            studies[name] = measure.summarise(watch.trials(name, study), floors)
        named = ", ".join(f"f_{candidate.label}" for candidate in main.candidates)
        many = f"{main.partitions} random 75/25 partition" + "s" * (main.partitions > 1)
        over = "the pairs" if main.partitions == 1 else "their means"
        how = f"{named}, {many} per agent; std over {over}"
    first = [s.mean_mm for s in scores if s.predictor == scores[0].predictor]
    result = {"how": how, "mean_mm": float(np.mean(first)), "notes": notes}
    result["scores"] = [s._asdict() for s in scores]
    result |= {study: [s._asdict() for s in found] for study, found in studies.items()}
    result["comparisons"] = [
        {k: None if v != v else v for k, v in c._asdict().items()} for c in comparisons
    ]
    tables = {"": scored.scores_table(scores)}
    if comparisons:
        tables["Pair by pair"] = scored.comparison_table(comparisons)
    tables |= {TITLES[name]: scored.sizes_table(found) for name, found in studies.items()}
    if options.out is not None:
        _write(options.out, options.overwrite, how, scores, studies, tables)
    print(how)
    for title, table in tables.items():
        if title:
            print(f"\n{title.lower()}:")
        print_table(*table)
    for note in notes:
        print(f"\n{note}")
    mine = [s for s in scores if s.trained_on in ("", s.agent)]
    means = {
        name: np.mean([s.mean_mm for s in mine if s.predictor == name])
        for name in dict.fromkeys(s.predictor for s in mine)
    }
    listed = ", ".join(f"f_{name} {mean:.3f}" for name, mean in means.items())
    print(f"\nmean error: {listed if len(means) > 1 else f'{next(iter(means.values())):.3f}'} mm")
    return result


def _explained(scores: Sequence[Any], comparisons: Sequence[Any]) -> list[str]:
    """Why a predictor is not better than another: there is nothing to win, or too few pairs."""
    found = []
    for c in comparisons:
        mine = c.against, c.action, c.agent, c.trained_on
        of_all = ((s, (s.predictor, s.action, s.agent, s.trained_on)) for s in scores)
        base = next(s for s, theirs in of_all if theirs == mine)
        whose = f"{c.action} of {c.agent}: f_{c.predictor} against f_{c.against}"
        if base.floor_mm is not None and base.mean_mm <= AT_FLOOR * base.floor_mm:
            found.append(
                f"{whose}: f_{c.against} is at the noise floor ({base.mean_mm:.2f} mm, floor "
                f"{base.floor_mm:.2f}), so nothing is to be won here: what is left is what the "
                "hand does otherwise each time; on a level bed the mean change is all there is"
            )
        elif abs(c.difference_mm) < 2.0 * c.error_mm:
            found.append(f"{whose}: {c.count} pairs cannot tell them apart")
    return found


def _studies(
    options: EvaluateOptions, pairs: Any, watch: Any, notes: list[str]
) -> tuple[Any, dict[str, Any]]:
    """The comparison of kinds, and the other studies that were asked for, by name."""
    from jshape.learn import evaluate as evaluation
    from jshape.learn.study import Study, fewest

    candidates = evaluation.candidates_of(options.kinds or options.kind or "D")
    learning = {name: getattr(options, name) for name in LEARNING if name in options.given}
    more: dict[str, Any] = {"partitions": options.partitions, "seed": options.seed}
    more |= {"report": watch, "options": learning | {"seed": options.seed}}
    main = Study(pairs, candidates, across=options.across_agents, **more)
    others = {}
    if options.sizes:
        sizes = _sizes(pairs, options.sizes, notes)
        others["sizes"] = Study(pairs, candidates, sizes=sizes, **more)
    if options.start is not None:
        start, name, least = banks.load_bank(options.start), Path(options.start).name, fewest(pairs)
        fit = [size for size in evaluation.FEW if size <= least[0]] or [max(1, least[0])]
        few = _sizes(pairs, options.few, notes) if options.few else fit
        others["transfer"] = evaluation.few_shot(pairs, start, few, name, **more)
    return main, others


def _check(options: EvaluateOptions) -> None:
    fitting = ("kind", "kinds", "partitions", "sizes", "start", "few", "across_agents", *LEARNING)
    if options.bank is not None:
        options.refuse(fitting, ": for fitting; with --bank nothing is fitted")
    if options.kind and options.kinds:
        raise JShapeError("--kind names one kind and --kinds several; give one of the two options")
    if options.few and options.start is None:
        raise JShapeError("--few needs the bank to start from: --start BANK")


def _sizes(pairs: Any, wanted: Sequence[int], notes: list[str]) -> list[int]:
    """Those that every action has; the others are noted.  None of them is an error."""
    from jshape.learn.study import fewest

    least, action, agent = fewest(pairs)
    sizes = sorted(set(wanted))
    text = ", ".join(str(size) for size in sizes if size > least)
    what = f"{action} of {agent} has {least} pairs to fit to beside those for testing"
    if sizes[0] > least:
        raise JShapeError(f"training sets of {text} pairs per action: {what}")
    if text:
        notes.append(f"training sets of {text} pairs are left out: {what}")
    return [size for size in sizes if size <= least]


class _Watch:
    """A progress bar on a terminal, with the epoch of what is being trained."""

    def __init__(self):
        self.tell: Callable[..., None] = lambda **_: None

    def __call__(self, progress: Any) -> None:
        """Told of every epoch."""
        self.tell(said=f"{progress.action} epoch {len(progress.curve)}")

    def trials(self, what: str, study: Any) -> list[Any]:
        """All of a study's."""
        found: list[Any] = []
        with bar(what, len(study)) as self.tell:
            for done, trials in enumerate(study, 1):
                found += trials
                self.tell(completed=done)
        return found


def _write(
    out: Path, overwrite: bool, how: str, scores: Any, studies: dict[str, Any], tables: Any
) -> None:
    from jshape.learn import report as scored
    from jshape.viz import style

    pictures = {"scores.png": partial(scored.scores_figure, scores)}
    parts = (
        f"{title}:\n\n" * bool(title) + scored.markdown(*table) for title, table in tables.items()
    )
    with folders.atomic_folder(out, overwrite, contents=SCORES) as folder:
        files.write_atomic(folder / "scores.csv", scored.scores_csv(scores))
        for study, found in studies.items():
            files.write_atomic(folder / f"{study}.csv", scored.scores_csv(found))
            pictures[f"{study}.png"] = partial(scored.sizes_figure, found)
        files.write_atomic(folder / "scores.md", "\n".join([f"{how}\n", *parts]))
    for name, picture in style.drawn(pictures).items():
        files.write_atomic(out / name, picture)


TITLES = {
    "sizes": "By pairs per action, mean over the actions",
    "transfer": "Adapted with few pairs per action, mean over the actions",
}
