"""Wrong input gets one error that names the field, what was got and what was expected."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxir
from jaxir._arrays import key_or_default
from jaxir._fields import require_counts, require_part
from jaxir.imaging._devices import shared_by
from jaxir.imaging._tolerance import require_rtol
from jaxir.optics.surface import AbstractBrdf

PLATE = ([[0.0, -0.5, -0.5], [0.0, 0.5, -0.5], [0.0, 0.5, 0.5], [0.0, -0.5, 0.5]], [[0, 1, 2], [0, 2, 3]])


def _skin(temperature=300.0, emissivity=0.8, vertices=PLATE[0], faces=PLATE[1], **more):
    return jaxir.Skin(jaxir.Mesh(vertices, faces), temperature, jaxir.Lambert(emissivity), **more)


def _plume(temperature=900.0, coefficient=1.0, spacing=(0.5, 0.5, 0.5), shape=(2, 2, 2)):
    return jaxir.GridPlume(jaxir.Grid((-3.0, -0.5, -0.5), spacing, shape), temperature, jaxir.GrayGas(coefficient))


def _render(scene, camera=None, bands=jaxir.MWIR, **more):
    camera = jaxir.orthographic_camera(0.0, 0.0, 0.1, (4, 4)) if camera is None else camera
    return jaxir.render(scene, camera, bands, **more)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: _skin(temperature=[300.0, 301.0, 302.0]), r"Skin.temperature: got shape \(3,\), expected .*\(2,\)"),
        (lambda: _skin(emissivity=[0.1, 0.2, 0.3]), "Skin.brdf: got parameters of 3 faces, expected 1 or 2"),
        (lambda: _skin(faces=[[0, 1, 4]]), "Mesh.faces: got indices 0 to 4, expected 0 to 3"),
        (lambda: _skin(faces=np.zeros((0, 3), int)), "Mesh.faces: got 0 faces"),
        (lambda: _skin(faces=[[0.0, 1.0, 2.0]]), "Mesh.faces: got float64"),
        (lambda: _skin(vertices=[[0.0, 0.0]]), r"Mesh.vertices: got shape \(1, 2\)"),
        (lambda: _skin(vertices="plate"), "Mesh.vertices: got 'plate', expected a number"),
        (lambda: _skin(part=[0, 1]), "Skin.part: got indices 0 to 1, expected 0 to 0"),
        (lambda: _skin(part=[0]), r"Skin.part: got .* expected integers \(2,\)"),
        (lambda: _plume(temperature=np.ones((2, 2, 3))), r"GridPlume.temperature: got shape \(2, 2, 3\)"),
        (lambda: _plume(shape=(2, 0, 2)), r"Grid.shape: got \(2, 0, 2\)"),
        (lambda: jaxir.Scene(), "Scene: got neither skin nor plume"),
        (lambda: jaxir.orthographic_camera(0.0, 0.0, 0.0, (4, 4)), "pixel: got 0.0, expected finite values > 0"),
        (lambda: jaxir.perspective_camera(0.0, 0.0, -5.0, 1e-3, (4, 4)), "distance: got -5.0"),
        (lambda: jaxir.orthographic_camera(0.0, 0.0, 1.0, (0, 4)), r"Camera.shape: got \(0, 4\)"),
        (lambda: jaxir.UniformBackground([[1.0]]), "UniformBackground.radiance: got shape"),
        (
            lambda: _render(jaxir.Scene(_skin(temperature=-1.0))),
            "Skin.temperature: got -1.0 at index .0., expected finite",
        ),
        (lambda: _render(jaxir.Scene(_skin(temperature=[300.0, np.nan]))), r"Skin.temperature: got nan at index \[1\]"),
        (lambda: _render(jaxir.Scene(_skin(temperature=1e18))), r"Skin.temperature: got 1e.18 .*from 0.001 to 1e.12 K"),
        (lambda: _render(jaxir.Scene(_skin(emissivity=1.2))), r"Lambert.emissivity: got 1.2.*\[0, 1\]"),
        (lambda: _render(jaxir.Scene(plumes=_plume(coefficient=-1.0))), "GrayGas.coefficient: got -1.0"),
        (lambda: _render(jaxir.Scene(plumes=_plume(coefficient=np.inf))), "GrayGas.coefficient: got inf"),
        (lambda: _render(jaxir.Scene(plumes=_plume(spacing=(0.5, 0.0, 0.5)))), r"Grid.spacing: got 0.0 at index \[1\]"),
        (lambda: _render(jaxir.Scene(plumes=_plume(temperature=0.0))), "GridPlume.temperature: got 0.0"),
        (
            lambda: _render(jaxir.Scene(plumes=_plume(coefficient=np.ones((3, 1))))),
            r"GrayGas.coefficient: got shape \(3, 1\)",
        ),
        (
            lambda: _render(jaxir.Scene(_skin(), atmosphere=jaxir.FixedPath(1.5))),
            r"FixedPath.transmittance: got 1.5 .*\[0, 1\]",
        ),
        (
            lambda: _render(jaxir.Scene(_skin(), sources=(jaxir.ParallelSource((0.0, 0.0, -2.0), 1.0),))),
            "ParallelSource.direction: .* expected vectors of length 1",
        ),
        (
            lambda: _render(jaxir.Scene(_skin(), background=jaxir.UniformBackground([1.0, 2.0]))),
            "UniformBackground.radiance: got 2 spectral values, expected 1 or 1",
        ),
        (
            lambda: _render(jaxir.Scene(_skin()), jaxir.perspective_camera(0.0, 0.0, 0.6, 1e-3, (4, 4))),
            "Camera: .* expected less than 1: an eye outside the scene's bounding sphere",
        ),
        (lambda: _render(jaxir.Scene(_skin()), samples=3), "samples: got 3, expected an even number"),
        (
            lambda: _render(jaxir.Scene(_skin()), rtol=0.1, max_samples=0),
            "max_samples: got 0, expected an integer >= 1",
        ),
        (lambda: jaxir.signature(jaxir.Scene(_skin()), [0.0, 1.0], jaxir.MWIR), r"views: got shape \(2,\)"),
        (
            lambda: jaxir.unoccluded_intensity(jaxir.Scene(_skin(), _plume()), 0.0, 0.0, jaxir.MWIR),
            "scene: got a plume or no skin",
        ),
        (lambda: jaxir.plume_intensity(jaxir.Scene(_skin()), 0.0, 0.0, jaxir.MWIR), "scene: got skin"),
        (lambda: _plume(shape=(True, 2, 2)), r"Grid.shape: got \(True, 2, 2\)"),
        (
            lambda: require_counts("Grid.shape", (2.9, 2, 2), "cells", 3),
            r"Grid.shape: got \(2.9, 2, 2\), expected cells, in",
        ),
        (
            lambda: require_counts("Camera.shape", 8, "(rows, columns)", 2),
            "Camera.shape: got 8, expected .rows, columns",
        ),
        (lambda: _skin(vertices=np.add(PLATE[0], 5e6)), "Mesh.vertices: got 5.*, expected .* float32 .* its edges"),
        (
            lambda: _render(jaxir.Scene(plumes=_plume(spacing=(1e-7, 0.5, 0.5)))),
            r"Grid.origin: got -3.0 at index \[0\], expected .* its cells",
        ),
        *(
            (
                lambda d=d: jaxir.signature(jaxir.Scene(_skin()), [[0.0, 0.0]], jaxir.MWIR, distance=d),
                f"distance: got {d}",
            )
            for d in (-3.0, np.nan, 0.0)
        ),
        (lambda: jaxir.unoccluded_intensity(jaxir.Scene(_skin()), np.nan, 0.0, jaxir.MWIR), "azimuth: got nan"),
        (lambda: jaxir.plume_intensity(jaxir.Scene(plumes=_plume()), 0.0, np.nan, jaxir.MWIR), "elevation: got nan"),
        *(
            (build, f"{name}: got None, expected a number")
            for build, name in (
                (lambda: jaxir.Lambert(None), "Lambert.emissivity"),
                (lambda: jaxir.FixedPath(None), "FixedPath.transmittance"),
                (lambda: jaxir.ParallelSource((0.0, 0.0, -1.0), None), "ParallelSource.irradiance"),
                (lambda: jaxir.NarrowBandGas(None, h2o=0.1), "NarrowBandGas.pressure"),
            )
        ),
        (
            lambda: require_part("Skin.brdf", jaxir.GrayGas(1.0), AbstractBrdf, "a brdf"),
            "got a GrayGas, expected a brdf",
        ),
        (
            lambda: require_part("Skin.brdf", jaxir.Lambert, AbstractBrdf, "a brdf"),
            "Skin.brdf: got <class .*, expected",
        ),
        (lambda: require_part("camera", None, jaxir.Camera, "a camera"), "camera: got a NoneType, expected a camera"),
        (lambda: jaxir.Band("", 3.0, 5.0), "Band.name: got '', expected"),
        (lambda: jaxir.Band("MW\nIR", 3.0, 5.0), "Band.name: got 'MW.*nIR', expected a name that prints on one line"),
        (lambda: _skin(part=[0, 1], part_names=("a", "a")), r"Skin.part_names: got .'a', 'a'., expected different"),
        (lambda: key_or_default(1), "key: got 1, expected one key"),
        (
            lambda: key_or_default(jax.random.split(jax.random.key(0))),
            r"key: got key<fry> of shape \(2,\), expected one key",
        ),
        (lambda: shared_by(jax.devices(), 4, "views"), "devices: got a list, expected a mesh of devices"),
        (lambda: require_rtol("x"), "rtol: got 'x', expected > 0"),
        (lambda: require_rtol(None), "rtol: got None, expected > 0"),
    ],
)
def test_the_error_names_field_got_and_expected(build, message):
    with pytest.raises(ValueError, match=message):
        build()


def test_a_key_of_either_kind_draws_the_same():
    drawn = jax.random.uniform(key_or_default(jax.random.PRNGKey(5)))
    assert drawn == jax.random.uniform(jax.random.key(5)) != jax.random.uniform(key_or_default(None))


@pytest.mark.parametrize("compiled", [eqx.filter_jit, jax.jit])
def test_values_known_only_at_run_time_are_refused_too(compiled):
    """One line of the error names the field and what was expected, whatever the compiler wraps around it."""

    @compiled
    def total(temperature):
        return _render(jaxir.Scene(_skin(temperature=temperature))).radiance.sum()

    assert bool(jnp.isfinite(total(jnp.asarray(300.0))))
    with pytest.raises((RuntimeError, ValueError), match=r"(?m)Skin.temperature: expected finite values > 0, .* K$"):
        total(jnp.asarray(-300.0)).block_until_ready()


def test_parts_of_another_precision_are_refused():
    scene, camera = jaxir.Scene(_skin()), jaxir.orthographic_camera(0.0, 0.0, 0.1, (4, 4))
    nodes = jaxir.gray_nodes((jaxir.MWIR,))
    with jax.enable_x64(True):
        own = jaxir.Scene(_skin())
        for part, refused in (
            ("Nodes", lambda: _render(own, bands=nodes)),
            ("Nodes", lambda: jaxir.signature(own, [(0, 0)], nodes, shape=(4, 4))),
            ("Nodes", lambda: own.on(nodes)),
            ("Scene", lambda: _render(scene)),
            ("Camera", lambda: _render(own, camera)),
        ):
            with pytest.raises(ValueError, match=f"^{part}: got float32 arrays, expected float64, the precision in "):
                refused()
