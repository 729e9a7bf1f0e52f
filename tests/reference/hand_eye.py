"""Hand-eye calibration by Park and Martin (1994), transcribed with loops."""

import numpy as np


def log(rotation):
    """Rotation vector."""
    angle = np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1))
    if angle < 1e-12:
        return np.zeros(3)
    skew = (rotation - rotation.T) / (2 * np.sin(angle))
    return angle * np.array([skew[2, 1], skew[0, 2], skew[1, 0]])


def park(moving, targets):
    """X of A X = X B, where A and B are the motions of `moving` and of `targets` between pairs."""
    motions = []
    for i in range(len(moving)):
        for j in range(i + 1, len(moving)):
            a = np.linalg.inv(moving[j]) @ moving[i]
            b = targets[j] @ np.linalg.inv(targets[i])
            motions.append((a, b))
    m = np.zeros((3, 3))
    for a, b in motions:
        m += np.outer(log(b[:3, :3]), log(a[:3, :3]))
    values, vectors = np.linalg.eigh(m.T @ m)
    root = vectors @ np.diag(values**-0.5) @ vectors.T
    rotation = root @ m.T
    left, right = [], []
    for a, b in motions:
        left.append(a[:3, :3] - np.eye(3))
        right.append(rotation @ b[:3, 3] - a[:3, 3])
    position = np.linalg.lstsq(np.concatenate(left), np.concatenate(right), rcond=None)[0]
    x = np.eye(4)
    x[:3, :3], x[:3, 3] = rotation, position
    return x
