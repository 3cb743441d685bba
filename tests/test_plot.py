"""Plots show the numbers they are given; without matplotlib they say what to install."""

import dataclasses
import io
import sys

import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest

import jaxir
from jaxir import plot
from jaxir.fit import Fit, uncertainty
from jaxir.imaging import Outcome
from tests.scenes import gray_box, plate


def image(value, bands=("MWIR", "LWIR")):
    radiance = jnp.broadcast_to(jnp.asarray(value, jnp.float32), (4, 6, len(bands)))
    camera = jaxir.orthographic_camera(0.0, 0.0, 0.5, (4, 6))
    return jaxir.Image(radiance, 0 * radiance, 0 * radiance[:1, :1], camera, bands, jnp.int32(2), Outcome.samples_taken)


def test_images_share_a_scale_per_band():
    figure = plot.radiance_panels({"dim": image((1.0, 5.0)), "bright": image((1e3, 6.0))})
    shown = [axis.images[0] for axis in figure.axes if axis.images]
    assert [(s.norm.vmin, s.norm.vmax) for s in shown[::2]] == [(1.0, 1e3)] * 2  # logarithmic, of both images
    assert [(s.norm.vmin, s.norm.vmax) for s in shown[1::2]] == [(5.0, 6.0)] * 2
    assert shown[0].get_extent() == [-1.5, 1.5, -1.0, 1.0]
    with pytest.raises(ValueError, match="images: got 2 of different bands"):
        plot.radiance_panels({"a": image((1.0, 2.0)), "b": image((1.0,), ("SWIR",))})
    plot.radiance_image(image((0.0, -1.0))).canvas.draw()


def test_temperatures_and_contrasts_have_their_scales():
    scene = jaxir.Scene(plate(emissivity=1.0, temperature=420.0), background=jaxir.BlackbodyBackground(280.0))
    camera = jaxir.orthographic_camera(0.0, 0.0, 0.2, (8, 8))
    found = jaxir.render(scene, camera, (jaxir.MWIR, jaxir.LWIR), samples=2)
    for shown in (axis.images[0] for axis in plot.radiance_image(found, quantity="temperature").axes if axis.images):
        assert [float(shown.get_array().min()), float(shown.get_array().max())] == pytest.approx([280, 420], rel=1e-4)
        assert shown.norm.vmin == pytest.approx(280, rel=1e-4)
    colder = dataclasses.replace(found, empty=found.empty + 100)
    shown = plot.radiance_image(colder, quantity="contrast").axes[0].images[0]
    assert shown.norm.vmin == -shown.norm.vmax and shown.get_cmap().name == "RdBu_r"
    with pytest.raises(ValueError, match="got temperature of an image without nodes"):
        plot.radiance_image(image((1.0, 2.0)), quantity="temperature")


def test_a_sequence_is_a_strip_or_a_film():
    from PIL import Image as Picture

    frames = {f"second {i}": image((1.0 + i, 5.0)) for i in range(14)}
    strip = plot.film_strip(frames)
    shown = [axis for axis in strip.axes if axis.images and axis.get_visible()]
    assert len(shown) == 24 and len({(a.images[0].norm.vmin, a.images[0].norm.vmax) for a in shown}) == 2
    assert any("second 13" in axis.get_title() for axis in shown)
    film = Picture.open(io.BytesIO(plot.film(dict(list(frames.items())[:3]), seconds=0.25)))
    assert film.format == "GIF" and film.n_frames == 3 and film.info["duration"] == 250
    with pytest.raises(ValueError, match="images: got 2 of 2 kinds"):
        plot.film_strip({"a": image((1.0, 2.0)), "b": image((1.0,), ("SWIR",))})
    with pytest.raises(ValueError, match="seconds: got 0"):
        plot.film(frames, seconds=0)


def test_images_of_different_pixels_are_as_large_as_they_are():
    fine, wide = image((1.0, 5.0)), image((2.0, 6.0))
    wide = dataclasses.replace(wide, camera=jaxir.orthographic_camera(0.0, 0.0, 2.0, (4, 6)))
    for figure in (plot.film_strip({"wide": wide, "fine": fine}), plot.radiance_panels({"wide": wide, "fine": fine})):
        shown = [axis for axis in figure.axes if axis.images and axis.get_visible()]
        assert sorted({(*axis.get_xlim(), *axis.get_ylim()) for axis in shown}) == [(-6, 6, -4, 4), (-1.5, 1.5, -1, 1)]


def test_frames_of_a_film_say_how_large_they_are(monkeypatch):
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    drawn, draw = [], FigureCanvasAgg.draw
    monkeypatch.setattr(
        FigureCanvasAgg, "draw", lambda self: (drawn.append(self.figure.axes[0].get_xlim()), draw(self))[1]
    )
    wide = dataclasses.replace(image((2.0, 6.0)), camera=jaxir.orthographic_camera(0.0, 0.0, 2.0, (4, 6)))
    plot.film({"fine": image((1.0, 5.0)), "wide": wide})
    assert drawn[-2:] == [(-1.5, 1.5), (-6.0, 6.0)]


def signature(azimuth, elevation, value):
    azimuth, elevation, value = (jnp.asarray(a, jnp.float32) for a in (azimuth, elevation, value))
    return jaxir.Signature(azimuth, elevation, value[:, None], 0 * value[:, None], ("MWIR",), 0 * value[:, None])


def test_a_signature_closes_its_circle_and_marks_what_is_negative():
    around = np.arange(0.0, 360.0, 30.0)
    figure = plot.polar_signature(signature(around, 0 * around, 5 + 10 * np.cos(np.deg2rad(around))))
    lines = figure.axes[0].get_lines()
    angle, radius = lines[0].get_data()
    assert len(lines) == 2 and angle[-1] == pytest.approx(2 * np.pi) and radius[-1] == radius[0] == 15
    assert np.nanmax(lines[1].get_ydata()) == pytest.approx(5, rel=1e-5)  # of -5 at azimuth 180
    half = plot.polar_signature(signature([0.0, 0.0, 0.0], [-30.0, 90.0, 0.0], [1.0, 2.0, 3.0])).axes[0].get_lines()[0]
    np.testing.assert_allclose(half.get_xdata(), np.deg2rad([-30, 0, 90]))


def test_states_are_curves_of_a_panel_for_each_band():
    angle = np.tile(np.arange(0.0, 360.0, 30.0), 2)
    table = signature(angle, 0 * angle, np.repeat([1.0, 2.0], 12))
    table = dataclasses.replace(table, axes=("mach",), state=jnp.asarray(np.repeat([[0.6], [0.9]], 12, axis=0)))
    (axis,) = plot.polar_signature(table).axes
    assert [line.get_label() for line in axis.get_lines()] == ["mach 0.6", "mach 0.9"]
    assert [line.get_ydata().tolist() for line in axis.get_lines()] == [[1.0] * 13, [2.0] * 13]


def test_a_spectrum_integrates_to_the_band():
    nodes = jaxir.resolved_nodes((jaxir.MWIR, jaxir.LWIR), width=200.0, points=2, pair_points=2)
    value = np.asarray(jaxir.band_radiance(jnp.asarray(800.0), nodes))
    line = plot.spectrum(nodes, {"black": value}).axes[0].get_lines()[0]
    wavenumber, density = 1e4 / line.get_xdata(), line.get_ydata()
    total = np.nansum(density[:-1] * np.diff(wavenumber))
    assert total == pytest.approx(float(np.sum(nodes.in_band(jnp.asarray(value)))), rel=1e-4)
    assert np.isnan(density).sum() == 2  # the gap between the bands
    with pytest.raises(ValueError, match="radiance 'x': got shape"):
        plot.spectrum(nodes, {"x": value[:-1]})
    others = dataclasses.replace(nodes, weight=2 * nodes.weight)
    with pytest.raises(ValueError, match="nodes: got weights of 2 to 2 in bins, expected 1 in each"):
        plot.spectrum(others, {"x": value})


def test_error_bars_are_as_high_as_the_total():
    one, zero = jnp.asarray([[1.0, 2.0]]), jnp.zeros((1, 2))
    intensity = jnp.asarray([[100.0, 50.0]])
    known = jaxir.ErrorBudget(intensity, one, 3 * one, zero, zero, one, zero, ("MWIR", "LWIR"))
    open_ = jaxir.ErrorBudget(intensity, one, None, zero, jnp.asarray([[jnp.inf, 0.0]]), None, zero, ("MWIR", "LWIR"))
    axis = plot.error_bars({"a": known, "b": open_}).axes[0]
    assert [text.get_text() for text in axis.get_xticklabels()] == ["a, MWIR", "a, LWIR", "b, MWIR", "b, LWIR"]
    height = np.sum([[bar.get_height() for bar in part] for part in axis.containers], axis=0)
    np.testing.assert_allclose(height[:2], 100 * known.total[0] / intensity[0], rtol=1e-6)
    np.testing.assert_allclose(height[2:], [2.0, 8.0], rtol=1e-6)  # what is left of them
    said = [text.get_text() for text in axis.texts]
    assert said == [
        "",
        "",
        "spectral: not known\ntruncation: inf\nbounces: not known",
        "spectral: not known\nbounces: not known",
    ]


def test_a_fit_s_report_names_its_parameters():
    jacobian = jnp.asarray([[3.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 1.0, 0.0]])  # the third is not determined
    found = uncertainty(("T", "e", "x"), ("K", "", ""), jnp.asarray([600.0, 0.5, 1.0]), jnp.ones(3), jacobian)
    residual = (jnp.linspace(-2, 2, 12).reshape(6, 2),)
    zero = jnp.zeros(())
    fit = Fit(
        scene=jaxir.Scene(plate()),
        uncertainty=found,
        reach=jnp.stack([found.value, found.value]),
        at_bounds=(),
        bands=(("MWIR", "LWIR"),),
        robust=float("inf"),
        residual=residual,
        prior_residual={},
        chi_squared=zero + 9,
        degrees_of_freedom=10,
        sampling_error=jnp.zeros(3),
        sampling_residual=(jnp.zeros((1, 6, 2)),),
        steps=5,
        starts=jnp.zeros(1),
        rounds=1,
        samples=((2, 2),),
        effective_share=zero + 1,
        drifted=False,
        solver_result=optx.RESULTS.successful,
    )
    values, residuals, correlations = plot.fit_report(fit).axes[:3]
    assert [text.get_text().split("\n")[0] for text in values.get_yticklabels()] == ["T", "e", "x"]
    assert len([p for p in values.patches if p.get_width() > 0]) == 2
    assert "converged, chi-squared 9 for 10 degrees" in residuals.get_title() and correlations.images


def test_a_scene_is_drawn_with_all_that_it_holds():
    sun, lamp = (
        jaxir.ParallelSource((0.0, 0.0, -1.0), 1.0),
        jaxir.DiscSource((9.0, 0.0, 0.0), (-1.0, 0.0, 0.0), 1.0, 1.0),
    )
    camera = jaxir.perspective_camera(90.0, 0.0, 1000.0, 1e-3, (4, 8))
    jet = jaxir.JetPlume((-1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), 0.5, 900.0, 300.0, jaxir.GrayGas(1.0))
    for plume, label in ((jet, "jet"), (gray_box((1.0, 2.0, 3.0), 1.0), "plume, 4 x 3 x 5 cells")):
        figure = plot.scene_view(jaxir.Scene(plate(), plume, (sun, lamp)), {"side": camera})
        axis = figure.axes[0]
        assert [text.get_text() for text in figure.legends[0].get_texts()] == ["skin, 2 faces", label]
        assert {text.get_text() for text in axis.texts} == {"side, 1000 m", "ParallelSource"}
        assert len(axis.collections) >= 3 and axis.get_xlim()[1] - axis.get_xlim()[0] >= 8.0


def test_faces_have_the_colour_of_their_part_or_temperature():
    two = jaxir.Skin(plate().mesh, [300.0, 600.0], jaxir.Lambert(0.5), [1, 3], ("none", "wing", "gone", "fin"))
    for colour, axes in (("part", 1), ("temperature", 2)):
        figure = plot.scene_view(jaxir.Scene(two), colour=colour)
        figure.canvas.draw()
        first, second = figure.axes[0].collections[0].get_facecolors()
        assert len(figure.axes) == axes and not np.allclose(first, second)
    names = [text.get_text() for text in plot.scene_view(jaxir.Scene(two)).legends[0].get_texts()]
    assert names == ["wing, 1 faces", "fin, 1 faces"]
    with pytest.raises(ValueError, match="colour: got 'red', expected part or temperature"):
        plot.scene_view(jaxir.Scene(two), colour="red")


def test_an_image_says_band_aspect_range_and_quantity():
    figure = plot.radiance_panels({"dim": image((1.0, 5.0))}, quantity="contrast", scale="linear", limits=(0.0, 9.0))
    axis = figure.axes[0]
    assert axis.get_title() == "MWIR, dim\nazimuth 0°, elevation 0°, from afar"
    assert axis.get_xlabel() == "to the right [m]" and axis.get_ylabel() == "up [m]"
    assert (axis.images[0].norm.vmin, axis.images[0].norm.vmax) == (0.0, 9.0)
    assert "that without the scene" in figure.get_suptitle()
    near = jaxir.perspective_camera(90.0, 30.0, 5000.0, 1e-5, (4, 6))
    seen = plot.radiance_image(dataclasses.replace(image((1.0, 5.0)), camera=near)).axes[0].get_title()
    assert seen == "MWIR\nazimuth 90°, elevation 30°, 5 km"
    for options, message in (
        ({"quantity": "power"}, "quantity: got 'power', expected radiance, contrast, temperature"),
        ({"scale": "dB"}, "scale: got 'dB', expected auto, log, linear"),
        ({"limits": "mine"}, "limits: got 'mine', expected shared, own"),
        ({"limits": (2.0, 1.0)}, r"limits: got \(2.0, 1.0\), expected the lower value first"),
    ):
        with pytest.raises(ValueError, match=message):
            plot.radiance_image(image((1.0, 5.0)), **options)
    with pytest.raises(ValueError, match="scale: got log for values up to 0, expected some above 0"):
        plot.radiance_image(image((0.0, 0.0)), scale="log")


def test_polar_plots_have_the_nose_on_top_and_bands_of_two_errors():
    around = np.arange(0.0, 360.0, 30.0)
    table = signature(around, 0 * around, 100 + 0 * around)
    table = dataclasses.replace(table, standard_error=0.05 * table.intensity)
    for scale, low, high in (("log", 90, 110), ("linear", 90, 110), ("dB", 10 * np.log10(90), 10 * np.log10(110))):
        figure = plot.polar_signature(table, scale=scale)
        axis = figure.axes[0]
        radius = axis.collections[0].get_paths()[0].vertices[:, 1]
        assert (radius.min(), radius.max()) == pytest.approx((max(low, 0), high), rel=0.06)
        assert axis.get_theta_offset() == pytest.approx(np.pi / 2) and axis.get_theta_direction() == 1
        assert len(figure.legends) == 1 and axis.get_legend() is None  # outside
    with pytest.raises(ValueError, match="scale: got 'auto', expected log, linear, dB"):
        plot.polar_signature(table, scale="auto")


def test_components_are_drawn_with_their_sum():
    whole = image((4.0, 8.0))
    share = jnp.asarray([0.75, 0.25, 0.0])[None, None, :, None]
    split = dataclasses.replace(whole, components=("skin", "Sun", "plume"), parts=share * whole.radiance[:, :, None])
    axis = plot.component_bars(split).axes[0]
    np.testing.assert_allclose([bar.get_width() for bar in axis.patches], [18.0, 6.0, 0.0, 24.0])  # of 6 m2
    assert [text.get_text() for text in axis.get_yticklabels()] == ["skin", "Sun", "plume", "sum"]
    ramp = dataclasses.replace(split, parts=split.parts * jnp.arange(6.0)[None, :, None, None])
    titles = [axis.get_title().split("\n")[0] for axis in plot.component_panels(ramp).axes]
    assert titles[:6] == ["MWIR, all", "LWIR, all", "MWIR, skin", "LWIR, skin", "MWIR, Sun", "LWIR, Sun"]
    table = signature([0.0, 30.0, 0.0], [0.0, 0.0, 40.0], [4.0, 8.0, 9.0])
    parts = jnp.asarray([0.75, 0.25])[None, :, None] * table.intensity[:, None]
    table = dataclasses.replace(table, components=("skin", "Sun"), parts=parts)
    lines = plot.component_signature(table).axes[0].get_lines()
    np.testing.assert_allclose(lines[0].get_ydata(), [4.0, 8.0])
    np.testing.assert_allclose(lines[1].get_ydata() + lines[2].get_ydata(), [4.0, 8.0])
    own = {name: jnp.tile(getattr(table, name), 2) for name in ("azimuth", "elevation")}
    own |= {name: jnp.concatenate([x, 2 * x]) for name, x in (("intensity", table.intensity), ("parts", table.parts))}
    own |= {name: jnp.zeros((6, 1)) for name in ("standard_error", "truncation")}
    state = jnp.repeat(jnp.asarray([[300.0], [600.0]]), 3, axis=0)
    axes = plot.component_signature(dataclasses.replace(table, **own, axes=("t",), state=state)).axes
    assert [axis.get_title() for axis in axes] == ["t 300", "t 600"]
    np.testing.assert_allclose([axis.get_lines()[0].get_ydata() for axis in axes], [[4.0, 8.0], [8.0, 16.0]])
    for draw in (
        lambda: plot.component_panels(whole),
        lambda: plot.component_signature(signature([0.0], [0.0], [1.0])),
    ):
        with pytest.raises(ValueError, match="parts: got none, expected"):
            draw()


def test_without_matplotlib_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(ImportError, match=r'plots need matplotlib: pip install "jaxir\[plot\]"'):
        plot.radiance_image(image((1.0, 2.0)))
