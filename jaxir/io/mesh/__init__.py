"""Meshes from files."""

from jaxir.io._axes import METRES as METRES
from jaxir.io._axes import Axes as Axes
from jaxir.io.mesh._meshes import Body as Body
from jaxir.io.mesh._meshes import load_mesh as load_mesh
from jaxir.io.mesh._meshes import split_bodies as split_bodies
from jaxir.io.mesh._meshes import zero_area_faces as zero_area_faces
