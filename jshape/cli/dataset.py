"""`jshape dataset simulate` and `jshape dataset info`, and the parsers of the others."""

import argparse
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from jshape.camera import Camera
from jshape.cli import COMMANDS, arguments, dataset_annotate, dataset_import, dataset_recording
from jshape.cli.tables import print_table, progress
from jshape.data.missing import said as said_of
from jshape.io import cameras, datasets
from jshape.io.simulated import agent_of, material_of


def simulate(options: argparse.Namespace) -> dict[str, Any]:
    """`jshape dataset simulate OUT`."""
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
        strengths=tuple(options.strengths),
    )
    with datasets.dataset_writer(
        options.out, PAPER_BOX, DEPTH_UNIT, overwrite=options.overwrite
    ) as add:
        for index, pair in enumerate(progress(pairs, total, "simulating")):
            add(
                id=f"{pair.action}_{pair.agent}_{index:05d}",
                action=pair.action,
                agent=pair.agent,
                material=pair.material,
                prior=pair.prior,
                posterior=pair.posterior,
                u=pair.position[0],
                v=pair.position[1],
                width=pair.roi[0],
                height=pair.roi[1],
                strength=pair.strength,
            )
    if not options.json:
        print(f"{total} pairs: {options.out}")
    return {"out": str(options.out), "pairs": total}


def info(options: argparse.Namespace) -> dict[str, Any]:
    """`jshape dataset info DATASET`."""
    left_out: Counter[str] = Counter()
    pairs = datasets.load_pairs(options.dataset, left_out)
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
            })  # fmt: skip
    result = {
        "pairs": len(pairs),
        "camera": cameras.camera_fields(pairs.camera),
        "depth_unit": pairs.depth_unit,
        "missing_share": {"prior": missing[0], "posterior": missing[1]},
        "left_out": left_out,
        "groups": rows,
    }
    if not options.json:
        _print_camera(pairs.camera, pairs.depth_unit)
        print(f"without depth: {missing[0]:.1%} of prior, {missing[1]:.1%} of posterior pixels"
              f"{said_of(left_out)}")  # fmt: skip
        several = any(row["strength"] != [1.0, 1.0] for row in rows)
        print_table(
            ("action", "agent", "material", "pairs", "ROI (w x h)", "strength")[: 5 + several],
            [(r["action"], r["agent"], r["material"], r["pairs"], "{}x{}".format(*r["roi"]),
              "{:.2g} to {:.2g}".format(*r["strength"]))[: 5 + several]
             for r in rows],
        )  # fmt: skip
    return result


def _print_camera(camera: Camera, unit: float) -> None:
    fields = cameras.camera_fields(camera)
    print(", ".join(f"{name} {value}" for name, value in fields.items()), f"depth_unit {unit}",
          sep=", ")  # fmt: skip


def add(commands: Any) -> None:
    """The parser of `jshape dataset`."""
    dataset = commands.add_parser("dataset", help=COMMANDS["dataset"])
    dataset.set_defaults(help_of=dataset)
    datasets = dataset.add_subparsers(
        dest="subcommand", metavar="WHAT", parser_class=arguments.Parser
    )
    parser = arguments.command(datasets, "simulate", simulate, "simulated pairs of frames")
    parser.add_argument("out", type=Path, help="folder of the new data set")
    parser.add_argument(
        "--pairs",
        type=arguments.positive_count,
        default=25,
        help="per action and agent (default: 25)",
    )
    parser.add_argument("--actions", nargs="+", default=None, help="default: all five")
    parser.add_argument("--agents", nargs="+", default=["robot"], help=arguments.agents_help())
    arguments.add_material(parser)
    parser.add_argument("--beds", nargs="+", default=["flat"], help="flat, irregular, curved")
    parser.add_argument(
        "--frames", type=arguments.positive_count, default=5, help="averaged per look"
    )
    parser.add_argument(
        "--strengths", nargs=2, type=arguments.positive, default=[1.0, 1.0],
        metavar=("LOW", "HIGH"),
        help="how many times as deep as the agent's own, drawn between these (default: 1 1)",
    )  # fmt: skip
    parser.add_argument("--seed", type=arguments.seed, default=0)
    parser = arguments.command(datasets, "info", info, "what a data set holds", writes=False)
    parser.add_argument("dataset", type=Path)
    dataset_recording.add(datasets)
    dataset_annotate.add(datasets)
    dataset_import.add(datasets)
