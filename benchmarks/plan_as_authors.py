"""Algorithm 1 computed the way the authors compute it.

Written from the paper (Algorithm 1; Eq. newMat, predStep1 to predStep3,
distNewImg) and from what is known of the authors' public search program; none of its code is here.
What it transcribes:

- Images are whole, in float64: 8-bit luminance over 255, times R_uv / R̄.
- One candidate after the other, action by action, place by place: its ROI is cut out, predicted
  alone, and put into a copy of the whole image.
- d is computed over the whole image of every candidate by NumPy, in mm.
- The predicted image is divided by R again and kept in 8 bits; the next step begins with that.  The
  program writes one PNG per candidate, each in a folder of its own, and reads the best one's back.
- Nothing is remembered from step to step; of equal candidates the first is taken.

In its favour: I of both images, R and the factor to mm are there before the clock starts, as they
are for `jshape.plan`; networks are loaded once, not at every step, and called without Keras; with
`folder` None only the best image is rounded, in memory.  It stops as the paper says, when no
candidate lowers d (the program takes the first action anyway, and ends after six).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.problems import Problem
from jshape.actions import first_pixels
from jshape.models.bank import Bank

FULL_IMAGE_PASSES = 10
"""How often `plan_as_authors` reads or writes a whole image per candidate: copy 2, difference 3,
absolute values 2, millimetres 2, sum 1."""

Predict = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""ROI (h, w) of I and its first pixel (u, v) to the ROI after the action."""


@dataclass
class AuthorsPlan:
    """What `plan_as_authors` did."""

    steps: list[tuple[int, int]] = field(default_factory=list)
    """Numbers of (action, place)."""
    images: list[np.ndarray] = field(default_factory=list)
    """I before the first step and after each, as rounded."""


def plan_as_authors(
    image: np.ndarray,
    goal: np.ndarray,
    rays: np.ndarray,
    to_mm: float,
    predictors: Sequence[Predict],
    rois: Sequence[tuple[int, int]],
    places: Sequence[np.ndarray],
    max_steps: int,
    *,
    folder: Path | None = None,
    tuned: bool = False,
) -> AuthorsPlan:
    """Algorithm 1 as the module's docstring says.

    Args:
      image: (H, W) of I now, float64, as made of 8 bits.
      goal: (H, W) of I wanted, likewise.
      rays: (H, W) of R_uv / R̄.
      to_mm: of d.
      predictors: one per action.
      rois: sizes (w, h) per action.
      places: (N, 2) of (u, v) per action, ROIs inside the image.
      max_steps: most actions.
      folder: where every candidate's image is written to; None: only in memory.
      tuned: float32 and `cv2.norm` instead: the same work by the fastest means at hand.
    """
    kind = np.float32 if tuned else np.float64

    def read(levels: np.ndarray) -> np.ndarray:
        return (levels / 255.0 * rays).astype(kind)

    def written(image: np.ndarray) -> np.ndarray:
        return np.rint(np.clip(image / rays * 255.0, 0, 255)).astype(np.uint8)

    def distance(image: np.ndarray) -> float:
        if tuned:
            return cv2.norm(image, goal, cv2.NORM_L1) * to_mm / image.size
        return float((np.abs(image - goal) * (to_mm / image.size)).sum())

    image, goal = (x.astype(kind, copy=False) for x in (image, goal))
    done, least = AuthorsPlan(images=[image]), distance(image)
    while len(done.steps) < max_steps:
        best, best_d, best_image = None, np.inf, image
        for a, (predict, (w, h), spots) in enumerate(zip(predictors, rois, places, strict=True)):
            for p, spot in enumerate(spots):
                left, top = first_pixels(spot, (w, h))
                roi = image[top : top + h, left : left + w]
                after = image.copy()
                after[top : top + h, left : left + w] = predict(roi, np.array([left, top]))
                d = distance(after)
                if folder is not None:
                    own = folder / f"{len(done.steps)}_{a}_{p}"
                    own.mkdir()
                    cv2.imwrite(str(own / "img.png"), written(after))
                if d < best_d:
                    best, best_d, best_image = (a, p), d, after
        if best is None or not best_d < least:
            return done
        if folder is None:
            image = read(written(best_image))
        else:
            own = folder / f"{len(done.steps)}_{best[0]}_{best[1]}"
            image = read(cv2.imread(str(own / "img.png"), cv2.IMREAD_GRAYSCALE))
        done.steps.append(best)
        done.images.append(image)
        least = distance(image)
    return done


@partial(jax.jit, static_argnames=["action"])
def _predicted(bank: Bank, roi: jax.Array, corner: jax.Array, action: int) -> jax.Array:
    return jnp.clip(bank.predictors[action](roi, corner), 0.0, 1.0)


def authors_way(
    problem: Problem, max_steps: int, *, files: bool = False, tuned: bool = False
) -> AuthorsPlan:
    """`plan_as_authors` of a problem: f_D by NumPy, other predictors one compiled call per ROI."""
    bank = problem.bank
    kind = np.float32 if tuned else np.float64

    def of(action: int) -> Predict:
        if bank.kind == "D":
            delta = np.asarray(bank.predictors[action].delta, kind)
            return lambda roi, corner: np.clip(roi + delta, 0.0, 1.0)
        return lambda roi, corner: np.asarray(
            _predicted(bank, np.float32(roi), np.int32(corner), action)
        )

    arguments = (
        *problem.exact_images, problem.rays, problem.to_mm,
        [of(a) for a in range(len(bank.actions))],
        list(bank.rois.values()), [problem.places[name] for name in bank.actions], max_steps,
    )  # fmt: skip
    if not files:
        return plan_as_authors(*arguments, tuned=tuned)
    with TemporaryDirectory() as folder:
        return plan_as_authors(*arguments, folder=Path(folder), tuned=tuned)
