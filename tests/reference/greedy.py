"""Algorithm 1 and f_D, transcribed with loops over full images in float64."""

import numpy as np


def distance(a, b):
    """Eq. distNewImg."""
    total = 0.0
    for row_a, row_b in zip(a, b, strict=True):
        total += np.abs(row_a.astype(np.float64) - row_b.astype(np.float64)).sum()
    return total / a.size


def inject(image, delta, centre, strength=1.0):
    """The image after one action: Eq. predStep1, Doutput (clipped), predStep3."""
    h, w = delta.shape
    left, top = centre[0] - w // 2, centre[1] - h // 2
    after = image.astype(np.float64).copy()
    for v in range(h):
        for u in range(w):
            moved = after[top + v, left + u] + strength * np.float64(delta[v, u])
            after[top + v, left + u] = min(max(moved, 0.0), 1.0)
    return after


def greedy(
    image, goal, deltas, positions, max_steps, min_gain=0.0, tolerance=0.0, strengths=(1.0,)
):
    """Returns (steps as numbers of (action, position, strength), distances, status name).

    deltas: list of ΔI per action; positions: list per action of (u, v).
    """
    steps, distances = [], [distance(image, goal)]
    while True:
        if distances[-1] <= tolerance:
            return steps, distances, "CONVERGED"
        if len(steps) == max_steps:
            return steps, distances, "MAX_STEPS"
        best, best_d, best_image = None, None, None
        for i, delta in enumerate(deltas):
            for j, centre in enumerate(positions[i]):
                for k, strength in enumerate(strengths):
                    after = inject(image, delta, centre, strength)
                    d = distance(after, goal)
                    if best is None or d < best_d:
                        best, best_d, best_image = (i, j, k), d, after
        if best is None or not best_d < distances[-1] - min_gain:
            return steps, distances, "NO_IMPROVEMENT"
        steps.append(best)
        distances.append(best_d)
        image = best_image
