"""A panel with a pocket and an open flap beside it, as points."""

import numpy as np

from perception.geometry import Array


def sheet(x: tuple[float, float], y: tuple[float, float], step: float = 0.001) -> Array:
    """(N, 2) grid."""
    return np.stack(np.meshgrid(np.arange(*x, step), np.arange(*y, step)), axis=-1).reshape(-1, 2)


def vehicle(opening_deg: float, hinge_x: float = -0.08, flap_m: float = 0.05, panel_m: float = 0.02) -> Array:
    """(N, 3) port frame: a panel with a pocket, and a flap hinged on its left, opened by an angle."""
    panel = sheet((-0.14, 0.14), (-0.14, 0.14))
    panel = panel[(np.abs(panel) > 0.075).any(axis=1)]
    flap = sheet((0.0, flap_m), (-0.07, 0.07))
    turn = np.deg2rad(opening_deg)
    # closed, the flap leads from its hinge over the pocket (+x); opened, it turns out of the vehicle
    x, z = hinge_x + flap[:, 0] * np.cos(turn), panel_m + flap[:, 0] * np.sin(turn)
    points = np.vstack([np.column_stack([panel, np.full(len(panel), panel_m)]), np.column_stack([x, flap[:, 1], z])])
    noisy: Array = points + np.random.default_rng(1).normal(0.0, 1e-4, points.shape)
    return noisy
