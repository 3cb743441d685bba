"""The faces that a camera sees."""

import numpy as np

import jaxir
from tests.scenes import box_mesh


def test_faces_seen_by_a_camera():
    camera = jaxir.orthographic_camera(0.0, 0.0, 0.25, (6, 8))
    face = np.asarray(jaxir.visible_faces(box_mesh(), camera))
    front = np.asarray(box_mesh().area_vectors())[:, 0] > 0.4  # the two triangles that look along +x
    assert front[face[1:5, 2:6]].all()
    seen = face >= 0
    assert seen[1:5, 2:6].all() and seen.sum() == 16
