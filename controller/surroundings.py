"""What a scan shows around the port that the arm must keep clear of."""

from __future__ import annotations

import logging

from drivers.base import Box
from perception.estimate import PortEstimate
from perception.scan import Cloud

log = logging.getLogger(__name__)


def boxes_around(cloud: Cloud | None, estimate: PortEstimate) -> tuple[Box, ...]:
    """Boxes in the base frame around what stands beside a located port: the open charging cover, if it is seen.

    :param cloud: the scan in the base frame, as ``estimate`` is; None where nothing was scanned.
    """
    from perception.cover import find_cover  # here: it brings libraries along that only a docking needs

    cover = None if cloud is None else find_cover(cloud, estimate)
    if cover is None:
        return ()
    log.info(
        "open cover, hinged %s of the port, seen to %.0f mm: the arm keeps clear of it", cover.side, 1e3 * cover.seen_m
    )
    return (Box(f"the open cover ({cover.side})", cover.T_ref_box, cover.half_size_m),)
