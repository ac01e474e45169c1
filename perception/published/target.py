"""The target cloud, prepared once: everything of the reference that each scan is compared with. Millimetres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from perception.geometry import Array
from perception.published import clouds
from perception.published.denoise import keep_mask, noise_statistics
from perception.published.features import FeatureScale, eigen_features, normals
from perception.published.kdtree import AdaptiveKDTree
from perception.published.keypoints import Keypoints, KeypointSettings, extract_keypoints
from perception.published.profiles import MethodSettings

_NORMAL_NEIGHBOURS = 24


@dataclass(frozen=True, slots=True, eq=False)
class PreparedTarget:
    """The reference of a port: a complete scan, merged scans or samples of CAD, in the port frame."""

    points: Array
    """(M, 3) after denoising with kappa_0, which no feedback changes."""
    normals: Array
    """(M, 3) of unknown sign."""
    tree: cKDTree
    spacing: float
    """Median nearest-neighbour distance."""
    scale: FeatureScale
    keypoints: Keypoints
    keypoint_tree: cKDTree
    keypoint_spacing: float
    """Median nearest-neighbour distance of the keypoints; twice this is c of the normalised (18)."""
    settings: KeypointSettings
    """With ``dist_min`` in mm: the same for target and scans."""


def prepare_target(points_mm: Array, settings: MethodSettings) -> PreparedTarget:
    """The same steps that a scan goes through, with kappa fixed.

    :raises UnitError: the cloud is not in millimetres.
    :raises DegenerateCloudError: it cannot determine a pose.
    """
    raw = clouds.in_millimetres(points_mm)
    raw = raw[np.isfinite(raw).all(axis=1)]
    clouds.check_shape(raw, settings.neighbours)
    tree = AdaptiveKDTree(raw, split=settings.split)
    s = clouds.spacing(tree, raw)
    if settings.denoise:
        statistics = noise_statistics(tree, settings.radius_spacings * s)
        tree.keep_only(keep_mask(statistics, settings.feedback.kappa_0, two_sided=settings.two_sided))
    kept, _, neighbours = tree.knn_of_kept(settings.neighbours)
    features = eigen_features(raw, neighbours)
    scale = FeatureScale.of(features)
    keypoint_settings = scaled(settings.keypoints, s)
    keypoints = extract_keypoints(raw[kept], features, keypoint_settings, scale)
    keypoint_tree = cKDTree(keypoints.points)
    gaps = keypoint_tree.query(keypoints.points, 2)[0][:, 1]
    return PreparedTarget(
        points=raw[kept],
        normals=normals(raw, neighbours[:, :_NORMAL_NEIGHBOURS]),
        tree=cKDTree(raw[kept]),
        spacing=s,
        scale=scale,
        keypoints=keypoints,
        keypoint_tree=keypoint_tree,
        keypoint_spacing=float(np.median(gaps)),
        settings=keypoint_settings,
    )


def scaled(settings: KeypointSettings, s: float) -> KeypointSettings:
    """Keypoint settings with ``dist_min`` turned from point spacings into the cloud's unit."""
    return KeypointSettings(
        settings.mode,
        settings.salient_fraction,
        settings.dist_min * s,
        settings.min_clusters,
        settings.min_size,
        settings.max_points,
    )
