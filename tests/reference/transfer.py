"""The best carry, by trying every pair of places; plain NumPy, f_D, one loop each."""

import itertools

import numpy as np


def put(image, delta, position, strength):
    """The image after an f_D action at (u, v)."""
    h, w = delta.shape
    left, top = position[0] - w // 2, position[1] - h // 2
    after = np.array(image, np.float64)
    window = after[top : top + h, left : left + w]
    after[top : top + h, left : left + w] = np.clip(window + strength * delta, 0.0, 1.0)
    return after


def best(image, goal, take, bring, positions, strengths):
    """(gain of d, (place taken from, its strength, place brought to, its strength)).

    Args:
      image: (H, W) before.
      goal: (H, W) wanted.
      take: (h, w) change of the action that takes material out, at strength 1.
      bring: (h, w) likewise of the one that brings it.
      positions: (of take, of bring), each (N, 2) of (u, v).
      strengths: of take; the other is as strong as brings just what was taken.
    """
    found = 0.0, None
    for (p, s), q in itertools.product(itertools.product(positions[0], strengths), positions[1]):
        after = put(image, take, p, s)
        x = -(after - image).sum() / bring.sum()
        if not min(strengths) <= x <= max(strengths):
            continue
        both = put(after, bring, q, x)
        gain = np.abs(image - goal).mean() - np.abs(both - goal).mean()
        if gain > found[0] + 1e-9:
            found = gain, (tuple(p), s, tuple(q), x)
    return found
