"""The renderer against closed forms: plates, sunlit plates, gray boxes, and isothermal scenes."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

import jaxir
from jaxir.optics.spectrum import gray_nodes
from tests.scenes import box_intensity, box_mesh, gray_box, plate

BANDS = (jaxir.SWIR, jaxir.MWIR, jaxir.LWIR)
PLATE_400 = (0.493069996, 14.9236707, 66.8704398)  # 1 m2, emissivity .5, normal view [W/sr]


def assert_within(image, expected, tolerance):
    """|I - expected| < 4 standard errors, and the standard error is small enough to mean something."""
    got, error = np.asarray(image.radiant_intensity(), float), np.asarray(image.intensity_error(), float)
    expected = np.asarray(expected)
    assert (error < tolerance / 4 * expected).all(), (error, expected)
    assert (np.abs(got - expected) < 4 * error + 1e-5 * expected).all(), (got, expected, error)


@pytest.mark.parametrize("angle", [0.0, 20.0, 60.0, 85.0])
def test_emitting_plate_by_faces(angle, precision):
    got = jaxir.unoccluded_intensity(jaxir.Scene(plate()), angle, 0.0, BANDS)
    rtol = {"float32": 1e-6, "float64": 5e-9}[precision]  # the closed form is printed with nine digits
    np.testing.assert_allclose(np.asarray(got, float), np.cos(np.deg2rad(angle)) * np.array(PLATE_400), rtol=rtol)


def sunlit(board, incidence=0.0, irradiance=100.0, transmittance=1.0, glow=0.0):
    """A plate in the sun and in air, or with a dark sun and clear air: the same program."""
    a = np.deg2rad(incidence)
    sun = jaxir.ParallelSource((-np.cos(a), -np.sin(a), 0.0), irradiance)
    air = jaxir.FixedPath(*(np.broadcast_to(x, (3,)) for x in (transmittance, glow)))
    return jaxir.Scene(board, sources=(sun,), atmosphere=air)


@pytest.mark.parametrize(("angle", "distance"), [(0.0, np.inf), (60.0, np.inf), (30.0, 11547.0)])
def test_emitting_plate_by_image(angle, distance, precision):
    shape, size = (48, 48), 1.5
    if np.isinf(distance):
        camera = jaxir.orthographic_camera(angle, 0.0, size / 48, shape)
    else:
        camera = jaxir.perspective_camera(angle, 0.0, distance, size / 48 / distance, shape)
    image = jaxir.render(sunlit(plate(), irradiance=0.0), camera, BANDS, samples=18)
    assert_within(image, np.cos(np.deg2rad(angle)) * np.array(PLATE_400), 0.01)


@pytest.mark.parametrize("incidence", [0.0, 40.0])
@pytest.mark.parametrize("view", [0.0, 70.0])
def test_plate_under_a_parallel_source(incidence, view, precision):
    scene = sunlit(plate(temperature=3.0), incidence)
    expected = np.full(3, 0.5 * 100.0 * np.cos(np.deg2rad(incidence)) * np.cos(np.deg2rad(view)) / np.pi)
    got = jaxir.unoccluded_intensity(scene, view, 0.0, BANDS)
    np.testing.assert_allclose(got, expected, rtol={"float32": 2e-6, "float64": 1e-9}[precision])
    camera = jaxir.orthographic_camera(view, 0.0, 1.2 / 48, (48, 48))
    assert_within(jaxir.render(scene, camera, BANDS, samples=18), expected, 0.02)


def test_a_source_behind_the_plate_lights_nothing():
    scene = sunlit(plate(temperature=3.0), 180.0)
    image = jaxir.render(scene, jaxir.orthographic_camera(0.0, 0.0, 1.2 / 48, (48, 48)), BANDS, samples=18)
    assert np.abs(image.radiance).max() < 1e-12  # what 3 K emit


def test_a_box_shades_the_plate_behind_it():
    board, blocker = plate(temperature=3.0), box_mesh((0.1, 0.4, 0.4), (2.0, 0.0, 0.0))
    vertices = np.concatenate([board.mesh.vertices, blocker.vertices])
    faces = np.concatenate([board.mesh.faces, np.asarray(blocker.faces) + 4])
    skin = jaxir.Skin(jaxir.Mesh(vertices, faces), 3.0, jaxir.Lambert(0.5))
    scene = jaxir.Scene(skin, sources=(jaxir.ParallelSource((-1.0, 0.0, 0.0), 100.0),))
    # seen from 80 deg above: the board's lit part is 1 - .16 of its area, the box shows its lit front .16 m2 too
    camera = jaxir.orthographic_camera(0.0, 75.0, 3.2 / 160, (160, 160), target=(1.0, 0.0, 0.0))
    image = jaxir.render(scene, camera, jaxir.MWIR, samples=8)
    expected = 0.5 * 100.0 / np.pi * np.cos(np.deg2rad(75.0)) * (1 - 0.16 + 0.16)
    assert_within(image, [expected], 0.05)


@pytest.mark.parametrize(
    ("size", "kappa", "source"), [((2.0, 2.0, 2.0), 10.0, 10.0), ((2.0, 2.0, 0.5), 0.01, 1e4)], ids=["thick", "thin"]
)
@pytest.mark.parametrize("angle", [0.0, 30.0, 80.0])
def test_gray_boxes(size, kappa, source, angle, precision):
    plume = gray_box(size, kappa)
    black = float(jaxir.band_radiance(plume.temperature[0, 0, 0], gray_nodes((jaxir.MWIR,)))[0])
    camera = jaxir.orthographic_camera(angle, 0.0, 3.2 / 64, (48, 64))
    image = jaxir.render(jaxir.Scene(plumes=plume), camera, jaxir.MWIR, samples=8)
    # the box's width across the view at 0 deg is its y extent, its depth the x extent
    expected = box_intensity(size[1], size[0], size[2], kappa, black, angle)
    assert_within(image, [expected], 0.02)
    crossed = jaxir.plume_intensity(jaxir.Scene(plumes=plume), angle, 0.0, jaxir.MWIR, rays=1024)
    np.testing.assert_allclose(crossed, expected, rtol=2e-3)


def test_parallel_rays_through_a_plume_in_hazy_air_in_front_of_a_sky():
    """An opaque box shows its outline times (blackbody - sky), dimmed by the air, from above as from below."""
    plume, toward = gray_box((3.0, 1.0, 2.0), 1e4), np.cos(np.deg2rad(30.0)) * np.array([0.5, np.sqrt(0.75), 0.0])
    black = jaxir.band_radiance(plume.temperature[0, 0, 0], gray_nodes((jaxir.MWIR,)))[0]
    parts = {"background": jaxir.UniformBackground(2.0), "atmosphere": jaxir.FixedPath(0.6, 3.0)}
    outline = toward @ [2.0, 6.0, 3.0] + 0.5 * 3.0
    for elevation in (30.0, -30.0):
        got = jaxir.plume_intensity(jaxir.Scene(plumes=plume, **parts), 60.0, elevation, jaxir.MWIR, rays=64)
        np.testing.assert_allclose(got, 0.6 * outline * (black - 2.0), rtol=2e-5)


@pytest.mark.parametrize("azimuth, elevation", [(90.0, 0.0), (150.0, 20.0)])
def test_the_shape_of_a_jet_has_right_slopes_from_any_side(azimuth, elevation, x64):
    """Rays follow its nozzle, its axis and its end."""

    def intensity(shape):
        where = (0.0, 0.0, 0.0), (-1.0, 0.0, 0.0)
        jet = jaxir.JetPlume(*where, 1.0, 900.0, 250.0, jaxir.GrayGas(0.3), spreading=shape[0], length=shape[1])
        return jaxir.plume_intensity(jaxir.Scene(plumes=jet), azimuth, elevation, jaxir.MWIR, rays=32768)[0]

    shape = np.array([0.22, 12.0])
    step = np.diag(0.03 * shape)
    expected = [(intensity(shape + h) - intensity(shape - h)) / (2 * h.sum()) for h in step]
    np.testing.assert_allclose(jax.grad(intensity)(shape), expected, rtol=1e-2)


@pytest.mark.parametrize("azimuth, elevation", [(100.0, 20.0), (150.0, 10.0)])
def test_slopes_of_a_thick_jet_are_no_difference_of_large_numbers(azimuth, elevation, x64):
    """Rays that grew with the box about it made slopes in its direction twice as large, of the other sign.

    By its direction, spreading, length and diameter; rays that do not follow the lip err twofold in the last.
    """

    @partial(jax.jit, static_argnums=1)
    def intensity(shape, rays):
        axis = jnp.stack([-jnp.cos(shape[0]), jnp.sin(shape[0]), 0.0])
        more = {"spreading": shape[1], "length": shape[2]}
        jet = jaxir.JetPlume((1.0, 0.0, 0.0), axis, shape[3], 1100.0, 250.0, jaxir.GrayGas(3.0), **more)
        return jaxir.plume_intensity(jaxir.Scene(plumes=jet), azimuth, elevation, jaxir.MWIR, rays=rays)[0]

    shape = np.array([0.2, 0.22, 30.0, 0.6])
    size = np.array([1.0, *shape[1:]])
    step = np.diag(0.05 * size)
    expected = [float(intensity(shape + h, 65536) - intensity(shape - h, 65536)) / (2 * h.sum()) for h in step]
    scale = float(intensity(shape, 8192)) / size
    assert expected[0] < -0.5 * scale[0]
    np.testing.assert_allclose(np.asarray(jax.grad(intensity)(shape, 8192)) / scale, expected / scale, atol=0.05)


def test_the_place_of_an_oblique_jet_has_no_slope_in_either_precision(precision):
    """Nothing is behind it and rays move with it; whatever the compiler computes anew, nothing is lost."""
    where = jnp.array([0.1, -0.2, 0.0]), jnp.array([-1.0, 0.15, 0.1])

    @partial(jax.value_and_grad, argnums=(0, 1, 2))
    def intensity(nozzle, axis, diameter):
        jet = jaxir.JetPlume(nozzle, axis, diameter, 1100.0, 250.0, jaxir.GrayGas(0.5), length=20.0)
        return jaxir.plume_intensity(jaxir.Scene(plumes=jet), 30.0, 20.0, jaxir.MWIR, rays=32768)[0]

    value, (nozzle, axis, diameter) = intensity(*where, 0.5)
    assert np.isfinite(axis).all() and float(np.abs(nozzle).max()) < 1e-5 * float(value)
    more, less = (float(intensity(*where, 0.5 + step)[0]) for step in (0.005, -0.005))
    np.testing.assert_allclose(diameter, (more - less) / 0.01, rtol=0.01)


def test_the_shape_of_a_jet_beside_cells_has_the_slopes_of_an_image(x64):
    """Cells do not move with the rays of a box: slopes of jets before them were 2.5 to 6 times too large."""
    cells = jaxir.Grid((-4.0, -0.6, -0.6), (4.0, 0.6, 1.2), (1, 2, 1))
    cloud = jaxir.GridPlume(cells, 900.0, jaxir.GrayGas(np.array([0.1, 2.0]).reshape(1, 2, 1, 1)))

    @jax.jit
    @jax.value_and_grad
    def intensity(shape):
        where = (0.2, 0.1, 0.0), (-1.0, 0.1, 0.0)
        jet = jaxir.JetPlume(*where, 0.6, 1400.0, 250.0, jaxir.GrayGas(0.5), spreading=shape[0], length=shape[1])
        return jaxir.plume_intensity(jaxir.Scene(plumes=(jet, cloud)), 60.0, 20.0, jaxir.MWIR, rays=8192)[0]

    shape = np.array([0.2, 12.0])
    step = np.diag(0.05 * shape)
    expected = [(intensity(shape + h)[0] - intensity(shape - h)[0]) / (2 * h.sum()) for h in step]
    np.testing.assert_allclose(intensity(shape)[1], expected, rtol=0.1)


def test_a_pixel_inside_a_homogeneous_box_has_no_error(precision):
    plume = gray_box((2.0, 2.0, 2.0), 0.7)
    black = float(jaxir.band_radiance(plume.temperature[0, 0, 0], gray_nodes((jaxir.MWIR,)))[0])
    image = jaxir.render(jaxir.Scene(plumes=plume), jaxir.orthographic_camera(0.0, 0.0, 0.02, (48, 64)), jaxir.MWIR)
    rtol = {"float32": 3e-6, "float64": 1e-9}[precision]
    np.testing.assert_allclose(image.radiance, black * -np.expm1(-0.7 * 2.0), rtol=rtol)
    assert float(image.standard_error.max()) <= 3e-7 * black


def body_and_gas(size, place, skin, emissivity, box, coefficient, gas, around, sun):
    """A box of skin, one of gas, a sky and a beam from in front: one structure, drawn in three bands."""
    mesh, coefficient = box_mesh(size, place), np.broadcast_to(coefficient, (4, 3, 5, 1))
    beam, sky = jaxir.ParallelSource((-1.0, 0.0, 0.0), sun), jaxir.BlackbodyBackground(around)
    surface = jaxir.Skin(mesh, skin, jaxir.Lambert(emissivity))
    return jaxir.Scene(surface, gray_box(box, coefficient, temperature=gas), beam, sky)


def look_from(azimuth, elevation, pixel, scene):
    """What is black reflects nothing: no light of the sky is looked for."""
    camera, method = jaxir.orthographic_camera(azimuth, elevation, pixel, (32, 32)), jaxir.Method(direct=None)
    return jaxir.render(scene, camera, BANDS, samples=2, method=method).radiance


def black_in_bands(temperature):
    return np.asarray(jaxir.band_radiance(jnp.asarray(temperature), gray_nodes(BANDS)))


@pytest.mark.parametrize("view", [(0.0, 0.0), (35.0, 20.0), (180.0, -70.0), (90.0, 90.0)])
def test_an_isothermal_scene_is_a_blackbody(view, precision):
    coefficient = np.linspace(0.0, 4.0, 60).reshape(4, 3, 5, 1)
    body, box = ((0.6, 0.8, 0.7), (0.3, 0.0, 0.0)), (3.0, 1.0, 1.0)
    seen = look_from(*view, 0.15, body_and_gas(*body, 700.0, 1.0, box, coefficient, 700.0, 700.0, 0.0))
    rtol = {"float32": 1e-6, "float64": 1e-12}[precision]
    np.testing.assert_allclose(seen, np.broadcast_to(black_in_bands(700.0), seen.shape), rtol=rtol)


def board_and_gas(x, emissivity, skin, gas, coefficient, width=1.0, sun=0.0):
    """A board as wide as what is seen, with its front in the plane x, and gas about the origin."""
    board = (0.1, 0.8, 0.8), (x - 0.05, 0.0, 0.0)
    return body_and_gas(*board, skin, emissivity, (1.0, width, width), coefficient, gas, 3.0, sun)


def test_skin_behind_the_plume_is_dimmed_and_skin_in_front_hides_it(precision):
    kappa, shape = 0.8, (32, 32, 3)
    black = black_in_bands(500.0)
    rtol = {"float32": 2e-6, "float64": 1e-9}[precision]
    dimmed = look_from(0.0, 0.0, 0.025, board_and_gas(-2.0, 1.0, 500.0, 3.0, kappa))
    np.testing.assert_allclose(dimmed, np.broadcast_to(black * np.exp(-kappa), shape), rtol=rtol)
    hidden = look_from(0.0, 0.0, 0.025, board_and_gas(2.0, 1.0, 500.0, 2000.0, kappa))
    np.testing.assert_allclose(hidden, np.broadcast_to(black, shape), rtol=rtol)


def test_the_plume_shades_the_skin_from_the_sun(precision):
    image = look_from(0.0, 0.0, 0.025, board_and_gas(-2.0, 0.2, 3.0, 3.0, 0.6, width=4.0, sun=50.0))
    np.testing.assert_allclose(image, np.full((32, 32, 3), 0.8 / np.pi * 50.0 * np.exp(-2 * 0.6)), rtol=1e-5)


def test_the_air_dims_and_glows_over_everything():
    camera = jaxir.orthographic_camera(0.0, 0.0, 1.5 / 48, (48, 48))
    clear, hazy = (
        jaxir.render(sunlit(plate(emissivity=1.0), 0.0, 0.0, *air), camera, BANDS, samples=18)
        for air in ((1.0, 0.0), ([0.9, 0.8, 0.7], [0.1, 0.2, 0.3]))
    )
    np.testing.assert_allclose(
        hazy.radiance, np.asarray(clear.radiance) * [0.9, 0.8, 0.7] + np.array([0.1, 0.2, 0.3], np.float32), rtol=1e-5
    )
    np.testing.assert_allclose(hazy.empty[0, 0], [0.1, 0.2, 0.3], rtol=1e-6)
    np.testing.assert_allclose(
        hazy.radiant_intensity(), np.asarray(clear.radiant_intensity()) * [0.9, 0.8, 0.7], rtol=1e-4
    )


VIEWS = [(0.0, 0.0), (37.0, 12.0), (200.0, -50.0), (90.0, 90.0)]


def box_of_sides():
    return jaxir.Scene(jaxir.Skin(box_mesh((1.0, 2.0, 0.5)), np.linspace(300.0, 400.0, 12), jaxir.Lambert(0.7)))


def test_signature_agrees_with_the_sum_over_faces():
    scene = box_of_sides()
    table = jaxir.signature(scene, VIEWS, BANDS, shape=(96, 96), samples=8)
    for (azimuth, elevation), got, error in zip(VIEWS, table.intensity, table.standard_error, strict=True):
        exact = jaxir.unoccluded_intensity(scene, azimuth, elevation, BANDS)
        assert (np.abs(got - exact) < 4 * error + 1e-5 * exact).all()
        assert (error < 2e-3 * exact).all()


@pytest.mark.parametrize("roughness", [0.3, 0.005])
def test_faces_that_look_away_are_not_asked_what_they_send(roughness):
    """Of a closed body half do, some straight and some where the loss of a rough conductor has no value."""
    vertices, faces = np.array(trimesh.creation.icosphere(4).vertices), trimesh.creation.icosphere(4).faces
    ball = jaxir.Mesh(vertices.astype(np.float32), faces)
    aspects = [(0.0, 0.0), (90.0, 0.0), (90.0, -25.0), (190.0, -25.0)]

    def total(roughness, azimuth, elevation):
        skin = jaxir.Skin(ball, 300.0, jaxir.RoughConductor(1.5, 7.0, roughness))
        return jaxir.unoccluded_intensity(jaxir.Scene(skin), azimuth, elevation, jaxir.LWIR)[0]

    each = np.asarray([jax.value_and_grad(total)(roughness, *aspect) for aspect in aspects])
    assert np.isfinite(each).all()
    np.testing.assert_allclose(each[:, 0], each[:, 0].mean(), rtol=3e-4)  # of a ball


def test_a_glint_that_a_facet_sends_is_found():
    """Of a smooth ball of facets in the sun one or two shine, smaller than a pixel at an aspect low above them."""
    mesh = trimesh.creation.icosphere(4)
    ball = jaxir.Mesh(np.array(mesh.vertices, np.float32), mesh.faces)
    skin = jaxir.Skin(ball, 200.0, jaxir.RoughConductor(1.5, 7.0, 0.005))
    sun = jaxir.ParallelSource((-0.556670, -0.321394, -0.766044), 100.0)
    scene, views = jaxir.Scene(skin, sources=(sun,)), [(244.5, -50.9), (200.0, -20.0), (205.0, -20.0)]
    exact = np.stack([jaxir.unoccluded_intensity(scene, *view, jaxir.MWIR) for view in views])
    table = jaxir.signature(scene, views, jaxir.MWIR)
    assert (np.abs(table.intensity - exact) < 5 * table.standard_error).all()
    np.testing.assert_allclose(table.intensity, exact, rtol=0.02)


def test_a_glint_of_the_suns_disc_is_found_to_the_tolerance():
    """Where all directions are drawn from the brdf next to none of a few rays meets the disc, and none varies."""
    ball, half = trimesh.creation.icosphere(4), 4.65e-3
    away = np.array([np.cos(2.44), np.sin(2.44), 0.0])
    mesh = jaxir.Mesh(np.array(ball.vertices, np.float32), ball.faces)
    skin = jaxir.Skin(mesh, 200.0, jaxir.RoughConductor(1.5, 7.0, 0.05))
    point = jaxir.Scene(skin, sources=jaxir.ParallelSource(-away, 100.0))
    exact = float(jaxir.unoccluded_intensity(point, 0.0, 0.0, jaxir.MWIR)[0])
    disc = jaxir.SphereSource(1e4 * away, 1e4 * np.sin(half), 100.0 / (np.pi * np.sin(half) ** 2))
    scene, camera = jaxir.Scene(skin, sources=disc), jaxir.orthographic_camera(0.0, 0.0, 2.2 / 48, (48, 48))
    table = jaxir.signature(scene, [(0.0, 0.0)], jaxir.MWIR, rtol=0.03)
    image = jaxir.render(scene, camera, jaxir.MWIR, rtol=0.03)
    for found in (table.intensity[0, 0], image.radiant_intensity()[0]):
        np.testing.assert_allclose(found, exact, rtol=0.09)


def test_signature_from_a_range_sees_what_an_image_from_there_sees():
    scene = box_of_sides()
    table = jaxir.signature(scene, VIEWS, BANDS, distance=20.0, shape=(96, 96), samples=8)
    camera = jaxir.perspective_camera(*VIEWS[1], 20.0, 2.6 / 128 / 20.0, (128, 128))
    image = jaxir.render(scene, camera, BANDS, samples=8)
    both = np.hypot(table.standard_error[1], image.intensity_error())
    assert (np.abs(table.intensity[1] - image.radiant_intensity()) < 4 * both + 1e-4).all()


def test_repeats_with_the_same_key_and_differs_with_another():
    scene, camera = jaxir.Scene(plate()), jaxir.orthographic_camera(20.0, 10.0, 0.11, (16, 16))
    first, again = (jaxir.render(scene, camera, jaxir.MWIR, samples=4).radiance for _ in range(2))
    other = jaxir.render(scene, camera, jaxir.MWIR, samples=4, key=jax.random.key(7)).radiance
    assert (first == again).all()
    assert not (first == other).all()


def test_the_standard_error_is_the_scatter_over_keys():
    scene, camera = jaxir.Scene(plate()), jaxir.orthographic_camera(20.0, 10.0, 0.11, (16, 16))
    images = [jaxir.render(scene, camera, jaxir.MWIR, samples=4, key=jax.random.key(k)) for k in range(64)]
    scatter = np.var([float(i.radiant_intensity()[0]) for i in images], ddof=1)
    claimed = np.mean([float(i.intensity_error()[0]) ** 2 for i in images])
    assert 0.6 < scatter / claimed < 1.55  # chi-squared of 63 degrees of freedom: .1 % to 99.9 %


@pytest.mark.parametrize("width", [0.5, 0.9])
def test_the_error_of_a_target_in_one_pixel_is_surely_told(width):
    """One difference of its two sets of points is near 0 by chance: a quarter of the keys erred thrice as much."""
    corner = width / 2 * np.array([[0.0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]])
    scene = jaxir.Scene(jaxir.Skin(jaxir.Mesh(corner, [[0, 1, 2], [0, 2, 3]]), 500.0, jaxir.Lambert(0.9)))
    camera = jaxir.orthographic_camera(13, 7, 1.0, (5, 5))
    keys = jax.random.split(jax.random.key(1), 100)
    images = [jaxir.render(scene, camera, [jaxir.MWIR], samples=72, key=key) for key in keys]
    found, told = (np.array([float(x[0]) for x in xs]) for xs in zip(*map(with_error, images), strict=True))
    off = np.abs(found - found.mean())
    assert np.mean(off > 3 * told) < 0.03
    assert 0.8 < np.sqrt(np.mean(told**2)) / found.std() < 2.0


def with_error(image):
    return image.radiant_intensity(), image.intensity_error()


def test_the_error_of_what_is_faint_is_not_lost():
    """Squares of 1e-25 are none in single precision."""
    image = jaxir.render(
        jaxir.Scene(plate()), jaxir.orthographic_camera(20.0, 0.0, 0.09, (16, 16)), jaxir.MWIR, samples=4
    )
    faint = eqx.tree_at(lambda i: i.standard_error, image, image.standard_error * 1e-25)
    np.testing.assert_allclose(faint.intensity_error() * 1e25, image.intensity_error(), rtol=1e-5)


@pytest.mark.parametrize("brdf", [jaxir.Lambert(0.4), jaxir.RoughConductor(1.5, 7.0, 0.2)])
@pytest.mark.parametrize("seen", [True, False])
def test_faces_reflect_what_surrounds_them(brdf, seen):
    """A furnace: with surroundings as warm as itself skin looks black."""
    around = jaxir.BlackbodyBackground(300.0)
    lights = {"background": around} if seen else {"sources": (around,)}
    scene = jaxir.Scene(jaxir.Skin(box_mesh(), 300.0, brdf), **lights)
    black = jaxir.Scene(jaxir.Skin(box_mesh(), 300.0, jaxir.Lambert(1.0)))
    got, known = (jaxir.unoccluded_intensity(s, 40.0, 25.0, BANDS) for s in (scene, black))
    np.testing.assert_allclose(got, known, rtol=1e-4)
    uneven = jaxir.Scene(black.skin, background=jaxir.ElevationTable([-90.0, 90.0], [1.0, 2.0]))
    with pytest.raises(ValueError, match="got a ElevationTable, expected uniform surroundings"):
        jaxir.unoccluded_intensity(uneven, 40.0, 25.0, BANDS)


def test_a_graphics_card_would_draw_the_same_image(monkeypatch):
    """In its order of computing; an image of one tile has the same random numbers there."""
    body = jaxir.Skin(box_mesh((1.0, 1.2, 0.8), (0.3, 0.0, 0.0)), 300.0, jaxir.Lambert(0.6))
    lights = (
        jaxir.ParallelSource((-0.6, 0.0, -0.8), 50.0),
        jaxir.DiscSource((0.0, 0.0, 3.0), (0.0, 0.0, -1.0), 1.0, 80.0),
    )
    scene = jaxir.Scene(body, gray_box((2.0, 1.0, 1.0), 0.4), lights, jaxir.BlackbodyBackground(280.0))
    camera = jaxir.orthographic_camera(30.0, 20.0, 0.2, (16, 16))
    drawn = []
    for backend, bands in (("cpu", 1), ("gpu", 2)):  # of another shape: compiled anew
        monkeypatch.setattr(jax, "default_backend", lambda backend=backend: backend)
        asked = (jaxir.MWIR, jaxir.LWIR)[:bands]
        image = jaxir.render(scene, camera, asked, samples=4, method=jaxir.Method(bounces=2))
        drawn.append(np.asarray(image.radiance)[..., 0])
    assert np.ptp(drawn[0]) > 1.0
    np.testing.assert_allclose(drawn[1], drawn[0], rtol=1e-5)
