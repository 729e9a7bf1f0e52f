"""Beam search over f_D, transcribed with loops over full images in float64."""

from tests.reference.greedy import distance, greedy, inject


def beam(image, goal, deltas, positions, max_steps, width, strengths=(1.0,), min_gain=0.0):
    """Returns (steps as (action, (u, v), strength), distance), the nearest of all met and greedy's.

    deltas: list of ΔI per action; positions: list per action of (u, v).
    """
    steps, distances, _ = greedy(
        image, goal, deltas, positions, max_steps, min_gain, strengths=strengths
    )
    best = [(i, tuple(positions[i][j]), strengths[k]) for i, j, k in steps]
    best_d = distances[-1]
    kept = [([], image)]
    for _ in range(max_steps):
        children = []  # of all sequences that go on, each set of actions once
        for steps, now in kept:
            for child in continued(steps, now, goal, deltas, positions, width, strengths, min_gain):
                if child[2] < best_d:
                    best, best_d = child[0], child[2]
                same = [k for k, one in enumerate(children) if sorted(one[0]) == sorted(child[0])]
                if not same:
                    children.append(child)
                elif child[2] < children[same[0]][2]:
                    children[same[0]] = child
        children.sort(key=lambda child: child[2])  # equals stay in order
        kept = [(steps, now) for steps, now, _ in children[:width]]
    return best, best_d


def continued(steps, image, goal, deltas, positions, width, strengths, min_gain):
    """The `width` best of the actions' best candidates, as (steps, image, distance) after each."""
    before = distance(image, goal)
    if before == 0:
        return []
    each = []
    for i, delta in enumerate(deltas):
        best = None
        for centre in positions[i]:
            for strength in strengths:
                after = inject(image, delta, centre, strength)
                d = distance(after, goal)
                if d < before - min_gain and (best is None or d < best[2]):
                    best = ([*steps, (i, tuple(centre), strength)], after, d)
        if best is not None:
            each.append(best)
    each.sort(key=lambda child: child[2])
    return each[:width]
