"""The check of the physics twin as Markdown and as the page of an experiment."""

from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.experiments import pages
from jshape.learn.report import markdown
from jshape.viz.overlay import COLOURS

FIGURES = ("twin.png",)


def page_of(content: dict[str, Any]) -> pages.Result:
    """The page: what is seen in words, a figure, the tables, a row per trial."""
    return pages.Result(
        title="The physics twin: every action at every place",
        paragraphs=words(content),
        rows=[_flat(row) for row in content["trials"]],
        tables=[
            pages.Table("Actions", *table(content)),
            pages.Table("A poke where something rigid is buried 8 mm below the surface",
                        *_obstacle(content)),
        ],
        pictures=[
            pages.Picture(
                FIGURES[0], partial(figure, content),
                "Left: how far from its place each action touched the bed, a dot per place. Right: "
                "the greatest effort of all joints and places in each operation.",
            )
        ],
        settings={"actions": [row["action"] for row in content["actions"]],
                  "places": len({tuple(row["place"]) for row in content["trials"]})},
        notes=["Drives are ideal and forces plausible, not measured: a real arm meets its places "
               "less well."],
    )  # fmt: skip


def words(content: dict[str, Any]) -> list[str]:
    """What is seen, from the numbers."""
    rows = content["actions"]
    errors = [one["place_error_mm"] for one in content["trials"]]
    done, trials = (sum(row[name] for row in rows) for name in ("completed", "trials"))
    hits = sum(row["collisions"] for row in rows)
    buried = content["obstacle"]["on it"]
    return [
        "The arm does every action at every place, each on the same fresh bed. Its controller sees "
        "the bed through its own depth camera and ends an operation when an effort passes its "
        "threshold.",
        f"{done} of {trials} actions were completed, with {hits} collisions; places were met "
        f"within {np.mean(errors):.2f} mm on average and {max(errors):.2f} mm at most.",
        f"A poke onto something rigid in the bed reached {buried['effort_nm']['act']:.0f} Nm; "
        + (f"it was ended by contact in: {', '.join(buried['ended_by_contact'])}."
           if buried["ended_by_contact"] else "nothing ended it."),
    ]  # fmt: skip


def figure(content: dict[str, Any]) -> Figure:
    """Place errors and efforts, by action."""
    names = [row["action"] for row in content["actions"]]
    made = Figure(figsize=(9.4, 3.2), layout="constrained")
    left, right = made.subplots(1, 2)
    for at, name in enumerate(names):
        errors = [one["place_error_mm"] for one in content["trials"] if one["action"] == name]
        beside = at + np.linspace(-0.2, 0.2, len(errors))
        left.plot(beside, errors, "o", color=COLOURS.get(name, "0.5"), markersize=4)
        left.plot([at - 0.3, at + 0.3], [np.mean(errors)] * 2, color="k", linewidth=1)
    left.set(xlim=(-0.6, len(names) - 0.4), ylim=(0, None), ylabel="place error (mm)")
    left.set_title("a dot per place; line: mean", fontsize=10)
    operations = list(content["actions"][0]["effort_nm"])
    for k, operation in enumerate(operations):
        at = np.arange(len(names)) + (k - (len(operations) - 1) / 2) * 0.2
        values = [row["effort_nm"][operation] for row in content["actions"]]
        right.bar(at, values, 0.18, label=operation, color=f"{0.8 - 0.2 * k}")
    right.set(ylabel="greatest effort (Nm)")
    right.legend(title="operation", fontsize=9, title_fontsize=9)
    for ax in (left, right):
        ax.set_xticks(range(len(names)), names)
        ax.grid(axis="y", alpha=0.3)
        ax.set_axisbelow(True)
    return made


def table(content: dict[str, Any]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Head and rows, an action each."""
    head = ("action", "completed", "collisions", "place error mm, mean", "max", "contact felt",
            "effort Nm: above", "contact", "act", "up", "least joint margin, degrees")  # fmt: skip
    rows = [
        (
            row["action"], f"{row['completed']} of {row['trials']}", str(row["collisions"]),
            f"{row['place_error_mm']['mean']:.2f}", f"{row['place_error_mm']['max']:.2f}",
            f"{row['contact_felt']} of {row['trials']}",
            *(f"{value:.1f}" for value in row["effort_nm"].values()),
            f"{row['joint_margin_degrees']:.1f}",
        )
        for row in content["actions"]
    ]  # fmt: skip
    return head, rows


def _obstacle(content: dict[str, Any]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    head = ("poke", "effort in the act (Nm)", "ended by contact", "operations",
            "greatest change of the bed (mm)")  # fmt: skip
    return head, [
        (where, f"{row['effort_nm']['act']:.0f}", ", ".join(row["ended_by_contact"]) or "none",
         str(row["operations"]), f"{row['deepest_change_mm']:.1f}")
        for where, row in content["obstacle"].items()
    ]  # fmt: skip


def _flat(row: dict[str, Any]) -> dict[str, Any]:
    """A trial as plain values."""
    efforts = {f"effort_{name}_nm": value for name, value in row["effort_nm"].items()}
    u, v = row["place"]
    said = {"u": u, "v": v, "ended_by_contact": ", ".join(row["ended_by_contact"]),
            "collisions": "; ".join(" - ".join(pair) for pair in row["collisions"])}  # fmt: skip
    return {n: x for n, x in row.items() if n not in ("effort_nm", "place")} | said | efforts


def report(content: dict[str, Any]) -> str:
    """The check as Markdown."""
    lines = [
        "# The twin, action by action",
        "",
        markdown(*table(content)),
        "## A buried obstacle",
        "",
    ]
    for where, row in content["obstacle"].items():
        ended = ", ".join(row["ended_by_contact"]) or "none"
        lines.append(
            f"- {where}: effort {row['effort_nm']['act']:.0f} Nm in the act, ended by contact: "
            f"{ended}; {row['operations']} operations; the bed changed by "
            f"{row['deepest_change_mm']:.1f} mm at most"
        )
    return "\n".join(lines) + "\n"
