"""Small scenes and closed forms that several tests use."""

import numpy as np

import jaxir


def plate(emissivity=0.5, temperature=400.0, x=0.0):
    """A unit square of two triangles in the plane `x`, facing +x."""
    vertices = np.array([[x, -0.5, -0.5], [x, 0.5, -0.5], [x, 0.5, 0.5], [x, -0.5, 0.5]])
    mesh = jaxir.Mesh(vertices, np.array([[0, 1, 2], [0, 2, 3]]))
    return jaxir.Skin(mesh, temperature, jaxir.Lambert(emissivity))


def corner_mesh():
    """Three squares, open to (1, 1, 1)."""
    vertices = [[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [1, 0, 1], [0, 1, 1]]
    return jaxir.Mesh(vertices, [[0, 1, 4], [0, 4, 2], [0, 2, 6], [0, 6, 3], [0, 3, 5], [0, 5, 1]])


def warm_corner(emissivity):
    """Skin of three squares that see one another, one of them warmer."""
    return jaxir.Skin(corner_mesh(), np.array([500.0, 500, 300, 300, 300, 300]), jaxir.Lambert(emissivity))


def box_mesh(size=(1.0, 1.0, 1.0), centre=(0.0, 0.0, 0.0)):
    """A closed box of twelve triangles, outward."""
    unit = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)]) - 0.5
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return jaxir.Mesh(unit * np.array(size) + np.array(centre), np.array(faces))


def gray_box(size, coefficient, cells=(4, 3, 5), temperature=600.0):
    """A homogeneous gray box about the origin; its blackbody radiance is not 1, see the caller."""
    size = np.asarray(size, float)
    grid = jaxir.Grid(-size / 2, size / np.array(cells), cells)
    return jaxir.GridPlume(grid, temperature, jaxir.GrayGas(coefficient))


def hot_layers(air=None, hot=1100.0):
    """A hot and a cool layer of gas with lines before a warm plate."""
    grid = jaxir.Grid((0.0, -0.5, -0.5), (0.4, 1.0, 1.0), (2, 1, 1))
    gas = jaxir.NarrowBandGas(pressure=5e4, h2o=0.1, co2=0.1)
    plume = jaxir.GridPlume(grid, np.array([hot, 500.0]).reshape(2, 1, 1), gas)
    return jaxir.Scene(plate(), plume, atmosphere=air)


def box_intensity(width, depth, height, kappa, source, degrees):
    """Radiant intensity of a gray box seen tilted about its height axis (closed form; W/sr)."""
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    reach = min(width / s if s > 0 else np.inf, depth / c if c > 0 else np.inf)
    m = min(width * c, depth * s)
    full = -np.expm1(-kappa * reach)
    return source * height * (abs(width * c - depth * s) * full + 2 * m * (1 - full / (kappa * reach)))
