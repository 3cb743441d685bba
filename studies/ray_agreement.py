"""Do jaxir and Embree meet the same faces, and who is right where they differ?

Compares rays through 20 meshes (closed, open, not manifold, with slivers, with duplicates) with raw Embree. Every ray
on which the two differ about hit or miss is settled by testing every face in double precision; its distance from the
nearest edge, as a part of that face's longest edge, says whether rounding may excuse the difference. Then rays through
shared vertices and edges of a convex body, over scales, distances and slopes down to grazing, alone and in bundles:
each must enter once and leave once. Writes two CSVs.
"""

import argparse
import itertools
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

import jaxir
from jaxir.geometry import Bundle, Rays
from jaxir.geometry.search import closest_hit, orthonormal
from studies._study import Run, study
from studies.ray_throughput import aircraft, embree, sphere

EXCUSED = 1e-6  # distance from an edge, relative to the face, within which rounding decides


def soup(count: int, size: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Unrelated faces."""
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(count, 1, 3)) + size * rng.normal(size=(count, 3, 3))
    return corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)


def needles(count: int, width: float) -> tuple[np.ndarray, np.ndarray]:
    """A fan of faces `width` as wide as long."""
    angle = np.linspace(0, width * count, count + 1)
    rim = np.stack([np.cos(angle), np.sin(angle), 0.1 * np.sin(50 * angle)], -1)
    index = np.arange(count)
    return np.concatenate([rim, [[0.0, 0.0, 0.2]]]), np.stack([index, index + 1, np.full(count, count + 1)], -1)


def sheets(count: int) -> tuple[np.ndarray, np.ndarray]:
    """`count` half planes of two faces that share one edge."""
    angle = 2 * np.pi * np.arange(count) / count
    out = np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
    vertices = np.concatenate([[[0.0, 0, -1], [0, 0, 1]], out - [0, 0, 1], out + [0, 0, 1]])
    low, high = np.arange(count) + 2, np.arange(count) + 2 + count
    zero, one = np.zeros(count, int), np.ones(count, int)
    return vertices, np.concatenate([np.stack([zero, low, high], -1), np.stack([zero, high, one], -1)])


def meshes() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """The twenty."""
    out = {f"sphere {level}": sphere(level) for level in (1, 2, 3, 4, 5)}
    out |= {f"aircraft {faces:.0f}": aircraft(faces) for faces in (1e3, 3e3, 1e4)}
    vertices, faces = sphere(4)
    out["open sphere"] = vertices, faces[::2]
    out["doubled sphere"] = vertices, np.concatenate([faces, faces])
    out["sphere inside out"] = vertices, faces[:, ::-1]
    out["flat ellipsoid"] = vertices * [1.0, 1.0, 1e-3], faces
    out["long ellipsoid"] = vertices * [1.0, 1e-2, 1e-2], faces
    out["far sphere"] = vertices + 30.0, faces
    out |= {f"soup {size}": soup(2000, size, seed) for seed, size in enumerate((0.02, 0.2, 1.0))}
    out["needles"] = needles(2000, 1e-3)
    out["fine needles"] = needles(2000, 1e-4)
    out["sheets"] = sheets(40)
    return out


def every_face(corners: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> tuple[bool, float]:
    """Whether one ray meets any face, in double precision, and its distance from the nearest edge relative to it."""
    p = corners - origin
    q = np.roll(p, -1, axis=1)
    edge = q - p
    length = np.max(np.linalg.norm(edge, axis=2), axis=1)
    moment = np.cross(p, q) @ direction
    normal = np.cross(edge[:, 0], edge[:, 1])
    slope = normal @ direction
    inside = np.all(moment >= 0, axis=1) | np.all(moment <= 0, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.einsum("fi,fi->f", normal, p[:, 0]) / slope
        met = inside & (slope != 0) & (t > 0)
    flat, along = (x - (x @ direction)[..., None] * direction for x in (p, edge))
    size = np.sum(along * along, axis=-1)
    s = np.clip(-np.sum(flat * along, axis=-1) / np.where(size > 0, size, 1), 0, 1)
    distance = np.linalg.norm(flat + s[..., None] * along, axis=-1).min(1)
    return bool(met.any()), float(np.min(distance / np.where(length > 0, length, 1)))


def through(vertices: np.ndarray, count: int, rng: np.random.Generator) -> Rays:
    """Rays from around the mesh through its box."""
    low, high = vertices.min(0), vertices.max(0)
    centre, radius = (low + high) / 2, np.linalg.norm(high - low)
    origin = rng.normal(size=(count, 3))
    origin = centre + origin * radius / np.linalg.norm(origin, axis=1, keepdims=True)
    direction = rng.uniform(low, high, (count, 3)) - origin
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return Rays(jnp.asarray(origin, jnp.float32), jnp.asarray(direction, jnp.float32))


def compare(name: str, vertices: np.ndarray, faces: np.ndarray, count: int) -> dict[str, Any] | None:
    """One row: how many rays differ, who is right in double precision, and how many no rounding excuses."""
    mesh = jaxir.Mesh(vertices, faces)
    corners = np.asarray(mesh.vertices)[faces]
    run = embree(corners)
    if run is None:
        return None
    rays = through(vertices, count, np.random.default_rng(len(faces)))
    origin, direction = np.asarray(rays.origin), np.asarray(rays.direction)
    mine = np.asarray(closest_hit(mesh, rays).face)
    theirs = np.asarray(run(origin, direction, "INTERSECT"))
    differ = np.flatnonzero((mine >= 0) != (theirs >= 0))
    right = {"jaxir": 0, "Embree": 0}
    unexcused = 0
    for ray in differ:
        met, margin = every_face(corners.astype(np.float64), *(x[ray].astype(np.float64) for x in (origin, direction)))
        right["jaxir"] += met == (mine[ray] >= 0)
        right["Embree"] += met == (theirs[ray] >= 0)
        unexcused += margin > EXCUSED
    other = int(np.sum((mine >= 0) & (theirs >= 0) & (mine != theirs)))
    return {
        "mesh": name,
        "faces": len(faces),
        "rays": count,
        "hits": int(np.sum(mine >= 0)),
        "other face": other,
        "hit or miss differs": len(differ),
        "jaxir right": right["jaxir"],
        "Embree right": right["Embree"],
        "not within 1e-6 of an edge": unexcused,
    }


class Seams(NamedTuple):
    """Points on the edges and at the vertices of a body; normals and least height of the faces around each."""

    point: np.ndarray
    normals: np.ndarray
    height: np.ndarray

    def clear(self, towards: np.ndarray, size: float) -> np.ndarray:
        """Whether all faces around look at the eye, so that rounding cannot move a ray past their outline.

        Rounding moves a ray by some eps times `size`; where it meets a face that is 1 / slope times more.
        """
        slope = np.min(np.einsum("sfi,si->sf", self.normals, towards), axis=1)
        return slope * self.height > 20 * float(np.finfo(np.float32).eps) * size


def seams(vertices: np.ndarray, faces: np.ndarray, count: int, rng: np.random.Generator) -> Seams:
    """`count` random seams, a fifth of them vertices, with the faces around both ends of each edge."""
    corners = vertices[faces]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    doubled = np.linalg.norm(area, axis=1, keepdims=True)
    height = doubled[:, 0] / np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    around: list[list[int]] = [[] for _ in vertices]
    for face, triple in enumerate(faces):
        for vertex in triple:
            around[vertex].append(face)
    ring = np.array([(of_vertex * 6)[:6] for of_vertex in around])
    pick, corner = rng.integers(len(faces), size=count), rng.integers(3, size=count)
    start, stop = faces[pick, corner], faces[pick, (corner + 1) % 3]
    weight = rng.random((count, 1)) * (rng.random((count, 1)) < 0.8)
    there = np.concatenate([ring[start], ring[stop]], axis=1)
    point = vertices[start] * (1 - weight) + vertices[stop] * weight
    return Seams(point, (area / doubled)[there], height[there].min(axis=1))


def crossings(mesh: Any, rays: Rays | Bundle, sure: np.ndarray) -> dict[str, int]:
    """How often rays enter and leave a convex body; those that are `sure` must do both, and none may do so again."""
    enter = closest_hit(mesh, rays)
    direction = rays.rays().direction if isinstance(rays, Bundle) else rays.direction
    leave = closest_hit(mesh, Rays(enter.point, direction), leaving=enter.face)
    again = closest_hit(mesh, Rays(leave.point, direction), leaving=leave.face)
    first, second, third = (np.asarray(hit.face) >= 0 for hit in (enter, leave, again))
    return {
        "rays": int(np.sum(sure)),
        "lost": int(np.sum(sure & ~first)),
        "not left": int(np.sum(sure & first & ~second)),
        "counted twice": int(np.sum(first & second & third)),
    }


def seam_rows(count: int) -> list[dict[str, Any]]:
    """One row for each body, scale, distance and route."""
    rng = np.random.default_rng(0)
    vertices, faces = sphere(4)
    bodies = {"sphere": vertices, "disc": vertices * [1.0, 1.0, 0.01]}
    cases = list(itertools.product(bodies, (1e-3, 1.0, 1e3, 1e6), (1.0, 30.0, 12_000.0)))
    part = -(-count // (2 * len(cases)))
    rows = []
    for name, scale, distance in tqdm(cases, desc="seams"):
        body = np.asarray(bodies[name] * scale, np.float32)
        mesh = jaxir.Mesh(body, faces)
        at = seams(body.astype(np.float64), faces, part, rng)
        label = {"body": name, "scale": scale, "range": distance}

        # single rays towards each seam, from slopes down to grazing; they start near the body, as a camera's do,
        # because float32 holds no seam of a body that is 12 km away
        normal = at.normals[:, 0]
        side = np.cross(normal, rng.normal(size=normal.shape))
        side /= np.linalg.norm(side, axis=1, keepdims=True)
        cosine = np.exp(rng.uniform(np.log(1e-4), 0, (part, 1)))
        towards = cosine * normal + np.sqrt(1 - cosine**2) * side
        start = at.point + min(distance, 2.5 * scale) * towards
        rays = Rays(jnp.asarray(start, jnp.float32), jnp.asarray(-towards, jnp.float32))
        rows.append(label | {"route": "single"} | crossings(mesh, rays, at.clear(towards, 2.5 * scale)))

        # one bundle, from a direction in which half of the seams are seen
        axes = np.asarray(orthonormal(jnp.asarray(towards[0], jnp.float32)), np.float64)
        inverse = 1 / max(distance, 2.5 * scale)
        seen = at.point @ axes.T
        screen = seen[:, :2] / (1 - seen[:, 2:] * inverse)
        view = axes[2] - at.point * inverse
        view /= np.linalg.norm(view, axis=1, keepdims=True)
        cell = scale * 32 / np.sqrt(part)
        order = np.lexsort((np.floor(screen[:, 0] / cell), np.floor(screen[:, 1] / cell)))
        fields = (np.zeros(3), axes, inverse, 1.1 * scale, screen[order])
        bundle = Bundle(*(jnp.asarray(x, jnp.float32) for x in fields))
        rows.append(label | {"route": "bundle"} | crossings(mesh, bundle, at.clear(view, 2.5 * scale)[order]))
    return rows


def totals(rows: list[dict[str, Any]]) -> str:
    """The sums of the columns of whole numbers."""
    sums = {key: sum(row[key] for row in rows) for key, value in rows[0].items() if type(value) is int}
    return ", ".join(f"{key} {value}" for key, value in sums.items())


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--rays", type=int, default=1_000_000, help="through each mesh (%(default)s)")
    parser.add_argument(
        "--seams", type=int, default=24_000_000, help="at edges and vertices; half are clear (%(default)s)"
    )


def main(run: Run) -> str:
    chosen = run.options
    rows = [row for name, mesh in meshes().items() if (row := compare(name, *mesh, chosen.rays)) is not None]
    said = []
    if rows:
        run.table(rows, digits=None)
        said.append(f"{len(rows)} meshes: {totals(rows)}")
    rows = seam_rows(chosen.seams)
    run.table(rows, "ray_seams", digits=None)
    return "; ".join([*said, f"seams: {totals(rows)}"])


if __name__ == "__main__":
    study(main, options, needs=())
