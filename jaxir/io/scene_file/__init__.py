"""Scenes from TOML."""

from jaxir.io.scene_file._entries import Entry as Entry
from jaxir.io.scene_file._entries import read_toml as read_toml
from jaxir.io.scene_file._scene_files import SceneFile as SceneFile
from jaxir.io.scene_file._scene_files import load_scene as load_scene
from jaxir.io.scene_file._states import States as States
from jaxir.io.scene_file._vocabulary import combustion_gas as combustion_gas
