"""The sweep plan: parallel passes of a laser line over the port, as many as its width needs. Pure."""

from __future__ import annotations

import math

import numpy as np

from controller.config import ScanConfig, ViewpointConfig
from controller.planning import Viewpoint, plan_viewpoint
from perception.geometry import Pose
from perception.outline import outline_bounds
from perception.port_shape import PortShape


def port_width_m(shape: PortShape) -> float:
    """Width of what a sweep must see: the flange where there is one, else the rim; twice the larger half, as the
    sweep is centred on the port."""
    outline = shape.rim if shape.flange is None else shape.flange.outline
    low_x, _, high_x, _ = outline_bounds(outline)
    return 2.0 * max(-low_x, high_x)


def port_height_m(shape: PortShape) -> float:
    """The same along the sweep."""
    outline = shape.rim if shape.flange is None else shape.flange.outline
    _, low_y, _, high_y = outline_bounds(outline)
    return 2.0 * max(-low_y, high_y)


def pass_offsets_m(width_m: float, window_m: float, overlap: float) -> tuple[float, ...]:
    """Where the middles of the passes lie across a strip of ``width_m``: evenly, from its one edge to its other.

    Neighbouring lines overlap by at least ``overlap`` (0 to 1) of the window; one pass where the window is wide enough.
    """
    if window_m >= width_m:
        return (0.0,)
    count = 1 + math.ceil((width_m - window_m) / (window_m * (1.0 - overlap)) - 1e-9)
    reach = (width_m - window_m) / 2.0
    return tuple(float(x) for x in np.linspace(-reach, reach, count))


def plan_passes(
    T_base_port: Pose,
    view: ViewpointConfig,
    scan: ScanConfig,
    shape: PortShape,
    window_m: float,
    T_flange_scanner: Pose,
    T_flange_tcp: Pose,
) -> tuple[Viewpoint, ...]:
    """The straight sweeps that look at the port from one viewpoint, down and up in turn in the port's frame."""
    middle = plan_viewpoint(T_base_port, view, scan, T_flange_scanner, T_flange_tcp)
    T_scanner_tcp = T_flange_scanner.inverse() @ T_flange_tcp
    T_tcp_scanner = T_scanner_tcp.inverse()
    width_m = port_width_m(shape) + 2e-3 * scan.margin_mm if scan.width_mm is None else scan.width_mm / 1000.0
    passes = []
    for number, across_m in enumerate(pass_offsets_m(width_m, window_m, scan.overlap_percent / 100.0)):
        start, end = (
            (T_base_tcp @ T_tcp_scanner).moved([across_m, 0.0, 0.0]) @ T_scanner_tcp
            for T_base_tcp in (middle.T_base_tcp_start, middle.T_base_tcp_end)
        )
        passes.append(Viewpoint(start, end) if number % 2 == 0 else Viewpoint(end, start))
    return tuple(passes)
