"""How far the predictors are from what came out, and from the best that any could do.

    python -m benchmarks.predictors --data DIR [--kinds D P] [--start-for GROUP=BANK ...]
    python -m benchmarks.predictors --simulated [--count 24] [--groups irregular_sand_human ...]
    python -m benchmarks.predictors --deeper 2.5

DIR holds data sets in the project's format, one folder each (the independent material-point pairs
if it is left out).  Every kind is fitted and tested on the same partitions.  `gap closed` is the
share of the way from f_D's error to the noise floor: the floor is measured where the data allow it
(and, with --simulated, by acting twice on the same bed); --floor-share S takes S times f_D's error.

--deeper S: knock and poke, fitted to pairs as deep as the agent goes and tested S times as deep,
and fitted 1/S as deep and tested at the agent's depth; the predictors are told the strength S.
"""

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path

import jax
import numpy as np

from benchmarks.sim_against_mpm import default_data
from jshape import PAPER_BOX, Pairs, load_bank, load_pairs, sim
from jshape.cli.tables import print_table, progress
from jshape.data.simulate import DEPTH_UNIT, ROIS, look, random_bed
from jshape.learn.evaluate import candidates_of
from jshape.learn.fit import fit
from jshape.learn.noise_floor import Floor, noise_floor
from jshape.learn.report import comparison_table, markdown, scores_table
from jshape.learn.scores import Score, compare, roi_errors_mm, summarise, with_floor
from jshape.learn.study import Candidate, Study

SIMULATED = tuple(
    f"{bed}_{material}_{agent}"
    for bed in ("flat", "irregular")
    for material in ("flour", "sand")
    for agent in ("robot", "human")
)


def simulated(
    seed: int,
    group: str,
    count: int,
    *,
    actions: Sequence[str] = tuple(ROIS),
    deep: float = 1.0,
    repeat: int = 1,
    frames: int = 10,
) -> Pairs:
    """`count` beds per action, each acted on `repeat` times at one place, as a data set.

    Args:
      seed: of everything.
      group: bed, material and agent, as in `SIMULATED`.
      count: beds per action.
      actions: names.
      deep: times the agent's depth.
      repeat: repetitions on each bed.
      frames: frames averaged into each look (0.45 mm of noise each); 0 looks without noise.
    """
    kind, material, agent = group.split("_")
    key, camera, rows = jax.random.key(seed), PAPER_BOX, []
    noise = {"frames": frames} if frames else {"noise": 0.0}
    for action in actions:
        w, h = ROIS[action]
        low = np.array([w // 2, h // 2])
        high = low + np.array([camera.width - w, camera.height - h])
        for index in range(count):
            key, for_bed, for_place, *keys = jax.random.split(key, 3 + 3 * repeat)
            bed = random_bed(for_bed, kind)
            place = np.asarray(jax.random.randint(for_place, (2,), low, high + 1))
            xy = sim.position_to_xy(camera, place)
            for k in range(repeat):
                after = sim.apply_action(keys[3 * k], bed, material, (action, agent), xy, deep)
                shots = [
                    np.asarray(sim.to_uint16(look(shot, one, camera, **noise), DEPTH_UNIT))
                    for shot, one in zip(keys[3 * k + 1 : 3 * k + 3], (bed, after), strict=True)
                ]
                rows.append((*shots, action, place, (w, h), f"{action}_{index:03d}_{k}"))
    prior, posterior, names, places, sizes, ids = (np.array(x) for x in zip(*rows, strict=True))
    return Pairs(
        camera=camera, depth_unit=DEPTH_UNIT, prior=prior, posterior=posterior, action=names,
        agent=np.full(len(rows), agent), material=np.full(len(rows), material), centre=places,
        size=sizes, id=ids,
    )  # fmt: skip


def compared(
    pairs: Pairs, candidates: Sequence[Candidate], partitions: int, what: str
) -> tuple[list[Score], list]:
    """Scores without floors, and the comparisons with the first candidate."""
    study = Study(pairs, candidates, partitions)
    steps = progress(study, len(study), what)
    trials = list(chain.from_iterable(steps))
    return summarise(trials), compare(trials, candidates[0].label)


def with_floors(scores: list[Score], floors: dict, share: float | None, first: str) -> list[Score]:
    """The scores with measured floors, or with a share of the first predictor's error."""
    base = {(s.action, s.agent): s.mean_mm for s in scores if s.predictor == first}
    if share is not None:
        floors = {key: Floor(share * mean, "share", 0) for key, mean in base.items()}
    return [with_floor(s, floors.get((s.action, s.agent))) for s in scores]


def gap_closed(scores: Sequence[Score], first: str) -> list[tuple[str, str]]:
    """(predictor, share of the way from the first's error to the floor) for the others."""
    known = [s for s in scores if s.floor_mm is not None and s.floor_from != "flat"]
    base = [s for s in known if s.predictor == first]
    found = []
    for name in dict.fromkeys(s.predictor for s in known if s.predictor != first):
        mine = [s for s in known if s.predictor == name]
        gap = sum(s.mean_mm - s.floor_mm for s in base)
        won = sum(s.mean_mm for s in base) - sum(s.mean_mm for s in mine)
        found.append((name, f"{100 * won / gap:.0f} %" if gap > 0 else "no gap"))
    return found


def report(what: str, scores: list[Score], comparisons: list, first: str, lines: list[str]) -> None:
    """Print one group, and keep it as Markdown."""
    print(f"\n{what}")
    tables = [scores_table(scores)]
    if comparisons:
        tables.append(comparison_table(comparisons))
    closed = gap_closed(scores, first)
    if closed:
        tables.append((("predictor", "gap closed"), closed))
    lines.append(f"\n### {what}\n")
    for head, rows in tables:
        print_table(head, rows)
        lines.append(markdown(head, rows))


def deeper(times: float, options: argparse.Namespace) -> None:
    """Fit at one depth, test at another."""
    rows = []
    for group in options.groups or ("irregular_flour_robot", "irregular_sand_human"):
        for action in ("knock", "poke"):
            for learned in (1.0, 1.0 / times):
                tested = learned * times
                more = {"actions": (action,), "frames": options.frames}
                train = simulated(1, group, options.count, deep=learned, **more)
                test = simulated(2, group, options.count, deep=tested, **more)
                twice = simulated(3, group, 6, deep=tested, repeat=2, **more)
                floor = next((f.mm for f in noise_floor(twice).values()), float("nan"))
                # f_D as the paper has it knows one depth; scaled, it is told the strength too.
                plain = roi_errors_mm(fit(train, "D"), test, action)
                change = plain[1]
                errors = {"D": float(plain[0].mean())}
                for kind in options.kinds:
                    deeper = replace(test, strength=times * test.strength)
                    told = roi_errors_mm(fit(train, kind), deeper, action)
                    errors[f"{kind} x {times:g}"] = float(told[0].mean())
                same = roi_errors_mm(fit(test, "D"), test, action)[0].mean()
                base = errors["D"]
                rows.append(
                    (group, action, f"{learned:g} -> {tested:g}", f"{change.mean():.2f}",
                     f"{floor:.2f}", *(f"{e:.2f}" for e in errors.values()),
                     *(f"{e / base:.2f}" for e in list(errors.values())[1:]), f"{same:.2f}")
                )  # fmt: skip
    told = tuple(f"{kind} x {times:g}" for kind in options.kinds)
    head = ("group", "action", "depth", "change (mm)", "floor (mm)", "D (mm)")
    head += tuple(f"{name} (mm)" for name in told) + tuple(f"{name} / D" for name in told)
    head += ("D fitted to the test (mm)",)
    print_table(head, rows)
    if options.out:
        options.out.write_text(markdown(head, rows))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=default_data() / "pairs")
    parser.add_argument("--groups", nargs="+", help="only these data sets")
    parser.add_argument("--kinds", nargs="+", default=["D", "P"])
    parser.add_argument("--start-for", nargs="+", default=[], metavar="GROUP=BANK")
    parser.add_argument("--partitions", type=int, default=4)
    parser.add_argument("--floor-share", type=float)
    parser.add_argument("--simulated", action="store_true")
    parser.add_argument("--count", type=int, default=24, help="simulated pairs per action")
    parser.add_argument("--frames", type=int, default=10, help="0: without camera noise")
    parser.add_argument("--deeper", type=float)
    parser.add_argument("--out", type=Path, help="the tables as Markdown")
    options = parser.parse_args()
    if options.deeper is not None:
        return deeper(options.deeper, options)
    starts = dict(item.split("=", 1) for item in options.start_for)
    folders = sorted(path.parent for path in options.data.glob("*/pairs.csv"))
    groups = SIMULATED if options.simulated else tuple(folder.name for folder in folders)
    unknown = set(options.groups or ()) | set(starts)
    if not groups or unknown - set(groups):
        parser.error(f"no group {sorted(unknown - set(groups))}; there are {', '.join(groups)}")
    lines: list[str] = []
    for group in options.groups or groups:
        began = time.perf_counter()
        candidates = candidates_of(options.kinds)
        if group in starts:
            bank = load_bank(starts[group])
            name = Path(starts[group]).name
            candidates.append(Candidate(bank.kind, bank, fitted=False, name=f"{name} as it is"))
            candidates.append(Candidate(bank.kind, bank, name=f"{bank.kind} from {name}"))
        if options.simulated:
            pairs = simulated(1, group, options.count, frames=options.frames)
            floors = noise_floor(simulated(2, group, 6, repeat=2, frames=options.frames))
        else:
            pairs = load_pairs(options.data / group)
            floors = noise_floor(pairs)
        first = candidates[0].label
        scores, comparisons = compared(pairs, candidates, options.partitions, group)
        scores = with_floors(scores, floors, options.floor_share, first)
        took = time.perf_counter() - began
        whose = "simulated " if options.simulated else ""
        report(
            f"{whose}{group}, {len(pairs)} pairs, {took:.0f} s", scores, comparisons, first, lines
        )
        sys.stdout.flush()
    if options.out:
        options.out.write_text("".join(f"{line}\n" for line in lines).lstrip())


if __name__ == "__main__":
    main()
