"""Plots show the numbers they are given; without matplotlib they say what to install."""

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


def test_error_bars_are_as_high_as_the_total():
    one, zero = jnp.asarray([[1.0, 2.0]]), jnp.zeros((1, 2))
    intensity = jnp.asarray([[100.0, 50.0]])
    known = jaxir.ErrorBudget(intensity, one, 3 * one, zero, one, zero, ("MWIR", "LWIR"))
    open_ = jaxir.ErrorBudget(intensity, one, None, jnp.asarray([[jnp.inf, 0.0]]), None, zero, ("MWIR", "LWIR"))
    axis = plot.error_bars({"a": known, "b": open_}).axes[0]
    assert [text.get_text() for text in axis.get_xticklabels()] == ["a, MWIR", "a, LWIR", "b, MWIR", "b, LWIR"]
    height = np.sum([[bar.get_height() for bar in part] for part in axis.containers], axis=0)
    np.testing.assert_allclose(height[:2], 100 * known.total[0] / intensity[0], rtol=1e-6)
    np.testing.assert_allclose(height[2:], [2.0, 8.0], rtol=1e-6)  # what is left of them
    said = [text.get_text() for text in axis.texts]
    assert said == [
        "",
        "",
        "spectral: not known, truncation: inf, bounces: not known",
        "spectral: not known, bounces: not known",
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
        axis = plot.scene_view(jaxir.Scene(plate(), plume, (sun, lamp)), {"side": camera}).axes[0]
        assert [text.get_text() for text in axis.get_legend().get_texts()] == ["skin, 2 faces", label]
        assert {text.get_text() for text in axis.texts} == {"side, 1000 m", "ParallelSource"}
        assert len(axis.collections) >= 3 and axis.get_xlim()[1] - axis.get_xlim()[0] >= 8.0


def test_without_matplotlib_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(ImportError, match=r'plots need matplotlib: pip install "jaxir\[plot\]"'):
        plot.radiance_image(image((1.0, 2.0)))
