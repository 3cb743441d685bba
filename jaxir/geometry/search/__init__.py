"""Meshes and the search of rays in them."""

from jaxir.geometry.search._mesh import HANDFUL as HANDFUL
from jaxir.geometry.search._mesh import Mesh as Mesh
from jaxir.geometry.search._mesh import any_hit as any_hit
from jaxir.geometry.search._mesh import closest_hit as closest_hit
from jaxir.geometry.search._mesh import face_met as face_met
from jaxir.geometry.search._mesh import face_normal as face_normal
from jaxir.geometry.search._mesh import hit_on as hit_on
from jaxir.geometry.search._outline import MARGIN as MARGIN
from jaxir.geometry.search._outline import clear_of as clear_of
from jaxir.geometry.search._outline import front_of as front_of
from jaxir.geometry.search._outline import may_see as may_see
from jaxir.geometry.search._outline import outline as outline
from jaxir.geometry.search._shadow import occluded as occluded
from jaxir.geometry.search._shadow import occluded_from as occluded_from
from jaxir.geometry.search._shadow import orthonormal as orthonormal
from jaxir.geometry.search._topology import is_closed as is_closed
from jaxir.geometry.search._topology import is_convex as is_convex
from jaxir.geometry.search._tree import WIDTH as WIDTH
from jaxir.geometry.search._tree import build as build
from jaxir.geometry.search._visible import visible_faces as visible_faces
