"""Problems of planning of any size: two images of 8 bits, and what may be done where."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

import jshape
from jshape import actions, metric
from jshape.actions import PAPER_ROIS
from jshape.camera import Camera
from jshape.models.bank import Bank
from jshape.planning.plan import Plan
from jshape.planning.search.base import Status
from tests.reference import greedy as reference

LEVEL = 0.6
"""L of the flat bed that problems begin with: in the middle of what f_P was trained on."""


@dataclass(frozen=True, eq=False)
class Problem:
    """Two images of 8 bits, as a camera gives them, and what may be done where."""

    bank: Bank
    places: Mapping[str, np.ndarray]
    """Positions (N, 2) of (u, v) per action, ROIs inside the image."""
    luminance: np.ndarray
    """(H, W) of uint8: L of the bed now."""
    wanted: np.ndarray
    """(H, W) of uint8: L of the goal."""

    @property
    def count(self) -> int:
        """How many candidates."""
        return sum(len(at) for at in self.places.values())

    @property
    def pixels(self) -> int:
        """Of one image."""
        return self.luminance.size

    @cached_property
    def rays(self) -> np.ndarray:
        """R_uv / R̄, (H, W) float64."""
        return weights(self.bank.camera)

    @cached_property
    def to_mm(self) -> float:
        """Of d."""
        return float(metric.to_mm(1.0, self.bank.camera))

    @cached_property
    def exact_images(self) -> tuple[np.ndarray, np.ndarray]:
        """I of both: (H, W) float64."""
        return weighed(self.luminance, self.bank.camera), weighed(self.wanted, self.bank.camera)

    @cached_property
    def images(self) -> tuple[np.ndarray, np.ndarray]:
        """I of both: (H, W) float32."""
        one, other = self.exact_images
        return one.astype(np.float32), other.astype(np.float32)

    def ours(self, max_steps: int) -> Plan:
        """The public call: checks, search, the predicted images and their distances."""
        return jshape.plan(
            *self.images,
            **jshape.options(
                jshape.PAPER, bank=self.bank, positions=self.places, max_steps=max_steps
            ),
        )

    def twin(self, max_steps: int) -> list[tuple[int, int, int]]:
        """The steps that the reference twin finds; f_D only."""
        deltas = [np.asarray(predictor.delta) for predictor in self.bank.predictors]
        at = [self.places[name] for name in self.bank.actions]
        return reference.greedy(*self.images, deltas, at, max_steps)[0]

    def evaluated(self, plan: Plan) -> tuple[int, int]:
        """Candidates that a search of this plan evaluates, and the pixels of their windows.

        All at first; after each action those that its window touches, the others are remembered.
        None after one that ends the search.
        """
        rois = np.array([self.bank.roi(name) for name in self.places])
        areas = np.repeat(rois.prod(1), [len(at) for at in self.places.values()])
        sizes = np.repeat(rois, [len(at) for at in self.places.values()], 0)
        first = actions.first_pixels(np.concatenate(list(self.places.values())), sizes)
        count, pixels = len(areas), int(areas.sum())
        ends = plan.status in (Status.CONVERGED, Status.MAX_STEPS) and len(plan) > 0
        begins = actions.first_pixels(plan.positions, plan.rois)
        for begin, size in list(zip(begins, plan.rois, strict=True))[: len(plan) - ends]:
            touched = ((first < begin + size) & (begin < first + sizes)).all(1)
            count, pixels = count + int(touched.sum()), pixels + int(areas[touched].sum())
        return count, pixels


def weighed(luminance: np.ndarray, camera: Camera) -> np.ndarray:
    """I of 8-bit luminance, float64."""
    return luminance / 255.0 * weights(camera)


def rounded(image: np.ndarray, camera: Camera) -> np.ndarray:
    """L of an image I, rounded to 8 bits."""
    return np.rint(np.clip(image / weights(camera), 0, 1) * 255).astype(np.uint8)


def weights(camera: Camera) -> np.ndarray:
    """R_uv / R̄, (H, W) float64."""
    rays = np.asarray(metric.ray_lengths(camera), np.float64)
    return rays / float(metric.max_ray_length(camera))


def made_problem(
    bank: Bank,
    places: Mapping[str, np.ndarray],
    count: int,
    *,
    strengths: tuple[float, float] = (1.0, 1.0),
    noise: float = 0.0,
    seed: int = 0,
) -> Problem:
    """A flat bed, and a goal made by `count` of the candidates, each at most once.

    Args:
      bank: predicts what the actions do.
      places: of the candidates.
      count: of applied actions.
      strengths: least and greatest, drawn for each.
      noise: its standard deviation in both images, levels of 8 bits.
      seed: of all that is drawn.
    """
    rng, camera = np.random.default_rng(seed), bank.camera
    flat = LEVEL * weights(camera)
    image = flat.astype(np.float32)
    known = [(name, spot) for name, at in places.items() for spot in at]
    for k in rng.permutation(len(known))[:count]:
        name, spot = known[k]
        w, h = bank.roi(name)
        left, top = actions.first_pixels(spot, (w, h))
        window = np.s_[top : top + h, left : left + w]
        strength = rng.uniform(*strengths)
        image[window] = bank.predict(name, image[window], position=spot, strength=strength)
    now, goal = (x + noise / 255 * rng.standard_normal(x.shape) for x in (flat, image))
    return Problem(bank, places, rounded(now, camera), rounded(goal, camera))


def scaled(camera: Camera, width: int, height: int, times: float) -> Camera:
    """A camera of another size, with `times` as many pixels per ray, looking at the same middle."""
    return replace(
        camera, width=width, height=height, fx=camera.fx * times, fy=camera.fy * times,
        u0=width / 2, v0=height / 2,
    )  # fmt: skip


def half_size() -> tuple[Camera, dict[str, tuple[int, int]]]:
    """The paper's box at half its resolution, and the ROI sizes there."""
    return scaled(jshape.PAPER_BOX, 240, 198, 0.5), sized(PAPER_ROIS, 0.5)


def sized(rois: dict[str, tuple[int, int]], times: float) -> dict[str, tuple[int, int]]:
    return {name: (round(w * times), round(h * times)) for name, (w, h) in rois.items()}
