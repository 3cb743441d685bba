"""How light is found: the one object that says what is computed, what is sampled and what is left out."""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxir._arrays import Check
from jaxir._fields import Physical, SpectralLight, count, light, quantity
from jaxir._math import matmul
from jaxir._programs import program
from jaxir.geometry import AbstractSampler, Independent
from jaxir.geometry.search import Mesh, face_normal
from jaxir.scene import Scene
from jaxir.scene.light import AbstractDeltaSource


class DirectSampling(Physical):
    """Light straight from lights with an extent, by samples at every point where a path touches skin or a particle.

    Each light gets `lights` points of it, and `brdfs` directions in which the point reflects or scatters are shared by
    all lights. With both, each sample is weighted by the quadratic heuristic (9), which is close to the better of the
    two everywhere:

        L = sum_lights [ 1/N_l sum w_l f cos L_l / p_l  +  1/M_f sum w_f f cos L_l / p_f ]

    Lights alone suit small lights and dull skin, the brdf alone large lights and glossy skin.

    Attributes:
        lights: N_l, samples of each light.
        brdfs: M_f, samples of the brdf, or of the phase function.
    """

    lights: int = count(0, default=1)
    brdfs: int = count(0, default=1)

    def structure(self) -> None:
        """See `Physical.structure`."""
        if self.lights + self.brdfs == 0:
            raise ValueError("DirectSampling: got lights = 0 and brdfs = 0, expected at least one sample")


class ClosedForm(Physical):
    """Light straight from lights with an extent, without samples: form factors over convex Lambert skin.

    Applies only where it is exact: lights are discs, polygons and uniform surroundings, each disc lies wholly above or
    wholly below the plane of every face (polygons may cross it), the skin is flat, or closed, convex and seen from
    outside (so nothing hides a light), and there is no plume.
    """


class SkinLight(Physical):
    """Warm skin as a light: worth it where a small part of the skin outshines the rest.

    A face is drawn with a probability that grows as area * temperature^exponent, and a point of it uniformly. Without
    it skin and particles meet the glow of skin only where a path happens to go on.

    Attributes:
        exponent: 4 suits all wavelengths together; one wavelength, c2 / (wavelength temperature) where that is large.
            It decides how even the samples are; the estimate has no bias for any.
    """

    exponent: Float[Array, ""] = quantity("1", default=4.0)


class PlumeLight(Physical):
    """The plume as a light on the skin: worth it where a small hot plume fills little of the skin's view.

    At every point of the skin directions are drawn towards pieces of the plume, each with a probability that grows as
    volume * temperature^exponent * cos / distance^2 (and with the mixture fraction of a jet). Such a direction brings
    the plume's own emission up to where the ray meets the skin, as do those drawn from the brdf, and equation (9)
    weights both. What lies behind the plume is found as without it, dimmed by the plume. Without it skin meets the
    plume only where a path happens to go on through it.

    Attributes:
        exponent: as that of `SkinLight`.
    """

    exponent: Float[Array, ""] = quantity("1", default=4.0)


class DiscreteOrdinates(Physical):
    """Light scattered by particles without samples: the radiance in the plume, solved on a lattice.

    However often light is scattered: no order is left out, and images have no noise of it. What errs instead is the
    lattice, by about a per cent of the scattered light, and the harmonics, by up to some per cent of what little a jet
    sends along its own axis. `Image.truncation` estimates both view by view: the harmonics by a second solution with
    two degrees fewer, most often too much, the lattice by a quarter of what changes in a third that is read between the
    points by straight lines, by twice of it where cells jump, whatever its sign. Less than half of what errs is told
    where light changes by half from point to point, as across a jet on 5 points. In the sun blocks of cells of very
    different density err up to 2.4 times what is told where the lattice has fewer points than there are cells. An
    optical depth of scattering above 4 between points across a plume, or a lobe backward that the harmonics do not
    resolve, is refused, and so is a lattice too coarse for its cubics: light read between thick cells may grow from one
    scattering to the next, and nothing solves that (25 x 7 points in a jet of 60 m that scatters 5 m-1; 41 x 9
    suffice). Shadows of the skin on the plume are as sharp as the lattice, and what scattered light skin reflects back
    into the plume is left out. Near the direction of a source without extent its halo, light scattered forward more
    than once, is that of small angles: through cubes .3 and 1 deep (asymmetry .8 and .95) it errs by .1 to 1 % towards
    the source, where .5 to 4 % are told, and by up to 3 % ten to forty degrees beside it, where .1 to 3 % are.
    Costs some 15 times along across^2 (2 order + 2)^2 rays once for a scene, twice that on a grid, and for a ray
    some ten times what a plume without particles costs, where rays meet in an eye that is far away beside the
    lattice's steps (sources, too), else twenty.

    With `orders` what the lattice errs is sampled instead of told: paths are scattered so often at most, and where a
    path is scattered the light that it finds stands in the place of what the lattice says of the same place and
    direction. That has no bias however coarse the lattice, and the little noise of a difference. Left are the light
    that is scattered more often, which is the lattice's, and the pieces by which its light is summed along a ray:
    `Image.truncation` tells both, the first by what the last order changed.

    Along an edge of a grid it takes up to two points more where fewer then lie on sides between cells. There light
    bends, and points at every bend err alike in each cell: of 3 cells a side that glow, their densities over three
    decades, 10 points err by 4.5 %, told 2, and 11 by 1.4, told 1.9.

    Sources with an extent at a finite distance are not for it: sample (`Method.orders`).

    Attributes:
        along: points of the lattice along the plume; in a grid of cells along its longest edge.
        across: and across it, at least.
        order: degree of the harmonics that hold the radiance, see `jaxir.transport.ordinates`. What is scattered
            forward in a lobe narrower than 180 / order degrees counts as not scattered; of a sky that is not seen
            it is seen, as coming from where the ray goes.
        orders: how often at most paths are scattered that sample what the lattice errs; 0 for the lattice alone.
    """

    along: int = count(4, default=25)
    across: int = count(4, default=7)
    order: int = count(1, default=3)
    orders: int = count(0, default=0)


class Method(Physical):
    """How light is found.

    Sources without extent are always evaluated, with their shadows, at every point where a path touches skin or a
    particle. What else lights the scene is found as the method says; what it says nothing of is left out. The estimate
    of all that is not left out has no bias.

    Along every segment of a path the plume's emission is the exact sum over its cells or panels. In a single gridded
    plume light of parallel sources scattered once towards the segment's begin is one, too, with each cell lit as its
    centre is: u0 (u0 + 2 u) / 24 of a cell's share is left out, u0 and u being its optical depths towards the source
    and along the segment. What is scattered otherwise is sampled: one place on each segment, always in the plume
    (forced collision), lit there by every source that is not summed, and from there a direction, the next segment,
    drawn from the phase function about that of the path, of one in four about that towards a source without extent. A
    path that meets reflecting skin while `bounces` are left goes on either from a particle or from the skin, as a
    photon would; it goes on max(orders, bounces) times at most.

    Attributes:
        direct: how light straight from sources with an extent and from the surroundings (the background, and
            backgrounds among the sources) is found; None leaves it out.
        bounces: how often paths go on from skin. 0 takes the light of `direct` alone. The error left out is at most
            reflectance^(bounces + 1) of the brightest radiance around.
        orders: how often at most a path is scattered by particles; what is summed along its segments comes on top, so
            that parallel light in a single grid is scattered once more. Light scattered more often is left out: for
            particles that absorb nothing, about 1e-3 of the light through a plume of optical depth 1 beyond 10 orders,
            7 % of it at 4; `Image.truncation` estimates it.
        sampler: how even the random points of one decision are.
        ambient: radiance from everywhere that stands for light reflected more often than `bounces` [node or 1]
            [W m-2 sr-1] or a spectrum: the last point of a path reflects reflectance(theta_o) * ambient more. None for
            nothing.
        skin_light: how the skin's own emission is looked for by `direct`, like the lights: then it counts as a light,
            also with 0 bounces, and `ambient` stands for what skin reflects, no longer for what it emits. None: it is
            met where paths lead.
        plume_light: how the plume's emission is looked for from skin by `direct`, in the same way.
        scattering: how light scattered by particles is found on a lattice; then `orders` has no meaning. None: it is
            sampled.
    """

    direct: DirectSampling | ClosedForm | None = DirectSampling()
    bounces: int = count(0, default=0)
    orders: int = count(0, default=10)
    sampler: AbstractSampler = Independent()
    ambient: SpectralLight | None = light("W m-2 sr-1", default=None)
    skin_light: SkinLight | None = None
    plume_light: PlumeLight | None = None
    scattering: DiscreteOrdinates | None = None

    def structure(self) -> None:
        """See `Physical.structure`."""
        for field, kinds in (
            ("direct", (DirectSampling, ClosedForm, type(None))),
            ("scattering", (DiscreteOrdinates, type(None))),
            ("sampler", (AbstractSampler,)),
            ("skin_light", (SkinLight, type(None))),
            ("plume_light", (PlumeLight, type(None))),
        ):
            if not isinstance(getattr(self, field), kinds):
                names = ", ".join("None" if kind is type(None) else kind.__name__ for kind in kinds)
                raise ValueError(f"Method.{field}: got {getattr(self, field)!r}, expected one of {names}")
        for field, own in (("skin_light", self.skin_light), ("plume_light", self.plume_light)):
            if own is not None and not isinstance(self.direct, DirectSampling):
                raise ValueError(
                    f"Method.{field}: got {type(own).__name__} with direct = {type(self.direct).__name__}, expected "
                    "DirectSampling"
                )

    def resolved(self, scene: Scene) -> Method:
        """The method without what a scene has no use for, so that nothing is compiled for it."""
        skin, plume = scene.skin is not None, scene.plume is not None
        skin_light, plume_light = (self.skin_light if skin else None), (self.plume_light if skin and plume else None)
        looked_for = scene.extended_lights or skin_light is not None or plume_light is not None
        return dataclasses.replace(
            self,
            direct=self.direct if looked_for else None,
            bounces=self.bounces if skin else 0,
            orders=self._sampled_orders if self.samples_particles(scene) else 0,
            scattering=self.scattering if scene.scatters else None,
            ambient=self.ambient if skin else None,
            skin_light=skin_light,
            plume_light=plume_light,
        )

    @property
    def counts(self) -> tuple[int, int]:
        """Samples at each point: of each light, and of the brdf."""
        return (self.direct.lights, self.direct.brdfs) if isinstance(self.direct, DirectSampling) else (0, 0)

    def segments(self) -> int:
        """Segments of a path; of a resolved method."""
        return max(self.bounces, self.orders) + 1

    def needs_key(self, scene: Scene) -> bool:
        """Whether anything is sampled along paths; of a resolved method."""
        at_skin = scene.skin is not None and (self.bounces > 0 or isinstance(self.direct, DirectSampling))
        return at_skin or self.orders > 0

    def samples(self, scene: Scene) -> int:
        """Directions recorded for each ray."""
        lights = len(scene.extended_lights) + (self.skin_light is not None) + (self.plume_light is not None)
        at_skin = max(1, lights * sum(self.counts)) * (1 + self.bounces)
        return at_skin + (self._sampled_orders if self.samples_particles(scene) else 0)

    @property
    def _sampled_orders(self) -> int:
        return self.orders if self.scattering is None else self.scattering.orders

    def samples_particles(self, scene: Scene) -> bool:
        """Whether what particles scatter is sampled, or what a lattice errs of that."""
        return scene.scatters and (self.scattering is None or self.scattering.orders > 0)

    def sampled_beams(self, scene: Scene) -> tuple[AbstractDeltaSource, ...]:
        """Sources without extent whose light is looked for where particles scatter paths."""
        return scene.sampled_beams if self.scattering is None else scene.delta_sources

    def checks_for(self, scene: Scene) -> list[Check]:
        """What must hold of the method's values, and of the scene's for the method to suit it.

        Raises:
            ValueError: the structure of the scene does not suit.
        """
        closed = _closed_form_checks(scene) if isinstance(self.direct, ClosedForm) else []
        if self.scattering is not None and scene.scatters and scene.area_sources:
            raise ValueError(
                f"DiscreteOrdinates: got a {type(scene.area_sources[0]).__name__}, expected sources without extent "
                "and backgrounds; sample instead (scattering = None)"
            )
        return [*self.checks(), *closed]


@program
def _closed_form_checks(scene: Scene) -> list[Check]:
    """Conditions of the closed form, compiled, because it looks at every pair of face and vertex."""
    if scene.skin is None:
        return []
    if not scene.skin.brdf.diffuse or scene.plumes:
        raise ValueError(
            f"ClosedForm: got {type(scene.skin.brdf).__name__} skin with{'' if scene.plumes else 'out'} plume, "
            "expected Lambert skin without plume; sample instead"
        )
    mesh = scene.skin.mesh
    rise, grain = concavity(mesh)
    normal, corner = face_normal(mesh, jnp.arange(mesh.count, dtype=jnp.int32)), mesh.corners()[:, 0]
    convex = "0: skin closed and convex, or flat"
    checks = [Check("ClosedForm: rise of vertices over a face [m]", rise, rise <= grain, convex)]
    for shining in scene.extended_lights:
        own = shining.form_factor_checks(corner, normal)
        if own is None:
            raise ValueError(
                f"ClosedForm: got {type(shining).__name__}, expected DiscSources, PolygonSources and a uniform "
                "background; sample it"
            )
        checks += own
    return checks


def concavity(mesh: Mesh) -> tuple[Float[Array, " face"], Float[Array, ""]]:
    """How far vertices rise over the plane of each face [face] [m], and the rounding of that [] [m].

    Nothing can come between a face and a light above it where none rises. Both sides count on open skin.
    """
    normal = face_normal(mesh, jnp.arange(mesh.count, dtype=jnp.int32))
    height = matmul(normal, mesh.vertices.T) - jnp.sum(normal * mesh.corners()[:, 0], axis=-1)[:, None]
    rise = jnp.max(height if mesh.closed else jnp.abs(height), axis=-1)
    return rise, 64 * jnp.finfo(rise.dtype).eps * jnp.max(jnp.abs(mesh.vertices))
