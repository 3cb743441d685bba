"""Faces of a mesh by where they lie, where they look, what they hang together with and what a file calls them."""

from jaxir.geometry.selection._connected import Connected as Connected
from jaxir.geometry.selection._named import OfMaterial as OfMaterial
from jaxir.geometry.selection._named import OfPart as OfPart
from jaxir.geometry.selection._place import AbovePlane as AbovePlane
from jaxir.geometry.selection._place import Facing as Facing
from jaxir.geometry.selection._place import InBox as InBox
from jaxir.geometry.selection._place import InCylinder as InCylinder
from jaxir.geometry.selection._selection import AbstractSelection as AbstractSelection
from jaxir.geometry.selection._selection import Complement as Complement
from jaxir.geometry.selection._selection import Intersection as Intersection
from jaxir.geometry.selection._selection import LabelledFaces as LabelledFaces
from jaxir.geometry.selection._selection import Union as Union
from jaxir.geometry.selection._selection import new_part as new_part
from jaxir.geometry.selection._selection import selected_faces as selected_faces
