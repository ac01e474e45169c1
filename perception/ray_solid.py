"""A port's mesh as something that rays meet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perception.geometry import Array


@dataclass(frozen=True, slots=True, eq=False)
class Met:
    """What N rays meet first."""

    distance: Array
    """(N,) metres along the ray; infinite where nothing is."""
    cosine: Array
    """(N,) of the incidence."""
    tells: NDArray[np.bool_]
    """(N,) whether what it meets decides the pose; no ray that meets nothing does."""


class RaySolid:
    """The mesh in Embree, through Open3D; built once for each model and process."""

    def __init__(self, vertices: Array, faces: NDArray[np.int64], decides: NDArray[np.bool_]) -> None:
        """
        :param vertices: (V, 3) metres, port frame.
        :param faces: (F, 3).
        :param decides: (F,) whether a face decides the pose.
        """
        import open3d as o3d  # takes a second to import

        self._tensor = o3d.core.Tensor.from_numpy
        self._scene: Any = o3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(self._tensor(vertices.astype(np.float32)), self._tensor(faces.astype(np.uint32)))
        self._decides = np.append(decides, False)  # the number of no face is beyond the last

    def cast(self, origins: Array, towards: Array, threads: int = 1) -> Met:
        """Casts rays from ``origins`` (N, 3) along unit vectors ``towards`` (N, 3), port frame."""
        rays = np.empty((len(origins), 6), dtype=np.float32)
        rays[:, :3], rays[:, 3:] = origins, towards
        answer = self._scene.cast_rays(self._tensor(rays), nthreads=threads)
        face = np.minimum(answer["primitive_ids"].numpy(), len(self._decides) - 1)
        cosine = np.abs(np.einsum("ij,ij->i", answer["primitive_normals"].numpy(), rays[:, 3:]))
        return Met(answer["t_hit"].numpy(), cosine, self._decides[face])
