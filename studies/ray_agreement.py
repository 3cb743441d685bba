"""Do jaxir and Embree meet the same faces, and who is right where they differ?

Compares rays through 20 meshes (closed, open, not manifold, with slivers, with duplicates) with raw Embree. Every ray
on which the two differ about hit or miss is settled by testing every face in double precision; its distance from the
nearest edge, as a part of that face's longest edge, says whether rounding may excuse the difference. Then rays through
shared vertices and edges of a closed body, over scales and distances, are counted: each must meet it. Writes a CSV.
"""

import argparse
import csv
import sys
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

import jaxir
from jaxir.geometry.mesh import any_hit, closest_hit
from jaxir.geometry.ray import Rays
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


def leaks(count: int) -> tuple[int, int]:
    """Rays through shared vertices and edges of spheres that met nothing, and how many there were."""
    rng = np.random.default_rng(0)
    lost = total = 0
    scales, ranges = (1e-3, 1.0, 1e3, 1e6), (1.0, 30.0, 12_000.0)
    part = -(-count // (len(scales) * len(ranges)))
    vertices, faces = sphere(4)
    for scale in scales:
        body = np.asarray(vertices * scale, np.float32)
        mesh = jaxir.Mesh(body, faces)
        exact = body.astype(np.float64)
        for distance in ranges:
            pick = rng.integers(len(faces), size=part)
            weight = rng.random((part, 1)) * (rng.random((part, 1)) < 0.8)  # a fifth at vertices
            target = exact[faces[pick, 0]] * (1 - weight) + exact[faces[pick, 1]] * weight
            # from outside, over all slopes down to grazing, as far as the outline does not decide
            normal = target / np.linalg.norm(target, axis=1, keepdims=True)
            side = rng.normal(size=target.shape)
            side -= np.sum(side * normal, axis=1, keepdims=True) * normal
            side /= np.linalg.norm(side, axis=1, keepdims=True)
            cosine = np.exp(rng.uniform(np.log(0.12), 0, (part, 1)))
            towards = cosine * normal + np.sqrt(1 - cosine**2) * side
            # as a camera sees it: float32 holds a point near the target, whatever the distance
            origin = target + min(distance, 30.0) * scale * towards
            rays = Rays(jnp.asarray(origin, jnp.float32), jnp.asarray(-towards, jnp.float32))
            lost += int(np.sum(~np.asarray(any_hit(mesh, rays))))
            total += part
    return lost, total


def main(argv: list[str]) -> None:
    parser = argparse.ArgumentParser(prog="python -m studies.ray_agreement", description=__doc__.split("\n")[0])
    parser.add_argument("--rays", type=int, default=1_000_000, help="through each mesh (%(default)s)")
    parser.add_argument("--seams", type=int, default=10_000_000, help="rays at edges and vertices (%(default)s)")
    parser.add_argument("--out", type=Path, default=Path("studies/out/ray_agreement"), help="folder (%(default)s)")
    chosen = parser.parse_args(argv)
    chosen.out.mkdir(parents=True, exist_ok=True)
    rows = [row for name, mesh in meshes().items() if (row := compare(name, *mesh, chosen.rays)) is not None]
    if rows:
        with open(chosen.out / "agreement.csv", "w", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)
        total = {key: sum(row[key] for row in rows) for key in list(rows[0])[2:]}
        print(f"{len(rows)} meshes: " + ", ".join(f"{key} {value}" for key, value in total.items()))
    lost, count = leaks(chosen.seams)
    print(f"{lost} of {count} rays at vertices and edges met nothing")


if __name__ == "__main__":
    main(sys.argv[1:])
