"""A small scene file, as text, and its folder."""

import numpy as np

TEXT = """
bands = ["MWIR", "LWIR"]

[skin]
temperature = 300.0
brdf = { type = "Lambert", emissivity = 0.8 }

[skin.mesh]
type = "Mesh"
vertices = [[0, -0.5, -0.5], [0, 0.5, -0.5], [0, 0.5, 0.5], [0, -0.5, 0.5]]
faces = [[0, 1, 2], [0, 2, 3]]

[[sources]]
type = "ParallelSource"
direction = [-1, 0, 0]
irradiance = [2.0, 0.1]

[background]
type = "BlackbodyBackground"
temperature = 250

[atmosphere]
type = "FixedPath"
transmittance = 0.5
path_radiance = 0.1

[camera]
type = "orthographic_camera"
azimuth = 0
elevation = 0
pixel = 0.125
shape = [16, 16]

[render]
samples = 2

[signature]
views = { azimuth = { start = -180, stop = 180, step = 90 }, elevation = [-30, 30] }
shape = [16, 16]
"""


def write_scene(folder, text=TEXT, name="scene.toml"):
    """The file."""
    path = folder / name
    path.write_text(text)
    return path


def write_obj(path, parts):
    """An OBJ file of unit squares facing +x, one behind the other, named."""
    lines = []
    for index, name in enumerate(parts):
        lines += [f"v {-index} {y} {z}" for y, z in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))]
        lines += [f"o {name}", "f -4 -3 -2", "f -4 -2 -1"]
    path.write_text("\n".join(lines) + "\n")
    return path


def write_npz(path, **arrays):
    """Arrays in a file."""
    np.savez(path, **arrays)
    return path
