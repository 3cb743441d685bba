"""Roughly what shines where in a scene: where rays are worth most, before any is traced, and what no ray will see.

Skin counts with its own emission and what it would reflect of unhidden lights without extent, or with little as the
sun's disc has, to all sides alike unless it is glossy, a plume with its emission, dimmed by itself as a layer as deep
as the plume is wide. Nothing hides anything. Estimates may be as rough as this where they place rays; what lies beyond
a frame tells the order of an error.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from jaxir._arrays import as_float, is_traced, placed
from jaxir._math import dot, einsum, matmul, middles, safe_divide
from jaxir._programs import program
from jaxir.geometry import Brightness, Camera, Eye, Rays, camera_around, graded, rolled_camera, view_frame
from jaxir.geometry.search import any_hit, face_normal
from jaxir.optics.surface import AbstractBrdf
from jaxir.scene import Lit
from jaxir.scene.light import AbstractExtendedLight

PROJECTED = 2**16  # points of faces, but at least four of each
SKY = 3  # directions squared in which lights with an extent are looked for
LITTLE = 1e-2  # solid angle up to which a light with an extent may glint as one without does [sr]
NARROW = 2  # points squared of lights that are narrow
VIEWS = 64  # whose cameras are made by one program, however many of them are wanted


class _Gloss(NamedTuple):
    """Light of sources with no extent, or little, on skin that reflects more of it to some sides than to others.

    Attributes:
        brdf: of each face, in its mean over the nodes.
        normal: of each [face, 3].
        omega: directions to each source [source, face, 3].
        reflected: what is reflected of it, were it to come straight down [source, face, band] [W m-2].
    """

    brdf: AbstractBrdf
    normal: Float[Array, "face 3"]
    omega: Float[Array, "source face 3"]
    reflected: Float[Array, "source face band"]

    def toward(self, back: Float[Array, "face 3"]) -> Float[Array, "face band"]:
        """Radiance that each face reflects in a direction, by the density with which it would send rays to the source.

        That is brdf * cos / reflectance, about, for a third of the work.
        """

        def add(total: Array, own: tuple[Array, Array]) -> tuple[Array, None]:
            omega, reflected = own
            density = jax.vmap(lambda brdf, *directions: brdf.pdf(*directions))(self.brdf, omega, back, self.normal)
            return total + density[:, None] * reflected, None

        return lax.scan(add, jnp.zeros_like(self.reflected[0]), (self.omega, self.reflected))[0]


class _Shining(NamedTuple):
    """What shines: faces with their radiance [face, band], capsules with their intensity [capsule, band].

    Without what `gloss` reflects, which depends on where that is seen from.
    """

    corners: Float[Array, "face 3 3"]
    radiance: Float[Array, "face band"]
    gloss: _Gloss | None
    ends: Float[Array, "capsule 2 3"]
    radius: Float[Array, " capsule"]
    intensity: Float[Array, "capsule band"]


def _shining(lit: Lit, behind: Float[Array, " node"] | None = None) -> _Shining:
    """Without derivatives; skin in contrast to what is `behind` it, if that is given."""
    lit = lax.stop_gradient(lit)
    dtype, bands = lit.nodes.weight.dtype, lit.nodes.response.shape[0]
    corners, radiance = jnp.zeros((0, 3, 3), dtype), jnp.zeros((0, bands), dtype)
    ends, radius, intensity = jnp.zeros((0, 2, 3), dtype), jnp.zeros(0, dtype), jnp.zeros((0, bands), dtype)
    gloss, skin = None, lit.scene.skin
    if skin is not None:
        corners, every = skin.mesh.corners(), jnp.arange(skin.mesh.count, dtype=jnp.int32)
        normal = face_normal(skin.mesh, every)
        emissivity, place = _emissivity(lit), (corners.mean(axis=1), normal)
        beams = [*_beams(lit, *place), *_narrow_beams(lit, *place)]
        if beams and not skin.brdf.diffuse:
            omega, cosine, light = (jnp.stack(part) for part in zip(*beams, strict=True))
            reflected = lit.nodes.in_band(jnp.where(cosine > 0, (1 - emissivity)[None] * light, 0))
            gloss = _Gloss(skin.brdf.gray().at(every), normal, omega, reflected)
            beams = []
        dark = jnp.zeros((len(corners), lit.nodes.count), dtype)
        radiance = lit.nodes.in_band(_of_skin(lit, emissivity, _irradiance(beams, dark), behind))
    if lit.medium is not None:
        ends, radius, emitted = lit.medium.capsules()
        intensity = lit.nodes.in_band(emitted)
    return _Shining(corners, radiance, gloss, ends, radius, intensity)


def _bright(shining: _Shining, eye: Eye | None) -> Brightness:
    """Where a scene is bright, each band's intensity normalised and the bands averaged; to an eye if skin is glossy."""
    corners, radiance, ends, radius, intensity = _seen(shining, eye)
    area = jnp.linalg.norm(jnp.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    total = jnp.sum(radiance * area[:, None], axis=0) / 8 + jnp.sum(intensity, axis=0)  # faces are seen by a quarter
    share = 1 / jnp.where(total > 0, total, 1) / radiance.shape[1]
    return Brightness(corners, matmul(radiance, share), ends, radius, matmul(intensity, share))


def _seen(shining: _Shining, eye: Eye | None) -> tuple[Array, ...]:
    """Corners and radiances of faces, ends, radii and intensities of capsules as an eye sees them."""
    corners, radiance, gloss, *capsules = shining
    if gloss is not None:
        assert eye is not None
        radiance = radiance + gloss.toward(eye.toward(corners.mean(axis=1)))
    return corners, radiance, *capsules


@program
def beyond_frame(lit: Lit, camera: Camera) -> Float[Array, " band"]:
    """About the intensity of what a camera's frame leaves out of a scene [band] [W sr-1]; without derivatives.

    In contrast to what is behind the scene, whatever its sign. Of every face, its backs too where it is open, the
    centres of four pieces or, of few faces, of more are projected, of every capsule of a plume its middle and points
    towards the ends. Lights with an extent count with what `SKY`^2 directions tell of them. Nothing hides anything.
    """
    lit, camera = lax.stop_gradient((lit, camera))
    left_out = jnp.zeros(lit.nodes.response.shape[0], lit.nodes.weight.dtype)
    if lit.medium is not None:
        ends, _, emitted = lit.medium.capsules()
        left_out = matmul(_capsules_beyond(ends, camera), lit.nodes.in_band(lit.dimmed_by_air(emitted)))
    if lit.scene.skin is None:
        return left_out
    mesh = lit.scene.skin.mesh
    corners = mesh.corners()
    centre, vector = corners.mean(axis=1), mesh.area_vectors()
    facing = dot(vector, camera.eye.away(centre))
    shown = (jnp.maximum(facing, 0) if mesh.closed else jnp.abs(facing)) / camera.lessening(centre)
    outwards = face_normal(mesh, jnp.arange(mesh.count, dtype=jnp.int32))
    normal = outwards * jnp.where(facing < 0, -1, 1)[:, None]
    irradiance = _irradiance(_beams(lit, centre, normal), _from_all_around(lit, centre, normal))
    contrast = _of_skin(lit, _emissivity(lit), irradiance, None) - lit.background(-camera.frame[2])[None]
    each = jnp.abs(lit.nodes.in_band(lit.dimmed_by_air(contrast)))
    return left_out + matmul(_faces_beyond(corners, camera) * shown, each)


def _faces_beyond(corners: Float[Array, "face 3 3"], camera: Camera) -> Float[Array, " face"]:
    """About the shares of faces that lie beyond a camera's frame."""
    pieces = int(min(max((PROJECTED / max(len(corners), 1)) ** 0.5, 2), 16))
    return _beyond(einsum("pc,fck->fpk", jnp.asarray(_centres(pieces), corners.dtype), corners), camera)


def _capsules_beyond(ends: Float[Array, "capsule 2 3"], camera: Camera) -> Float[Array, " capsule"]:
    """About the shares of capsules that lie beyond a camera's frame."""
    along = jnp.asarray([0.1, 0.3, 0.5, 0.7, 0.9], ends.dtype)[None, :, None]
    return _beyond(ends[:, :1] + along * (ends[:, 1:] - ends[:, :1]), camera)


def _beyond(points: Float[Array, "part point 3"], camera: Camera) -> Float[Array, " part"]:
    """Shares of points that lie beyond a camera's frame."""
    half = camera.half_size() * (1 + 1e-3)
    out = jnp.any(jnp.abs(camera.project(points)) > half[None, None], axis=-1)
    return jnp.mean(out.astype(points.dtype), axis=-1)


class Shown(NamedTuple):
    """Areas in a camera's frame that rays must meet [band] [m2].

    Attributes:
        patch: of an even patch that rays would find as hard as they do what shines,

            patch = (sum I)^2 / sum (I^2 / a),

            I being the intensities of the parts in contrast to what is behind the scene, a their projected areas: of n
            even and independent rays a pixel, of area A, the intensity would have the relative variance A / (n patch).
            Where a face of a hundredth of a pixel sends most, it alone counts. It is at most the area of all parts,
            which overlap, and of the rectangle that holds the scene; these alone where nothing shines by itself.
        brightest: of the brightest parts that bring as much more than their share of the area as may be missed; inf
            where all of them do not.
    """

    patch: Float[Array, " band"]
    brightest: Float[Array, " band"]


@program
def what_shines(
    lit: Lit, camera: Camera, in_sight: Bool[Array, " face"] | None, missed: Float[Array, "tolerance 2"]
) -> Shown:
    """What rays must meet of a scene.

    Args:
        lit: the scene on the nodes.
        camera: the eye.
        in_sight: see `faces_in_sight`; None: nothing hides anything.
        missed: of an intensity, by each tolerance: as a share of it, or in [W sr-1] if that is more.
    """
    behind = lit.background(-camera.frame[2])
    corners, radiance, ends, radius, intensity = _seen(_shining(lit, behind), camera.eye)
    x, y = jnp.moveaxis(camera.project(corners), -1, 0)
    turn = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
    closed = lit.scene.skin is not None and lit.scene.skin.mesh.closed
    of_faces = (jnp.maximum(turn, 0) if closed else jnp.abs(turn)) / 2
    if in_sight is not None:
        of_faces = jnp.where(in_sight, of_faces, 0)
    long = jnp.linalg.norm(camera.project(ends[:, 1]) - camera.project(ends[:, 0]), axis=-1)
    inside = 1 - jnp.concatenate([_faces_beyond(corners, camera), _capsules_beyond(ends, camera)])
    area = jnp.concatenate([of_faces, radius * (np.pi * radius + 2 * long)]) * inside
    # as shares of the brightest: squares of what is faint underflow
    each = jnp.concatenate([jnp.abs(radiance) * of_faces[:, None], intensity]) * inside[:, None]
    largest = jnp.maximum(each.max(axis=0), jnp.finfo(each.dtype).tiny)
    each = each / largest[None]
    spread = jnp.sum(each**2 / jnp.where(area > 0, area, 1)[:, None], axis=0)
    total = jnp.sum(each, axis=0)
    patch = jnp.where(spread > 0, total**2 / jnp.where(spread > 0, spread, 1), jnp.inf)
    low, high = camera.rectangle(lit.scene.extent())
    patch = jnp.minimum(patch, jnp.minimum(jnp.prod(high - low), jnp.sum(area)))
    allowed = jnp.min(jnp.maximum(missed[:, :1] * total[None], missed[:, 1:] / largest[None]), axis=0)
    return Shown(patch, _brightest(each, area, allowed))


def _brightest(
    each: Float[Array, "part band"], area: Float[Array, " part"], allowed: Float[Array, " band"]
) -> Float[Array, " band"]:
    """See `Shown.brightest`: of intensities of parts and their areas, of which so much may be missed."""

    def of_band(own: Array, allowed: Array) -> Array:
        radiance = safe_divide(own, area)
        order = jnp.argsort(-radiance)
        more = (radiance - safe_divide(jnp.sum(own), jnp.sum(area))) * area
        enough = jnp.cumsum(more[order]) > allowed
        return jnp.where(jnp.any(enough), jnp.cumsum(area[order])[jnp.argmax(enough)], jnp.inf)

    return jax.vmap(of_band, in_axes=(1, 0))(each, allowed)


@program
def faces_in_sight(lit: Lit, camera: Camera) -> Bool[Array, " face"]:
    """Whether a camera sees the middle of each face of the skin."""
    assert lit.scene.skin is not None
    mesh = lit.scene.skin.mesh
    centre = mesh.corners().mean(axis=1)
    toward = camera.eye.toward(centre)
    return ~any_hit(mesh, Rays(centre, toward), leaving=jnp.arange(mesh.count, dtype=jnp.int32))


def _centres(cuts: int) -> np.ndarray:
    """Barycentric coordinates of the centres of the cuts^2 equal pieces of a triangle [piece, 3]."""
    i, j = np.indices((cuts, cuts)).reshape(2, -1)
    upright, other = (np.stack([i, j], 1)[i + j < cuts - more] + (1 + more) / 3 for more in (0, 1))
    two = np.concatenate([upright, other]) / cuts
    return np.concatenate([1 - two.sum(axis=1, keepdims=True), two], axis=1)


class _Outlook(NamedTuple):
    """What cameras are made of, see `rolled_camera`."""

    extent: Float[Array, "corner 3"]
    shining: _Shining
    distance: Array


def graded_cameras(lit: Lit, aspect: Float[Array, "view 2"], shape: tuple[int, int], distance: Any) -> Camera:
    """Cameras [view] that hold the scene and are graded by its brightness, for intensities; see `geometry._grading`.

    Args:
        lit: the scene on the nodes.
        aspect: azimuth and elevation [view, 2] [deg].
        shape: rows and columns.
        distance: from the middle of the scene to the sensor [m]; inf allowed.
    """
    outlook = _Outlook(lit.scene.extent(), _shining_of(lit), as_float(distance))
    if is_traced((outlook, aspect)):
        return graded(*_cameras(outlook, aspect, None), shape)
    count, given = aspect.shape[0], np.asarray(aspect)
    more = -count % VIEWS
    found = _cameras(outlook, placed(np.pad(given, ((0, more), (0, 0)))), placed(np.arange(count + more) < count))
    cameras, upto = jax.tree.map(lambda leaf: placed(np.asarray(leaf)[:count]), found)
    return graded(cameras, upto, shape)


@program
def _shining_of(lit: Lit) -> _Shining:
    return _shining(lit)


@program
def _cameras(
    outlook: _Outlook, aspect: Float[Array, "view 2"], wanted: Bool[Array, " view"] | None
) -> tuple[Camera, Float[Array, "view 2 edge"]]:
    """What `rolled_camera` finds for every aspect, zeros for those that are not wanted."""
    extent, shining, distance = outlook
    alike = _bright(shining, None) if shining.gloss is None else None

    def camera(aspect: Array) -> tuple[Camera, Array]:
        bright = alike
        if bright is None:
            bright = _bright(shining, camera_around(view_frame(*aspect), extent, (1, 1), distance).eye)
        return rolled_camera(aspect[0], aspect[1], extent, bright, distance)

    if wanted is None:
        return lax.map(camera, aspect)
    none = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(camera, aspect[0]))
    return lax.map(lambda one: lax.cond(one[1], camera, lambda _: none, one[0]), (aspect, wanted))


def _emissivity(lit: Lit) -> Float[Array, "face node"]:
    """Of every face along its normal."""
    assert lit.scene.skin is not None
    own = lit.scene.skin.brdf.at(jnp.arange(lit.scene.skin.mesh.count, dtype=jnp.int32))
    return jax.vmap(lambda brdf: brdf.directional_emissivity(as_float(1.0)))(own)


def _of_skin(lit: Lit, emissivity: Array, irradiance: Array, behind: Array | None) -> Float[Array, "face node"]:
    """Radiance of every face, as if a Lambert one; in contrast to what is `behind` it and as bright before it."""
    assert lit.blackbody is not None
    emitted = lit.blackbody if behind is None else lit.blackbody - behind[None]
    return emissivity * emitted + (1 - emissivity) * irradiance / np.pi


class _Beam(NamedTuple):
    """Light of a source without extent on surfaces: directions to it, cosines [face, 1], and how strong it is."""

    omega: Float[Array, "face 3"]
    cosine: Float[Array, "face 1"]
    light: Float[Array, "face node"]


def _beams(lit: Lit, point: Float[Array, "face 3"], normal: Float[Array, "face 3"]) -> list[_Beam]:
    """Of each source without extent on surfaces."""
    each = [(jax.vmap(source.toward)(point)[0], jax.vmap(source.beam)(point)) for source in lit.scene.delta_sources]
    return [_Beam(omega, dot(omega, normal)[:, None], light) for omega, light in each]


def _narrow_beams(lit: Lit, point: Float[Array, "face 3"], normal: Float[Array, "face 3"]) -> list[_Beam]:
    """Of lights with an extent, each by `NARROW`^2 of their points; dark where they look larger than `LITTLE`."""
    beams = []
    for source in lit.scene.area_sources:
        for u in as_float(middles(NARROW)):
            beam, density = _glimpse(source, u, point, normal)
            light = jnp.where(density * LITTLE > 1, beam.light / NARROW**2, 0)
            beams.append(beam._replace(light=light))
    return beams


def _glimpse(
    light: AbstractExtendedLight, u: Float[Array, " 2"], point: Float[Array, "face 3"], normal: Float[Array, "face 3"]
) -> tuple[_Beam, Float[Array, "face 1"]]:
    """One sample of a light as if it all came from there, and the density of it [face, 1] [sr-1]."""
    arrival = jax.vmap(light.sample, in_axes=(None, 0, 0))(u, point, normal)
    density = arrival.pdf[:, None]
    cosine = dot(arrival.omega_i, normal)[:, None]
    return _Beam(arrival.omega_i, cosine, safe_divide(light.arriving(arrival.omega_i), density)), density


def _irradiance(beams: list[_Beam], others: Float[Array, "face node"]) -> Float[Array, "face node"]:
    """Of beams on surfaces, and of `others`."""
    return sum((jnp.maximum(beam.cosine, 0) * beam.light for beam in beams), others)


def _from_all_around(
    lit: Lit, point: Float[Array, "face 3"], normal: Float[Array, "face 3"]
) -> Float[Array, "face node"]:
    """Irradiance of lights with an extent, by the mean over `SKY`^2 of their samples."""
    total = jnp.zeros((point.shape[0], lit.nodes.count), point.dtype)
    for light in lit.scene.extended_lights:

        def add(total: Array, u: Array, light: AbstractExtendedLight = light) -> tuple[Array, None]:
            return _irradiance([_glimpse(light, u, point, normal)[0]], total), None

        total = lax.scan(add, total, as_float(middles(SKY)))[0]
    return total / SKY**2
