"""A radiance image with its standard error."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from jaxir._math import safe_sqrt
from jaxir._programs import program
from jaxir.geometry import Camera
from jaxir.imaging._budget import ErrorBudget, budget
from jaxir.imaging._estimate import Estimate
from jaxir.imaging._left_out import Asked
from jaxir.transport import AIR, BACKGROUND

FEW_PIXELS = 16  # of which a sum tells its error to a fifth


class Outcome(eqx.Enumeration):
    """Why a computation ended."""

    samples_taken = "All samples asked for were taken."
    tolerance_met = "The standard error of every band fell below the tolerance asked for."
    samples_spent = "The samples, or seconds, were spent before the standard error met the tolerance asked for."
    left_out = (
        "The standard error met the tolerance asked for, but orders, bounces, nodes or sunlit cells err more than that."
    )


class Image(eqx.Module):
    """A radiance image at the entrance pupil.

    Attributes:
        radiance: mean over each pixel, equation (1) [row, column, band] [W m-2 sr-1].
        standard_error: of `radiance`, from the pixel's own samples [row, column, band].
        empty: what the pixels would show without the scene; one pixel stands for all where the background is uniform
            [row | 1, column | 1, band].
        camera: what took it.
        bands: band names.
        samples: rays taken per pixel, on average where some pixels got more.
        outcome: why no more were taken, an item of `Outcome`.
        orders: what the last two orders of scattering brought of the radiant intensity, the last first [2, band]
            [W sr-1]; None without particles.
        unresolved: what the lattice of `DiscreteOrdinates` lacks of the plumes' intensity in the image, estimated
            [band] [W sr-1]; None without.
        spectral: what the spectral nodes err, as a share of `contrast` [band]; None where they were given.
        asked: what it is an image of, for `error_budget`; None where values were known only inside jit.
        components: names of what `parts` holds, where `render` was asked for components.
        parts: the radiance by where its light comes from [row, column, component, band]; it adds up to `radiance`.
        parts_error: standard error of `parts`; those of one pixel are of the same rays, so that they do not add up.
    """

    radiance: Float[Array, "row column band"]
    standard_error: Float[Array, "row column band"]
    empty: Float[Array, "_row _column band"]
    camera: Camera
    bands: tuple[str, ...] = eqx.field(static=True)
    samples: Int[Array, ""]
    outcome: Outcome
    orders: Float[Array, "2 band"] | None = None
    unresolved: Float[Array, " band"] | None = None
    spectral: Float[Array, " band"] | None = None
    asked: Asked | None = None
    components: tuple[str, ...] = eqx.field(static=True, default=())
    parts: Float[Array, "row column component band"] | None = None
    parts_error: Float[Array, "row column component band"] | None = None

    def component_intensity(self) -> Float[Array, "component band"]:
        """`radiant_intensity` by component [component, band] [W sr-1], which adds up to it.

        What the empty image would show is taken from the background, whose part is therefore what the scene hides of
        it, below 0 where skin is in front; that of the air, the same with and without the scene, is 0.

        Raises:
            ValueError: `render` was not asked for components.
        """
        if self.parts is None:
            raise ValueError('Image.parts: got none, expected render(..., components="sources")')
        return _by_component(self.camera, self.parts, self.empty, self.components)

    def component_error(self) -> Float[Array, "component band"]:
        """Standard error of `component_intensity` [component, band] [W sr-1]; pixels are sampled independently.

        Raises:
            ValueError: `render` was not asked for components.
        """
        if self.parts_error is None:
            raise ValueError('Image.parts_error: got none, expected render(..., components="sources")')
        return _intensity_error(self.camera, self.parts_error)

    def radiant_intensity(self) -> Float[Array, " band"]:
        """Radiant intensity in contrast to what the empty image would show [band] [W sr-1].

        I = sum over pixels of (L - L_empty) * area, with `Camera.pixel_area`. Without background and air this is the
        intensity of the source itself; with air it is the apparent one.
        """
        return _intensity(self.camera, self.radiance, self.empty)

    def contrast(self) -> Float[Array, " band"]:
        """What pixels differ by from the empty image, whatever its sign [band] [W sr-1].

        Sum over pixels of |L - L_empty| * area: the absolute `radiant_intensity` where everything is brighter than what
        is behind it, or everything darker, and more where one part makes up for the other.
        """
        return _contrast(self.camera, self.radiance, self.empty)

    def intensity_error(self) -> Float[Array, " band"]:
        """Standard error of `radiant_intensity` [band] [W sr-1]; pixels are sampled independently.

        Where the background is not uniform this counts its variation within pixels too, which the contrast does not.
        """
        return _intensity_error(self.camera, self.standard_error)

    def error_budget(self, look: bool = True) -> ErrorBudget:
        """The radiant intensity with all that is known of its error.

        Args:
            look: whether to look now, by few rays, for what nodes that were given, panels of jets and sunlit cells err,
                and what bounces left out would add. The first look at scenes of one structure compiles as much as an
                image; without it they are not known, unless nothing can be there.
        """
        own = self.radiant_intensity(), self.intensity_error(), self.contrast(), self.spectral
        return budget(*own, self.truncation, self.bands, self.asked, look)

    @property
    def truncation(self) -> Float[Array, " band"]:
        """Share of the radiant intensity that is left out of what particles scatter, estimated [band].

        Of orders of scattering beyond the last, see `truncated_share`, or `unresolved`, with what the last order
        changed where what a lattice errs is sampled; 0 without particles, and inf of no intensity.
        """
        return share_left_out(self.orders, self.unresolved, self.radiant_intensity())


@program
def _intensity(camera: Camera, radiance: Array, empty: Array) -> Float[Array, " band"]:
    return over_pixels(camera.pixel_area(), radiance - empty)


@program
def _contrast(camera: Camera, radiance: Array, empty: Array) -> Float[Array, " band"]:
    return over_pixels(camera.pixel_area(), jnp.abs(radiance - empty))


@program
def _by_component(camera: Camera, parts: Array, empty: Array, names: tuple[str, ...]) -> Float[Array, "component band"]:
    return by_component(camera.pixel_area(), parts, empty, names)


@program
def _intensity_error(camera: Camera, standard_error: Array) -> Float[Array, "*component band"]:
    return error_over_pixels(camera.pixel_area(), standard_error)


# Of pixels [row, column, ...] or [tile, pixel, ...] that take an area each


def over_pixels(area: Float[Array, "row column"], value: Float[Array, "row column *more"]) -> Float[Array, "*more"]:
    """Sum over pixels of a value times area."""
    return jnp.sum(value * area.reshape(*area.shape, *(1,) * (value.ndim - 2)), axis=(0, 1))


def by_component(area: Array, parts: Array, empty: Array, names: tuple[str, ...]) -> Float[Array, "component band"]:
    """See `Image.component_intensity`."""
    own = [parts[:, :, k] for k in range(len(names))]
    path = own.pop() if names[-1] == AIR else jnp.zeros_like(empty)
    if names[-1 - (names[-1] == AIR)] == BACKGROUND:
        own[-1] = own[-1] + path - empty
    found = [over_pixels(area, part) for part in own]
    return jnp.stack([*found, *([jnp.zeros_like(found[0])] if names[-1] == AIR else [])])


def totals(
    area: Float[Array, "row column"], found: Estimate, unresolved: Array | None, names: tuple[str, ...]
) -> tuple[Array, ...]:
    """What an image of estimates tells of all its pixels: intensity, its error, truncation, contrast [band].

    And intensity by component, if these have names, with errors. Pixels without area are none.
    """
    some = (area > 0)[..., None]
    found = found._replace(within=jnp.where(some, found.within, 0))
    if found.parts_within is not None:
        found = found._replace(parts_within=jnp.where(some[..., None], found.parts_within, 0))
    error, parts_error = (None if of is None else error_over_pixels(area, safe_sqrt(of)) for of in found.surer())
    apart = found.mean - found.empty
    intensity, contrast = over_pixels(area, apart), over_pixels(area, jnp.abs(apart))
    orders = None if found.orders is None else over_pixels(area, found.orders)
    parts = () if found.parts is None else (by_component(area, found.parts, found.empty, names), parts_error)
    return intensity, error, share_left_out(orders, unresolved, intensity), contrast, *parts


def error_over_pixels(area: Array, standard_error: Float[Array, "row column *more"]) -> Float[Array, "*more"]:
    """See `Image.intensity_error`."""
    each = standard_error * area.reshape(*area.shape, *(1,) * (standard_error.ndim - 2))
    most = lax.stop_gradient(jnp.max(each, axis=(0, 1), keepdims=True))
    most = jnp.where(most > 0, most, 1)  # squares of what is faint underflow
    return most[0, 0] * safe_sqrt(jnp.sum((each / most) ** 2, axis=(0, 1)))


@program
def share_left_out(orders: Array | None, unresolved: Array | None, intensity: Array) -> Array:
    """See `Image.truncation`; of the last two orders of scattering, `unresolved` and the intensity."""
    if unresolved is None:
        return jnp.zeros_like(intensity) if orders is None else truncated_share(orders, intensity)
    lacks = unresolved if orders is None else unresolved + jnp.abs(orders[..., 0, :])
    share = jnp.where(intensity != 0, lacks / jnp.where(intensity != 0, jnp.abs(intensity), 1), jnp.inf)
    return jnp.where(lacks == 0, 0, share)


@program
def truncated_share(orders: Float[Array, "*view 2 band"], intensity: Float[Array, "*view band"]) -> Array:
    """What is left out beyond the last order of scattering, as a share of the intensity [*view, band].

    Orders fall at last like a geometric series: the rest is last r / (1 - r) with r = last / one before; inf where
    there are no two orders or they do not fall, 0 where the last brings nothing.
    """
    last, before = jnp.abs(orders[..., 0, :]), jnp.abs(orders[..., 1, :])
    falls = last < before
    rest = last * last / jnp.where(falls, before - last, 1)
    share = rest / jnp.where(intensity != 0, jnp.abs(intensity), 1)
    return jnp.where(last == 0, 0, jnp.where(falls & (intensity != 0), share, jnp.inf))


def image_of(
    camera: Camera,
    bands: tuple[str, ...],
    mean: Float[Array, "row column band"],
    variance: Float[Array, "row column band"],
    empty: Float[Array, "_row _column band"],
    samples: int | Int[Array, ""],
    orders: Float[Array, "row column 2 band"] | None,
    unresolved: Float[Array, " band"] | None,
    spectral: Float[Array, " band"] | None,
    components: tuple[str, ...],
    parts: Float[Array, "row column component band"] | None,
    parts_variance: Float[Array, "row column component band"] | None,
) -> Image:
    """The image of one pass of `samples` rays per pixel; `orders` are those of each pixel's radiance."""
    whole = None if orders is None else over_pixels(camera.pixel_area(), orders)
    taken = jnp.asarray(samples, jnp.int32)
    error = safe_sqrt(variance)
    outcome: Any = Outcome.samples_taken  # an enumeration, which types do not know
    parts_error = None if parts_variance is None else safe_sqrt(parts_variance)
    about = whole, unresolved, spectral, None, components, parts, parts_error
    return Image(mean, error, empty, camera, bands, taken, outcome, *about)


def few_tell(image: Image) -> bool:
    """Whether the error of an intensity is that of few pixels, of which each tells its own by one difference.

    Of a sum of squares v_p of normal differences about 3 (sum v_p)^2 / sum v_p^2 tell: so many as there are, if alike.
    """
    area = np.asarray(image.camera.pixel_area(), np.float64)[:, :, None]
    square = (area * np.asarray(image.standard_error, np.float64)) ** 2
    total, among = square.sum(axis=(0, 1)), (square**2).sum(axis=(0, 1))
    return bool((3 * total**2 < FEW_PIXELS * among).any())


def joined(image: Image, more: Image) -> Image:
    """The mean of two images of the same pixels, weighted by their samples."""
    taken = image.samples + more.samples
    own, other = (part.samples / taken for part in (image, more))
    error, parts_error = jax.tree.map(
        lambda a, b: jnp.sqrt((own * a) ** 2 + (other * b) ** 2),
        (image.standard_error, image.parts_error),
        (more.standard_error, more.parts_error),
    )
    radiance, empty, orders, parts = jax.tree.map(
        lambda a, b: own * a + other * b,
        (image.radiance, image.empty, image.orders, image.parts),
        (more.radiance, more.empty, more.orders, more.parts),
    )
    about = image.unresolved, image.spectral, image.asked, image.components, parts, parts_error
    return Image(radiance, error, empty, image.camera, image.bands, taken, image.outcome, orders, *about)
