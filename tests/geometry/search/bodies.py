"""Meshes that break ray searches, and a double precision search that tests every face."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import trimesh

from jaxir.geometry import Bundle, Rays


def sphere(subdivisions=3):
    m = trimesh.creation.icosphere(subdivisions=subdivisions, radius=2.0)
    return np.array(m.vertices), np.array(m.faces)


def torus():
    m = trimesh.creation.torus(2.0, 0.7, major_sections=40, minor_sections=16)
    return np.concatenate([m.vertices, m.vertices[:2]]), np.array(m.faces)


def soup(seed=0, count=700):
    """Unrelated faces, a few of them repeated, some without area."""
    rng = np.random.default_rng(seed)
    centre = rng.normal(size=(count, 1, 3))
    vertices = (centre + 0.3 * rng.normal(size=(count, 3, 3))).reshape(-1, 3)
    faces = np.arange(3 * count).reshape(-1, 3)
    faces[-20:] = faces[:20]
    faces[30:50, 2] = faces[30:50, 1]
    return vertices, faces


def slivers(count=300, width=2 * np.pi * 1e-4):
    """A fan of needles, `width` as wide as long."""
    angle = np.linspace(0, width * count, count + 1)
    rim = np.stack([2 * np.cos(angle), 2 * np.sin(angle), 0.2 * np.sin(50 * angle)], -1)
    index = np.arange(count)
    return np.concatenate([rim, [[0.0, 0.0, 0.3]]]), np.stack([index, index + 1, np.full(count, count + 1)], -1)


def fins():
    """Three sheets that share one edge: not a manifold."""
    grid = np.linspace(0, 2, 9)
    u, v = np.meshgrid(grid, grid, indexing="ij")
    i = np.arange(64).reshape(8, 8) + np.arange(8)[:, None]
    quad = np.stack([i, i + 9, i + 10, i + 1], -1).reshape(-1, 4)
    faces = np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]])
    vertices, out = [], []
    for k, angle in enumerate((0.1, 2.2, 4.0)):
        vertices.append(np.stack([u * np.cos(angle), u * np.sin(angle), v - 1], -1).reshape(-1, 3))
        out.append(faces + 81 * k)
    return np.concatenate(vertices), np.concatenate(out)


def as_large_as_soup(body):
    """A body with vertices and faces of its own repeated, so that searches of all of them are one program."""

    def build():
        vertices, faces = body()
        return np.resize(vertices, (2100, 3)), np.resize(faces, (700, 3))

    return build


BODIES = {
    "sphere": sphere,
    "torus": torus,  # as large as the sphere
    "soup": soup,
    "slivers": as_large_as_soup(slivers),
    "fins": as_large_as_soup(fins),
}


def incoherent(rng, count=500, radius=5.0):
    """Rays from a shell through the middle of the scene."""
    origin = rng.normal(size=(count, 3))
    origin *= radius / np.linalg.norm(origin, axis=1, keepdims=True)
    direction = rng.normal(size=(count, 3)) * 1.2 - origin
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return Rays(as_float(origin), as_float(direction))


def frame(towards_eye):
    w = np.asarray(towards_eye, float) / np.linalg.norm(towards_eye)
    u = np.cross([0.0, 0.0, 1.0] if abs(w[2]) < 0.9 else [0.0, 1.0, 0.0], w)
    u /= np.linalg.norm(u)
    return np.stack([u, np.cross(w, u), w])


def picture(towards_eye, distance, size=32, width=6.0, start=6.0):
    """A square image in tiles of 16 x 16 neighbours."""
    x = ((np.arange(size) + 0.5) / size - 0.5) * width
    x, y = np.meshgrid(x, x, indexing="ij")
    x, y = (a.reshape(size // 16, 16, size // 16, 16).transpose(0, 2, 1, 3).ravel() for a in (x, y))
    return Bundle(
        as_float(np.zeros(3)),
        as_float(frame(towards_eye)),
        as_float(0.0 if np.isinf(distance) else 1 / distance),
        as_float(start),
        as_float(np.stack([x, y], -1)),
    )


@jax.jit
def unrelated(bundle):
    """The rays of a bundle, in one program."""
    return bundle.rays()


def as_float(value):
    return jnp.asarray(value, jnp.result_type(float))


class Lines(NamedTuple):
    """Rays in double precision."""

    origin: np.ndarray
    direction: np.ndarray


def every_face(vertices, faces, rays, t_min=0.0, t_max=np.inf):
    """(t of the first face met [ray], distance of the ray to the nearest edge of any face [ray]) in float64."""
    vertices = np.asarray(vertices, np.float64)
    origin, direction = np.asarray(rays.origin, np.float64), np.asarray(rays.direction, np.float64)
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    solid = np.linalg.norm(np.cross(b - a, c - b), axis=1) > 1e-12
    far = np.broadcast_to(t_max, len(origin))
    each = [
        _along_rays(vertices, faces, solid, origin[some], direction[some], t_min, far[some])
        for some in np.array_split(np.arange(len(origin)), -(-len(origin) // 4))
    ]
    return tuple(map(np.concatenate, zip(*each, strict=True)))


def _along_rays(vertices, faces, solid, origin, direction, t_min, t_max):
    """`every_face` of a few rays: all is seen along each, in two coordinates across it and one along it."""
    across = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction), axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    above = np.cross(direction, across)
    above /= np.linalg.norm(above, axis=1, keepdims=True)
    along = direction / np.sum(direction**2, axis=1, keepdims=True)
    local = vertices[:, None] - origin
    seen = (np.einsum("vri,ri->vr", local, axis) for axis in (across, above, along))
    x, y, depth = (np.take(each, np.transpose(faces), axis=0) for each in seen)  # [corner, face, ray]
    dx, dy = np.roll(x, -1, axis=0) - x, np.roll(y, -1, axis=0) - y
    moment = x * np.roll(y, -1, axis=0) - y * np.roll(x, -1, axis=0)
    area = moment.sum(axis=0)
    same = (moment.min(axis=0) >= 0) | (moment.max(axis=0) <= 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (moment * np.roll(depth, 1, axis=0)).sum(axis=0) / area
    met = same & (area != 0) & solid[:, None] & (t > t_min) & (t < t_max)
    size = dx**2 + dy**2
    s = np.clip(-(x * dx + y * dy) / np.where(size > 0, size, 1), 0, 1)
    nearest = np.min((x + s * dx) ** 2 + (y + s * dy) ** 2, axis=(0, 1))
    return np.min(np.where(met, t, np.inf), axis=0), np.sqrt(nearest)
