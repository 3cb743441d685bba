"""Paths: the record between trace and evaluate."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxir.geometry import Rays
from jaxir.transport._method import Method


class LightSamples(eqx.Module):
    """Directions in which one light is looked for, first those drawn from the light, then those of the brdf or phase.

    Light found is sum over samples of f(omega) weight * radiance, with f the brdf times the cosine, or the phase
    function.

    Attributes:
        omega: unit vectors [sample, ray, 3].
        distance: to the light, or where that is the plume to where the direction meets skin [sample, ray] [m].
        weight: weight (9) / (number of samples * density) [sample, ray] [sr]; 0 where the light is not seen.
        face: where the light is the skin, the face seen [sample, ray], -1 for none; None for other lights.
    """

    omega: Float[Array, "*segment sample ray 3"]
    distance: Float[Array, "*segment sample ray"]
    weight: Float[Array, "*segment sample ray"]
    face: Int[Array, "*segment sample ray"] | None


class Vertex(eqx.Module):
    """Where paths touch the skin.

    Attributes:
        face: which face, -1 where a path does not touch [ray].
        point: [ray, 3] [m].
        normal: unit normal on the side of `omega_o` [ray, 3]; `omega_o` itself on a miss.
        omega_o: unit vector back along the path [ray, 3].
        visible: whether the point faces and sees each source without extent [source, ray].
        counts_emission: whether its own emission still counts, and was not looked for from where the path came [ray];
            None where it always counts.
        lights: the lights sampled there; () where none is.
    """

    face: Int[Array, "*segment ray"]
    point: Float[Array, "*segment ray 3"]
    normal: Float[Array, "*segment ray 3"]
    omega_o: Float[Array, "*segment ray 3"]
    visible: Bool[Array, "*segment source ray"]
    counts_emission: Bool[Array, "*segment ray"] | None
    lights: tuple[LightSamples, ...] = ()


class Scattering(eqx.Module):
    """Where particles scatter paths.

    Attributes:
        t: distance from the segment's begin [ray] [m].
        inverse_pdf: 1 / density of that distance [ray] [m]; 0 where the path is not scattered.
        before: how often the path was scattered before the segment [ray].
        omega: unit vectors to the sources without extent that are not summed along segments [source, ray, 3].
        distance: to them [source, ray] [m].
        visible: whether the point sees them [source, ray].
        lights: the lights sampled there.
    """

    t: Float[Array, "*segment ray"]
    inverse_pdf: Float[Array, "*segment ray"]
    before: Int[Array, "*segment ray"]
    omega: Float[Array, "*segment source ray 3"]
    distance: Float[Array, "*segment source ray"]
    visible: Bool[Array, "*segment source ray"]
    lights: tuple[LightSamples, ...]


class Segment(eqx.Module):
    """A straight part of the paths of a batch; the first are the rays.

    Attributes:
        rays: where it begins, and its direction.
        length: to the skin [ray] [m]; inf where it leaves the scene, 0 for a path that has ended.
        vertex: where it ends on the skin; None without skin.
        scattering: where particles scatter it; None without particles.
        sees_surroundings: whether a segment that leaves the scene shows what surrounds it [ray]: from skin that looked
            for that it does not; None where there is one segment.
        sees_plume: whether the plume's emission on it counts [ray]: from skin that looked for it, it does not; None
            where it always counts.
        omega: direction of the next segment [ray, 3]; None where no path goes on.
        inverse_pdf: 1 / density of that direction [ray] [sr], times 1 / chance of reflection rather than scattering
            where the skin reflects the path; 0 where the path ends.
    """

    rays: Rays
    length: Float[Array, "*segment ray"]
    vertex: Vertex | None
    scattering: Scattering | None
    sees_surroundings: Bool[Array, "*segment ray"] | None
    sees_plume: Bool[Array, "*segment ray"] | None
    omega: Float[Array, "*segment ray 3"] | None
    inverse_pdf: Float[Array, "*segment ray"] | None


class Paths(eqx.Module):
    """What a batch of rays met, and how: the record between trace and evaluate.

    Attributes:
        segments: stacked over the segments of the paths [segment, ...].
        method: how they were traced, without what the scene has no use for.
        route: what the plume stored of the first segments, see `store_route`; None where it is walked.
    """

    segments: Segment
    method: Method
    route: Any = None

    @property
    def first(self) -> Segment:
        """The segments that end at the eye."""
        return jax.tree.map(lambda leaf: leaf[0], self.segments)

    @property
    def rays(self) -> Rays:
        """The rays traced."""
        return self.first.rays

    @property
    def length(self) -> Float[Array, " ray"]:
        """Distance of the rays to the skin [ray] [m]; inf for those that leave the scene."""
        return self.segments.length[0]

    @property
    def face(self) -> Int[Array, " ray"]:
        """The face that each ray meets, -1 for none [ray]."""
        vertex = self.segments.vertex
        return jnp.full(self.length.shape, -1, jnp.int32) if vertex is None else vertex.face[0]
