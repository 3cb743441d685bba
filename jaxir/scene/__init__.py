"""Scenes: data that joins optics and geometry, and the same on the spectral nodes."""

from jaxir.scene._optimal_nodes import nodes_within as nodes_within
from jaxir.scene._optimal_nodes import optimal_nodes as optimal_nodes
from jaxir.scene._resolution import nodes_error as nodes_error
from jaxir.scene._resolution import scene_nodes as scene_nodes
from jaxir.scene._scene import Lit as Lit
from jaxir.scene._scene import Scene as Scene
from jaxir.scene._scene import on_nodes as on_nodes
from jaxir.scene._skin import Skin as Skin
