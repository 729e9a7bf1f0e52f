"""What each command does: from parsed options to a result that JSON can hold.

Each prints for people unless `--json` is given; then only the result is printed, by `cli.main`.
Heavy imports (drawing, OpenCV) happen where they are needed: `jshape --help` must be quick.
"""

import argparse
import re
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from jshape import metric
from jshape.actions import grid
from jshape.camera import PRESETS, Camera, check_camera, window_of
from jshape.errors import BadCamera, BadImage, BadPosition
from jshape.planning import DEFAULT_BANK, Plan, image_of_depth, plan_depth
from jshape.predict.bank import Bank
from jshape.store import banks, cameras, datasets, files, images, plans, points

Options = argparse.Namespace


def plan(options: Options) -> dict[str, Any]:
    """`jshape plan INITIAL DESIRED`."""
    bank_name = options.bank or DEFAULT_BANK
    bank = banks.load_bank(bank_name)
    if options.out is not None:
        files.check_target(options.out, options.overwrite, marker="plan.json")
    camera, unit = _camera_for(options.initial, options.camera, bank)
    unit = options.depth_unit or unit
    check_camera(camera)
    now = images.read_depth(options.initial, camera=camera, depth_unit=unit)
    wanted = points.read_goal(options.desired, camera=camera, depth_unit=unit)
    found = plan_depth(
        now,
        wanted,
        bank=bank,
        camera=camera,
        reproject=options.reproject,
        planner=options.planner,
        positions=_positions(options.positions, bank),
        clip=options.clip,
        max_steps=options.max_steps,
        min_gain=options.min_gain_mm / float(metric.to_mm(1.0, bank.camera)),
        max_missing=options.max_missing,
        names=(str(options.initial), str(options.desired)),
    )
    view = found.view
    bed = (float(bank.camera.z_min) + float(bank.camera.z_max)) / 2
    own = view.pixels(found.positions, bed) if view is not None else found.positions
    result = {"bank": str(bank_name), "camera_pixels": own.tolist()} | plans.plan_fields(found)
    if options.out is not None:
        goal, _ = image_of_depth(wanted, bank.camera, view=view, max_missing=options.max_missing)
        with files.atomic_folder(options.out, options.overwrite, marker="plan.json") as folder:
            plans.write_plan(folder / "plan.json", found)
            _draw_plan(folder, found, goal)
        result["out"] = str(options.out)
    if not options.json:
        _print_plan(found, str(bank_name), own)
        if options.out is not None:
            print(f"plan and pictures: {options.out}")
    return result


def demo(options: Options) -> dict[str, Any]:
    """`jshape demo`: the main job in simulation, closed loop."""
    from jshape.experiments.demo import run_demo

    return run_demo(
        options.out,
        bank_name=options.bank,
        seed=options.seed,
        actions=options.actions,
        max_steps=options.max_steps,
        material=options.material,
        agent=options.agent,
        replan=not options.open_loop,
        overwrite=options.overwrite,
        say=(lambda line: None) if options.json else lambda line: print(line, flush=True),
    )


def simulate(options: Options) -> dict[str, Any]:
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
        agents=options.agents,
        material=options.material,
        beds=options.beds,
        frames=options.frames,
    )
    with datasets.dataset_writer(
        options.out, PAPER_BOX, DEPTH_UNIT, overwrite=options.overwrite
    ) as add:
        for index, pair in enumerate(_progress(pairs, total, "simulating")):
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
            )
    if not options.json:
        print(f"{total} pairs: {options.out}")
    return {"out": str(options.out), "pairs": total}


def info(options: Options) -> dict[str, Any]:
    """`jshape dataset info DATASET`."""
    pairs = datasets.load_pairs(options.dataset)
    missing = [float((frames == 0).mean()) for frames in (pairs.prior, pairs.posterior)]
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
            })  # fmt: skip
    result = {
        "pairs": len(pairs),
        "camera": cameras.camera_fields(pairs.camera),
        "depth_unit": pairs.depth_unit,
        "missing_share": {"prior": missing[0], "posterior": missing[1]},
        "groups": rows,
    }
    if not options.json:
        _print_camera(pairs.camera, pairs.depth_unit)
        print(f"without depth: {missing[0]:.1%} of prior, {missing[1]:.1%} of posterior pixels")
        _print_table(
            ("action", "agent", "material", "pairs", "ROI (w x h)"),
            [(r["action"], r["agent"], r["material"], r["pairs"], "{}x{}".format(*r["roi"]))
             for r in rows],
        )  # fmt: skip
    return result


def train(options: Options) -> dict[str, Any]:
    """`jshape train DATASET --out BANK`."""
    from jshape.learn.fit import fit

    files.check_target(options.out, options.overwrite, marker=banks.MANIFEST)
    pairs = datasets.load_pairs(options.dataset)
    bank = fit(pairs, options.kind)
    data = {
        "pairs": {name: len(mine) for name, mine in pairs.by_action()},
        "agents": list(dict.fromkeys(pairs.agent.tolist())),
        "materials": list(dict.fromkeys(pairs.material.tolist())),
    }
    banks.save_bank(
        bank, options.out, info={"data": data, "licence": options.licence},
        overwrite=options.overwrite,
    )  # fmt: skip
    if not options.json:
        print(f"bank of kind {bank.kind}: {options.out}")
        _print_table(
            ("action", "pairs", "ROI (w x h)"),
            [(name, data["pairs"][name], "{}x{}".format(*bank.roi(name))) for name in bank.actions],
        )
    return {"out": str(options.out), "kind": bank.kind, "data": data, "rois": bank.rois}


def evaluate(options: Options) -> dict[str, Any]:
    """`jshape evaluate DATASET`."""
    from jshape.learn import evaluate as evaluation

    if options.out is not None:
        files.check_target(options.out, options.overwrite, marker="scores.csv")
    pairs = datasets.load_pairs(options.dataset)
    if options.bank is not None:
        how = f"bank {options.bank} on all pairs"
        scores = evaluation.evaluate(banks.load_bank(options.bank), pairs)
    else:
        how = f"f_{options.kind}, {options.partitions} random 75/25 partitions per agent"
        scores = evaluation.cross_validate(
            pairs, options.kind, partitions=options.partitions, seed=options.seed
        )
    mean = float(np.mean([s.mean_mm for s in scores]))
    result = {"how": how, "mean_mm": mean, "scores": [s._asdict() for s in scores]}
    if options.out is not None:
        from jshape.viz import pictures

        with files.atomic_folder(options.out, options.overwrite, marker="scores.csv") as folder:
            lines = [",".join(evaluation.Score._fields)]
            lines += [",".join(str(x) for x in score) for score in scores]
            files.write_atomic(folder / "scores.csv", "\n".join(lines) + "\n")
            files.write_atomic(folder / "scores.png", pictures.png(pictures.scores_figure(scores)))
    if not options.json:
        print(how)
        _print_table(
            ("action", "agent", "tested", "error (mm)", "std (mm)", "change (mm)"),
            [(s.action, s.agent, s.count, f"{s.mean_mm:.3f}", f"{s.std_mm:.3f}",
              f"{s.change_mm:.3f}") for s in scores],
        )  # fmt: skip
        print(f"mean error: {mean:.3f} mm")
    return result


def _camera_for(initial: Path, given: str | None, bank: Bank) -> tuple[Camera, float]:
    """The camera of the images and the metres per count: named, found beside, or the bank's."""
    if given in PRESETS:
        return PRESETS[given], cameras.DEPTH_UNIT
    if given is not None:
        if not Path(given).exists():
            raise BadCamera(f"{given}: neither a file nor a preset ({', '.join(PRESETS)})")
        return cameras.read_camera(given)
    beside = initial.parent / "camera.json"
    if beside.is_file():
        return cameras.read_camera(beside)
    shape = images.image_shape(initial)
    for camera in (bank.camera, *PRESETS.values()):
        if shape == camera.shape and window_of(bank.camera, camera) is not None:
            return camera, cameras.DEPTH_UNIT
    raise BadImage(
        f"{initial}: has {shape} (rows, columns); the bank's camera makes {bank.camera.shape}; "
        "describe your camera in a camera.json beside the image, or name one with --camera"
    )


def _positions(text: str | None, bank: Bank) -> np.ndarray | None:
    """Positions named on the command line: a grid "7x3", or a JSON file."""
    if text is None:
        return None
    size = re.fullmatch(r"([1-9]\d{0,3})x([1-9]\d{0,3})", text)
    if size:
        return grid(bank.camera, int(size[1]), int(size[2]), margin=bank.largest_roi)
    content = files.read_json(text) if Path(text).suffix == ".json" else None
    if content is None:
        raise BadPosition(f"positions {text!r}: expected COLUMNSxROWS or a .json file")
    try:
        return np.array(content["positions"], float)
    except (KeyError, TypeError, ValueError):
        raise BadPosition(f'{text}: expected {{"positions": [[u, v], ...]}}') from None


def _draw_plan(folder: Path, found: Plan, goal: np.ndarray) -> None:
    from jshape.viz import pictures

    files.write_atomic(folder / "plan.png", pictures.png(pictures.plan_figure(found, goal)))
    files.write_atomic(folder / "actions.png", pictures.png(pictures.overlay_figure(found)))
    names = ["now", *(f"{k + 1} {name}" for k, name in enumerate(found.actions)), "goal"]
    strip = pictures.strip_figure([*found.images, goal], names, found.camera)
    files.write_atomic(folder / "steps.png", pictures.png(strip))


def _print_plan(found: Plan, bank: str, own: np.ndarray) -> None:
    print(f"bank {bank}, {found.evaluations} predictions; pixels without depth that were filled: "
          f"{found.filled[0]} now, {found.filled[1]} in the goal")  # fmt: skip
    d = found.distances_mm
    rows: list[tuple[Any, ...]] = [("", "start", "", "", f"{d[0]:.3f}", "")]
    for k, name in enumerate(found.actions):
        u, v = own[k]
        rows.append((k + 1, name, u, v, f"{d[k + 1]:.3f}", f"{d[k] - d[k + 1]:.3f}"))
    _print_table(("step", "action", "u", "v", "to the goal (mm)", "gain (mm)"), rows)
    print(f"{found.status.name}: {found.status.meaning}")


def _print_camera(camera: Camera, unit: float) -> None:
    fields = cameras.camera_fields(camera)
    print(", ".join(f"{name} {value}" for name, value in fields.items()), f"depth_unit {unit}",
          sep=", ")  # fmt: skip


def _print_table(head: tuple[str, ...], rows: Iterable[tuple[Any, ...]]) -> None:
    lines = [head, *([str(cell) for cell in row] for row in rows)]
    widths = [max(len(line[k]) for line in lines) for k in range(len(head))]
    for line in lines:
        print("  ".join(cell.ljust(w) for cell, w in zip(line, widths, strict=True)).rstrip())


def _progress(items: Iterable[Any], total: int, what: str) -> Iterable[Any]:
    """A progress bar on stderr; none when that is not a terminal."""
    return tqdm(items, total=total, desc=what, disable=not sys.stderr.isatty(), leave=False)
