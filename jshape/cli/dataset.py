"""`jshape dataset simulate` and `jshape dataset info`, and where the others are."""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import App, Parameter

from jshape.cli.names import Action, Agent, Simulates
from jshape.cli.options import Common, Positive, PositiveCount, Seed, Several, Writes
from jshape.cli.tables import print_table, progress
from jshape.data.missing import said as said_of
from jshape.io import cameras, datasets
from jshape.io.simulated import agent_of, material_of

dataset = App(name="dataset")
for name, where, what in (
    ("simulate-recording", "dataset_recording:simulate_recording",
     "a simulated recording: a hand comes, acts and leaves, again and again"),
    ("segment", "dataset_recording:segment",
     "pairs of frames from a recording of repeated actions"),
    ("annotate", "dataset_annotate:annotate",
     "find where each pair changed; boxes drawn by hand stay"),
    ("import", "dataset_import:import_dataset", "pairs that others recorded, as a data set"),
    ("merge", "dataset_import:merge", "one data set of several of one camera"),
    ("from-run", "dataset_run:from_run", "pairs of frames from the actions of a run"),
):  # fmt: skip
    dataset.command(f"jshape.cli.{where}", name=name, help=what)


@dataclass(frozen=True, kw_only=True)
class DatasetOptions(Simulates, Writes):
    """Of `jshape dataset simulate`."""

    pairs: PositiveCount = 25
    """Number of pairs per action and agent."""
    actions: Annotated[list[Action] | None, Several] = None
    """Actions to simulate (default: all five)."""
    agents: Annotated[list[Agent], Several] = field(default_factory=lambda: ["robot"])
    """Hands that act: names or FILE.toml."""
    beds: Annotated[list[str], Several] = field(default_factory=lambda: ["flat"])
    """Shapes of the beds: flat, irregular, curved."""
    frames: PositiveCount = 5
    """Number of frames averaged per look."""
    strengths: Annotated[tuple[Positive, Positive], Parameter(metavar="LOW HIGH")] = (1.0, 1.0)
    """Bounds of the strengths drawn: multiples of the agent's own depth."""
    seed: Seed = 0
    """Random seed."""


@dataset.command(help="simulated pairs of frames")
def simulate(out: Path, /, options: DatasetOptions = DatasetOptions()) -> dict[str, Any]:
    """`jshape dataset simulate OUT`.

    Args:
      out: Folder of the new data set.
    """
    import jax

    from jshape.camera import PAPER_BOX
    from jshape.data.simulate import DEPTH_UNIT, ROIS, simulate_pairs

    actions = tuple(options.actions or ROIS)
    total = options.pairs * len(actions) * len(options.agents)
    pairs = simulate_pairs(
        jax.random.key(options.seed),
        options.pairs,
        actions=actions,
        agents=[agent_of(agent) for agent in options.agents],
        material=material_of(options.material),
        beds=options.beds,
        frames=options.frames,
        strengths=options.strengths,
    )
    with datasets.dataset_writer(out, PAPER_BOX, DEPTH_UNIT, overwrite=options.overwrite) as add:
        for index, pair in enumerate(progress(pairs, total, "simulating")):
            row = pair._asdict()
            (u, v), (width, height) = row.pop("position"), row.pop("roi")
            name = f"{pair.action}_{pair.agent}_{index:05d}"
            add(id=name, u=u, v=v, width=width, height=height, **row)
    print(f"{total} pairs: {out}")
    return {"out": str(out), "pairs": total}


@dataset.command(help="what a data set holds")
def info(dataset: Path, /, options: Common = Common()) -> dict[str, Any]:
    """`jshape dataset info DATASET`."""
    left_out: Counter[str] = Counter()
    pairs = datasets.load_pairs(dataset, left_out)
    missing = [
        float(np.mean([(counts == 0).mean() for counts in frames]))
        for frames in (pairs.prior, pairs.posterior)
    ]
    rows = []
    for action, mine in pairs.by_action():
        for agent in dict.fromkeys(mine.agent.tolist()):
            theirs = mine.of(agent=agent)
            rows.append({
                "action": action,
                "agent": agent,
                "material": "/".join(dict.fromkeys(theirs.material.tolist())),
                "pairs": len(theirs),
                "roi": list(pairs.roi_size(action)),
                "strength": [float(theirs.strength.min()), float(theirs.strength.max())],
                "path_mm": [float(theirs.path_mm.min()), float(theirs.path_mm.max())],
            })  # fmt: skip
    result = {
        "pairs": len(pairs),
        "camera": cameras.camera_fields(pairs.camera),
        "depth_unit": pairs.depth_unit,
        "missing_share": {"prior": missing[0], "posterior": missing[1]},
        "left_out": left_out,
        "groups": rows,
    }
    fields = result["camera"] | {"depth_unit": pairs.depth_unit}
    print(", ".join(f"{name} {value}" for name, value in fields.items()))
    share = f"{missing[0]:.1%} of prior, {missing[1]:.1%} of posterior pixels"
    print(f"without depth: {share}{said_of(left_out)}")
    several = any(row["strength"] != [1.0, 1.0] for row in rows)
    columns = {name: f"{{{name}}}" for name in ("action", "agent", "material", "pairs")}
    columns["ROI (w x h)"] = "{roi[0]}x{roi[1]}"
    columns |= {"strength": "{strength[0]:.2g} to {strength[1]:.2g}"} if several else {}
    moving = any(row["path_mm"][1] for row in rows)
    columns |= {"path (mm)": "{path_mm[0]:.0f} to {path_mm[1]:.0f}"} if moving else {}
    print_table(tuple(columns), [tuple(c.format(**r) for c in columns.values()) for r in rows])
    return result
