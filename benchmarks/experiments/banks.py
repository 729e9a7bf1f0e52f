"""The bundled banks: made from nothing by one command, each with a card that says how good it is.

python -m benchmarks.experiments.banks weights [--only NAME] [--pairs COUNT] [--tested 25]
python -m benchmarks.experiments.banks weights --intervals      # of the banks that are there
"""

import argparse
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from jshape.camera import PAPER_BOX, PRESETS
from jshape.data.pairs import Pairs
from jshape.data.simulate import ALL_ROIS, ROIS, simulate_pairs, together
from jshape.io import banks
from jshape.io.files import write_json
from jshape.learn.evaluate import evaluate
from jshape.learn.fit import fit
from jshape.learn.intervals import fit_spread
from jshape.learn.scores import Score, roi_errors
from jshape.models.bank import Bank

BEDS = ("irregular", "irregular", "flat", "irregular", "curved")
"""Beds are drawn in turn: where the ground is uneven there is more to learn."""
FRAMES = 5
"""Frames averaged into each look."""
STRENGTHS = (0.2, 2.0)
"""Range of how many times as deep as the agent's own the actions go, as planning tries them."""
TABLE = (0.3, 0.5, 0.75, 1.5, 2.0)
"""Strengths that are tested besides 1."""
HOW_MANY = {5: "five", 8: "eight"}
TABLE_SHARE = 0.4
"""Of the pairs tested at strength 1, how many are tested at each of the others."""


class Recipe(NamedTuple):
    """What a bundled bank is made from."""

    material: str
    agent: str
    seed: int
    what: str = "pressed"
    """"pressed": the five actions that press; "moving": with those that move material."""
    pairs: int = 200
    """Per action, to fit to."""

    @property
    def name(self) -> str:
        """Of the bank."""
        return f"{self.what}-{self.material}-{self.agent}"

    @property
    def actions(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(ROIS if self.what == "pressed" else ALL_ROIS)


RECIPES = (
    Recipe("flour", "robot", 0),
    Recipe("flour", "human", 1),
    Recipe("sand", "robot", 2),
    Recipe("sand", "human", 3),
    Recipe("flour", "robot", 4, "moving", 75),
)


def make(recipe: Recipe, root: Path, *, pairs: int, tested: int, say: Callable[[str], Any]) -> Path:
    """Simulate pairs, fit f_P, test it and f_D on other pairs, and write the bank with its card.

    Args:
      recipe: what to make.
      root: folder of the banks.
      pairs: per action, to fit to.
      tested: per action, to measure the errors with.
      say: told what is going on.
    """
    say(f"{recipe.name}: simulating {pairs} + {tested} pairs an action")
    training = simulated(recipe, pairs, recipe.seed, STRENGTHS)
    testing = simulated(recipe, tested, recipe.seed + 1000)
    say(f"{recipe.name}: fitting")
    bank, plain = fit(training, "P"), fit(training, "D")
    spread = spreads(recipe, bank, tested)
    rows = [
        {"action": ours.action, "mm": ours.mean_mm, "f_D_mm": theirs.mean_mm,
         "change_mm": ours.change_mm, "spread": spread[ours.action]}
        for ours, theirs in zip(evaluate(bank, testing), evaluate(plain, testing), strict=True)
    ]  # fmt: skip
    say(f"{recipe.name}: testing at {len(TABLE)} other strengths")
    few = max(1, round(TABLE_SHARE * tested))
    table = {
        strength: evaluate(bank, simulated(recipe, few, recipe.seed + 2000, (strength, strength)))
        for strength in TABLE
    }
    info = {
        "data": {
            "source": "jshape's simulator",
            "material": recipe.material,
            "agent": recipe.agent,
            "pairs_per_action": pairs,
            "strengths": list(STRENGTHS),
            "beds": list(BEDS),
            "frames": FRAMES,
            "seed": recipe.seed,
        },
        "errors": rows,
        "licence": "Apache-2.0",
    }
    folder = banks.save_bank(
        bank, root / recipe.name, info=info, overwrite=True,
        extras={"card.md": card(recipe, bank, rows, table, pairs, tested)},
    )  # fmt: skip
    say(f"{recipe.name}: {np.mean([row['mm'] for row in rows]):.3f} mm, {folder}")
    return folder


def spreads(recipe: Recipe, bank: Bank, count: int) -> dict[str, list[float]]:
    """(mm, share) of each action's 80 % interval, on `count` other pairs of all strengths."""
    others = simulated(recipe, count, recipe.seed + 3000, STRENGTHS)
    return {
        name: [round(x, 4) for x in fit_spread(roi_errors(bank, others, name).pixels_mm)]
        for name in bank.actions
    }


def add_intervals(recipe: Recipe, root: Path, count: int, say: Callable[[str], Any]) -> None:
    """Write the intervals into the manifest of a bank that is there; its arrays stay."""
    folder = root / recipe.name
    manifest = banks.bank_manifest(folder)
    found = spreads(recipe, banks.load_bank(folder), count)
    for row in manifest["errors"]:
        row["spread"] = found[row["action"]]
    write_json(folder / banks.MANIFEST, manifest)
    say(f"{recipe.name}: {found}")


def card(
    recipe: Recipe,
    bank: Bank,
    rows: Sequence[dict],
    table: Mapping[float, Sequence[Score]],
    pairs: int,
    tested: int,
) -> str:
    """What people should know of a bank, in Markdown.

    Args:
      recipe: what it was made from.
      bank: itself.
      rows: errors at strength 1 per action.
      table: strength -> errors per action.
      pairs: per action, fitted to.
      tested: per action, at strength 1.
    """
    camera = next((name for name, known in PRESETS.items() if known == bank.camera), "its own")
    lines = [
        f"# {recipe.name}",
        "",
        f"What {HOW_MANY[len(recipe.actions)]} actions of a {recipe.agent} do to "
        f"{recipe.material}: a tool learned per action, pressed into the ground"
        f"{', and a heap of what it moves' * (recipe.what == 'moving')} (kind P).",
        "",
        f"**Data.** {pairs} simulated pairs per action (`jshape.data.simulate`; beds drawn in turn "
        f"from {', '.join(BEDS)}; {FRAMES} noisy frames averaged per look; seed {recipe.seed}), "
        f"camera {camera} at 0.45 m.  Each goes {STRENGTHS[0]:g} to {STRENGTHS[1]:g} times as deep "
        "as the agent's own (log-uniformly): its strength.  No measurement of real material is in "
        "it.",
        "",
        f"**Errors**, mm over the ROI, on {tested} other simulated pairs per action of strength 1 "
        "on the same kinds of bed:",
        "",
        "| action | ROI (w x h) | change | f_D | this bank |",
        "|---|---|---|---|---|",
    ]
    for row in rows:
        w, h = bank.roi(row["action"])
        lines.append(
            f"| {row['action']} | {w}x{h} | {row['change_mm']:.2f} | {row['f_D_mm']:.2f} | "
            f"{row['mm']:.2f} |"
        )
    strengths = sorted([1.0, *table])
    counts = [line.count for lines_of in table.values() for line in lines_of]
    lines += [
        "",
        f"**At other strengths**, error / change in mm, on {max(counts)} other pairs each:",
        "",
        "| action | " + " | ".join(f"{strength:g}" for strength in strengths) + " |",
        "|---" * (len(strengths) + 1) + "|",
    ]
    for number, row in enumerate(rows):
        found = {1.0: (row["mm"], row["change_mm"])}
        found |= {x: (line[number].mean_mm, line[number].change_mm) for x, line in table.items()}
        cells = ["{:.2f} / {:.2f}".format(*found[strength]) for strength in strengths]
        lines.append(f"| {row['action']} | " + " | ".join(cells) + " |")
    lines += [
        "",
        "**Limits.** The simulator is fitted to an independent material-point simulation of flour "
        "and kinetic sand, not to measurements; its grasps in sand are too deep.  Bring pairs of "
        "your own hand and material and adapt this bank to them: `jshape train YOURS --kind P "
        f"--start {recipe.name} --out BANK`; 5 to 25 pairs an action are enough.",
        "",
        f"**Again.** `python -m benchmarks.experiments.banks weights --only {recipe.name} "
        f"--pairs {pairs} --tested {tested}`",
        "",
    ]
    return "\n".join(lines)


def simulated(
    recipe: Recipe, count: int, seed: int, strengths: tuple[float, float] = (1.0, 1.0)
) -> Pairs:
    """`count` simulated pairs per action, as a bundled bank is made from."""
    return together(
        simulate_pairs(
            jax.random.key(seed),
            count,
            actions=recipe.actions,
            agents=(recipe.agent,),
            material=recipe.material,
            beds=BEDS,
            camera=PAPER_BOX,
            frames=FRAMES,
            strengths=strengths,
        )
    )


def _say(line: str) -> None:
    print(line, flush=True)


def main() -> None:
    """Make all bundled banks, or one."""
    parser = argparse.ArgumentParser(description="Make the bundled banks again.")
    parser.add_argument("root", type=Path, help="folder of the banks: weights")
    parser.add_argument("--only", choices=[recipe.name for recipe in RECIPES])
    parser.add_argument("--pairs", type=int, help="per action (default: the recipe's)")
    parser.add_argument("--tested", type=int, default=25, help="per action (default: 25)")
    parser.add_argument(
        "--intervals", action="store_true", help="measure the intervals of banks that are there"
    )
    options = parser.parse_args()
    for recipe in RECIPES:
        if options.only in (None, recipe.name):
            pairs = options.pairs or recipe.pairs
            if options.intervals:
                add_intervals(recipe, options.root, options.tested, _say)
                continue
            make(recipe, options.root, pairs=pairs, tested=options.tested, say=_say)


if __name__ == "__main__":
    main()
