"""Measures of meshes."""

from __future__ import annotations

import numpy as np

from trocar.view.mesh import Mesh


def volume_m3(mesh: Mesh) -> float:
    """Positive if the faces are turned outwards."""
    a, b, c = (mesh.vertices_m[mesh.faces[:, i]].astype(float) for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6


def edges_cancel(mesh: Mesh) -> bool:
    """Whether each edge is passed once in each direction: closed, with faces turned alike."""
    _, same = np.unique(np.round(mesh.vertices_m, 7), axis=0, return_inverse=True)
    faces = same.ravel()[mesh.faces]
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    forth = {tuple(pair) for pair in pairs.tolist()}
    return len(forth) == len(pairs) and all((b, a) in forth for a, b in forth)
