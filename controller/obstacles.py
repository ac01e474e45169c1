"""What a scan shows beside the port that the arm must keep clear of: boxes in the base frame for planning."""

from __future__ import annotations

from drivers.base import Box
from perception.cover import find_cover
from perception.estimate import PortEstimate
from perception.scan import Cloud


def boxes_beside(cloud: Cloud, estimate: PortEstimate) -> tuple[Box, ...]:
    """The open charging cover as a box, if there is one.

    :param cloud: the scan that was located, in the base frame as the estimate is.
    :returns: nothing for an estimate that was not accepted, for it says not where the inlet is.
    :raises ValueError: scan or estimate in another frame than the base.
    """
    if cloud.frame != "base" or estimate.ref != "base":
        raise ValueError("boxes to keep clear of are told in the base frame")
    cover = find_cover(cloud, estimate) if estimate.accepted else None
    return () if cover is None else (Box(f"open cover ({cover.side})", cover.T_ref_box, cover.half_size_m),)
