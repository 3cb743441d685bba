"""Fields over grids and faces from files."""

from jaxir.io._axes import Axes as Axes
from jaxir.io.field._cfd import load_flow as load_flow
from jaxir.io.field._face_values import load_array as load_array
from jaxir.io.field._face_values import load_face_values as load_face_values
from jaxir.io.field._surfaces import load_surface_field as load_surface_field
