"""Bidirectional reflectance of opaque skin: what `Skin` holds and transport evaluates.

A brdf is a pytree of parameters with leaves [face | 1, node | 1]; `at(face)` is the brdf of one hit, with leaves
[node | 1], and every method below speaks of one hit. Directions `omega_i`, `omega_o` leave the surface. Skin is opaque
and met from both sides, so only the line of `normal` matters: reflection happens on the side of `omega_o`, and the
value is 0 for an `omega_i` on the other side. The emissivity is 1 - reflectance (Kirchhoff), never an input beside it.
"""

from __future__ import annotations

import abc
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Shaped

from jaxir._arrays import Check, on_host
from jaxir._fields import Physical, Range, per_face, quantity
from jaxir._math import dot, frame_around, matmul

B = TypeVar("B", bound="AbstractBrdf")


class AbstractBrdf(Physical):
    """A bidirectional reflectance distribution function [sr-1] with its sampler and its hemispherical integral."""

    @abc.abstractmethod
    def eval(
        self, omega_i: Float[Array, " 3"], omega_o: Float[Array, " 3"], normal: Float[Array, " 3"]
    ) -> Float[Array, " node"]:
        """The brdf [node | 1] [sr-1], cosine not included. Differentiable in parameters and directions."""

    @abc.abstractmethod
    def sample(
        self, u: Float[Array, " 2"], omega_o: Float[Array, " 3"], normal: Float[Array, " 3"]
    ) -> Float[Array, " 3"]:
        """A direction omega_i [3] from two uniform numbers in [0, 1), one for all nodes. Not to be differentiated."""

    @abc.abstractmethod
    def pdf(
        self, omega_i: Float[Array, " 3"], omega_o: Float[Array, " 3"], normal: Float[Array, " 3"]
    ) -> Float[Array, ""]:
        """Density [sr-1] with which `sample` returns `omega_i`. Not to be differentiated."""

    @property
    @abc.abstractmethod
    def diffuse(self) -> bool:
        """Whether the brdf is the same for all directions, whatever its parameters."""

    @abc.abstractmethod
    def directional_reflectance(self, cos_o: Float[Array, ""]) -> Float[Array, " node"]:
        """Directional-hemispherical reflectance [node | 1], int brdf cos_i d omega_i, for cos_o = |omega_o . normal|.

        Differentiable in parameters and cos_o.
        """

    @abc.abstractmethod
    def directional_emissivity(self, cos_o: Float[Array, ""]) -> Float[Array, " node"]:
        """Emissivity [node | 1] toward cos_o: 1 - directional reflectance. Differentiable in parameters and cos_o."""

    def at(self: B, face: Int[Array, "*batch"]) -> B:
        """The brdf of one face (or of a batch of faces): every leaf [face | 1, ...] loses its face axis."""
        return jax.tree.map(lambda leaf: at_face(leaf, face), self)

    def gray(self: B) -> B:
        """The same with parameters in their mean over the nodes [face | 1, ..., 1]."""
        return jax.tree.map(lambda leaf: leaf.mean(axis=-1, keepdims=True) if leaf.ndim > 1 else leaf, self)

    def shape(self) -> tuple[int, int]:
        """(faces, nodes) that the parameters span; 1 where they are common to all faces or all nodes."""
        spans = [leaf.shape if leaf.ndim > 1 else (leaf.shape[0], 1) for leaf in jax.tree.leaves(self)]
        return np.broadcast_shapes(*((span[0], span[-1]) for span in spans))


def at_face(leaf: Shaped[Array, "face *more"], face: Int[Array, "*batch"]) -> Array:
    """A leaf of a brdf at faces [*batch, *more]; its first axis is 1 where it is the same for all."""
    return leaf[face if leaf.shape[0] > 1 else jnp.zeros_like(face)]


def parameter(within: Range) -> Any:
    """A field of a brdf, without unit: a number, [face] or [face, node] becomes a leaf [face | 1, node | 1]."""
    return quantity("1", ("face", "node"), within, per_face, least=1)


NARROWEST = 1e-4  # lobe


def width_of_lobe(field: str, value: Array) -> Check:
    """`value` lies in [1e-4, 1]: narrower lobes have derivatives beyond float32, and no sampler meets them."""
    _, x = on_host(value)
    return Check(field, x, (x >= NARROWEST) & (x <= 1), "values in [1e-4, 1]")


def facing(omega: Float[Array, " 3"], normal: Float[Array, " 3"]) -> Float[Array, " 3"]:
    """The normal on the side of `omega`."""
    return jnp.where(dot(omega, normal) < 0, -normal, normal)


def cosine_direction(u: Float[Array, " 2"], normal: Float[Array, " 3"]) -> Float[Array, " 3"]:
    """A direction about `normal` with density cos / pi [sr-1] (Malley: a uniform point of the disc, lifted)."""
    radius = jnp.sqrt(u[0])
    angle = 2 * jnp.pi * u[1]
    local = jnp.stack([radius * jnp.cos(angle), radius * jnp.sin(angle), jnp.sqrt(1 - u[0])])
    return matmul(local, frame_around(normal))


def cosine_density(omega: Float[Array, " 3"], normal: Float[Array, " 3"]) -> Float[Array, ""]:
    """Density [sr-1] of `cosine_direction`: cos / pi, 0 below the horizon."""
    return jnp.maximum(dot(omega, normal), 0) / jnp.pi
