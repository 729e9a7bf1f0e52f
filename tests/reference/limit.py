"""The bounds of `jshape.planning.limit` as linear programs that SciPy's HiGHS solves.

The convex relaxation has a column for every place.
"""

import numpy as np
from scipy.optimize import linprog


def columns(changes, shape):
    """(nodes, candidates) changes of the whole map; which of `changes` each is."""
    found, of = [], []
    for k, one in enumerate(changes):
        n, m = one.change.shape
        for v, u in np.argwhere(one.places) + one.low:
            whole = np.zeros(shape)
            whole[v : v + n, u : u + m] = one.change
            found.append(whole.ravel())
            of.append(k)
    return np.array(found).T, np.array(of)


def relaxed(wanted, weight, changes, uses):
    """Least Σ weight·max(|r - Σ x·c|, |r| - 2·Σ x·min(c, r) + Σ x·c), in the direction of r.

    With x >= 0, Σ x <= steps, of each action at most `most`, and no more brought than taken.
    """
    c, of = columns(changes, wanted.shape)
    nodes, count = c.shape
    r = wanted.ravel()
    sign = np.sign(r)[:, None]
    useful = np.minimum(np.maximum(sign * c, 0), np.abs(r)[:, None])
    actions = np.array([changes[k].action for k in of])
    one, none = np.eye(nodes), np.zeros
    rows = [np.ones(count), *(actions == a for a in range(len(uses.most)))]
    most = [uses.steps, *np.minimum(uses.most, 1e9)]
    brought = np.array([-uses.lower * changes[k].change.sum() for k in of])
    rows.append(np.where(np.isin(actions, list(uses.carried)), brought, 0.0))
    most.append(uses.stock)
    found = linprog(
        np.concatenate([none(count), weight.ravel()]),
        A_ub=np.block(
            [
                [np.array(rows, float), none((len(rows), nodes))],
                [-c, -one],
                [c, -one],
                [sign * c - 2 * useful, -one],
            ]
        ),
        b_ub=np.concatenate([most, -r, r, -np.abs(r)]),
    )
    assert found.status == 0, found.message
    return found.fun


def least_left(weight, room, missing):
    """Least Σ weight·e with Σ e >= missing, 0 <= e <= room."""
    found = linprog(weight, A_ub=-np.ones((1, len(weight))), b_ub=[-missing],
                    bounds=list(zip(np.zeros(len(room)), room, strict=True)))  # fmt: skip
    assert found.status == 0, found.message
    return found.fun
