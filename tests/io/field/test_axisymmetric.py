"""Axisymmetric solutions are spread around their axis, and mass fractions become mole fractions."""

import numpy as np
import pytest
import pyvista

from jaxir.io.field import Axes, load_flow
from jaxir.io.scene_file import load_scene

SHAPE = (6, 24, 24)


def profile(place, radius):
    return 300 + 50 * place + 200 * (1 - radius)


def plane(turned=0.0, low=0.0):
    """A half plane, 3 along x and 1 outward, at an angle around x."""
    x, r = np.meshgrid(np.linspace(0, 3, 13), np.linspace(low, 1, 21), indexing="ij")
    points = np.stack([x, r * np.cos(turned), r * np.sin(turned)], axis=-1)
    return with_temperature(pyvista.StructuredGrid(*np.moveaxis(points[:, :, None], -1, 0)))


def wedge(angle, middle):
    """A flat-sided wedge of 3 along x, whose middle plane reaches 1 outward."""
    x, r, side = np.meshgrid(np.linspace(0, 3, 13), np.linspace(0, 1, 21), [-0.5, 0.5], indexing="ij")
    thick = 2 * r * np.tan(angle / 2) * side
    y, z = r * np.cos(middle) - thick * np.sin(middle), r * np.sin(middle) + thick * np.cos(middle)
    return with_temperature(pyvista.StructuredGrid(x, y, z), middle).cast_to_unstructured_grid()


def with_temperature(data, middle=None):
    x, y, z = np.asarray(data.points).T
    radius = np.hypot(y, z) if middle is None else y * np.cos(middle) + z * np.sin(middle)
    data.point_data["T"] = profile(x, radius)
    return data


@pytest.mark.parametrize(
    ("data", "name"),
    [
        (plane(), "plane.vts"),
        (plane(2.0), "plane.vtk"),
        (wedge(np.radians(5), 0.0), "wedge.vtu"),
        (wedge(np.radians(30), -1.0), "wedge.vtu"),
    ],
)
def test_a_half_plane_or_a_wedge_is_spread_around_its_axis(tmp_path, data, name):
    data.save(tmp_path / name)
    flow = load_flow(tmp_path / name, {"T": 280.0}, unit="m", shape=SHAPE, axisymmetric="x", samples=1)
    corner = np.hypot(*np.asarray(data.points)[:, 1:].T).max()
    np.testing.assert_allclose(flow.grid.origin, [0, -corner, -corner], rtol=1e-6)
    centres = np.asarray(flow.grid.centres(), float)
    radius = np.hypot(centres[..., 1], centres[..., 2])
    expected = np.where(radius < 1, profile(centres[..., 0], radius), 280.0)
    clear = np.abs(radius - 1) > 1e-3
    np.testing.assert_allclose(flow.fields["T"][clear], expected[clear], rtol=1e-5)
    assert flow.covered == pytest.approx(np.pi / 4 / corner**2, rel=0.04)  # of 24 x 24 centres


@pytest.mark.parametrize("data", [plane(), wedge(np.radians(5), 0.3), wedge(np.radians(60), 0.3)])
def test_the_integral_is_that_of_the_whole(tmp_path, data):
    data.save(tmp_path / "flow.vtk")
    given = {"unit": "mm", "shape": (6, 60, 60), "axisymmetric": "x"}
    report = load_flow(tmp_path / "flow.vtk", {"T": 300.0}, **given).report["T"]
    # of cells as constant; 2 pi r dr of 1 - r differs by 1 / 400 from its mean over cells
    assert abs(report.integral) < 0.006 and report.rms < 0.03 * report.span


def test_an_axisymmetric_flow_takes_axes(tmp_path):
    plane().save(tmp_path / "flow.vts")
    axes = Axes(nose="-x", up="+z", offset=(-8.0, 0.5, 0.0))  # the jet leaves backwards
    given = {"unit": "m", "shape": SHAPE, "axisymmetric": "x", "samples": 1, "axes": axes}
    flow = load_flow(tmp_path / "flow.vts", {"T": 280.0}, **given)
    np.testing.assert_allclose(flow.grid.origin, [-11.0, -0.5, -1.0], atol=1e-5)
    centres = np.asarray(flow.grid.centres(), float) - np.array([-8.0, 0.5, 0.0])
    radius = np.hypot(centres[..., 1], centres[..., 2])
    inside = radius < 0.999
    np.testing.assert_allclose(flow.fields["T"][inside], profile(-centres[..., 0], radius)[inside], rtol=1e-5)


def test_a_solution_on_both_sides_of_the_axis_is_refused(tmp_path):
    plane(low=-1.0).save(tmp_path / "both.vts")
    with pytest.raises(ValueError, match="both.vts: got points over 180 degrees around the axis x .* at most 90"):
        load_flow(tmp_path / "both.vts", {"T": 300.0}, unit="m", shape=SHAPE, axisymmetric="x")
    plane().save(tmp_path / "half.vts")
    with pytest.raises(ValueError, match="half.vts: holds no volume cells"):
        load_flow(tmp_path / "half.vts", {"T": 300.0}, unit="m", shape=SHAPE)
    with pytest.raises(ValueError, match="axisymmetric: got 'r', expected"):
        load_flow(tmp_path / "half.vts", {"T": 300.0}, unit="m", shape=SHAPE, axisymmetric="r")


MASSES = {"H2O": 18.015, "CO2": 44.01, "N2": 28.013}


def burnt(*names, kind="cell_data"):
    """A gas of mole fractions .1, .2 and .7, as mass fractions."""
    moles = {"H2O": 0.1, "CO2": 0.2, "N2": 0.7}
    whole = sum(moles[name] * MASSES[name] for name in moles)
    data = pyvista.ImageData(dimensions=(3, 3, 3))
    for name in names:
        getattr(data, kind)[name] = np.full(data.n_cells, moles[name] * MASSES[name] / whole)
    return data


@pytest.mark.parametrize("names", [("H2O", "CO2", "N2"), ("H2O", "CO2")])
def test_mass_fractions_become_mole_fractions(tmp_path, names):
    burnt(*names).save(tmp_path / "flow.vti")
    given = {"unit": "m", "shape": (2, 2, 2)}
    found = load_flow(tmp_path / "flow.vti", {"H2O": 0.0, "CO2": 0.0}, molar_masses=MASSES, **given).fields
    np.testing.assert_allclose(found["H2O"], 0.1, rtol=1e-6)
    np.testing.assert_allclose(found["CO2"], 0.2, rtol=1e-6)
    plain = load_flow(tmp_path / "flow.vti", {"H2O": 0.0, "CO2": 0.0}, **given).fields
    np.testing.assert_allclose(plain["CO2"] / plain["H2O"], 2 * 44.01 / 18.015, rtol=1e-6)


@pytest.mark.parametrize(
    ("names", "masses", "message"),
    [
        (
            ("H2O", "CO2"),
            {"H2O": 18.0, "CO2": 44.0},
            r"the mass fractions of H2O, CO2 sum to 0.\d+ .* 1: molar",
        ),
        (("H2O",), MASSES, "molar_masses: got CO2, N2, which the file does not hold, expected its species and at most"),
        (("H2O", "CO2"), {**MASSES, "CO2": 0.0}, r"molar_masses\['CO2'\]: got 0.0, expected a number > 0"),
        (("H2O", "CO2"), {"N2": 28.0}, "molar_masses: got N2, which the file does not hold"),
    ],
)
def test_molar_masses_that_do_not_suit_are_named(tmp_path, names, masses, message):
    burnt(*names).save(tmp_path / "flow.vti")
    with pytest.raises(ValueError, match=message):
        load_flow(tmp_path / "flow.vti", {"H2O": 0.0}, unit="m", shape=(2, 2, 2), molar_masses=masses)


def test_species_of_points_and_of_cells_are_refused(tmp_path):
    data = burnt("H2O", "CO2")
    data.point_data["N2"] = np.full(data.n_points, 0.6)
    data.save(tmp_path / "flow.vti")
    with pytest.raises(ValueError, match="flow.vti: H2O, CO2, N2 are point and cell data, expected one kind"):
        load_flow(tmp_path / "flow.vti", {"H2O": 0.0}, unit="m", shape=(2, 2, 2), molar_masses=MASSES)


def test_a_scene_file_takes_all_of_it(tmp_path):
    data = plane()
    for name, share in (("H2O", 0.08), ("CO2", 0.12)):
        data.point_data[name] = np.full(data.n_points, share)
    data.save(tmp_path / "flow.vts")
    (tmp_path / "scene.toml").write_text(
        """
bands = ["MWIR"]
[plumes]
type = "GridPlume"
temperature = { field = "T" }
gas = { type = "NarrowBandGas", pressure = 26500.0, h2o = { field = "H2O" }, co2 = { field = "CO2" } }
[plumes.flow]
path = "flow.vts"
unit = 2.0
shape = [6, 8, 8]
fields = { T = 280.0, H2O = 0.0, CO2 = 0.0 }
axes = { nose = "-x", offset = [-8, 0, 0] }
axisymmetric = "x"
molar_masses = { H2O = 18.015, CO2 = 44.01, N2 = 28.013 }
"""
    )
    read = load_scene(tmp_path / "scene.toml")
    plume = read.scene.plumes[0]
    np.testing.assert_allclose(plume.grid.origin, [-14.0, -2.0, -2.0], atol=1e-5)
    moles = np.array([0.08 / 18.015, 0.12 / 44.01, 0.8 / 28.013])
    assert float(plume.gas.h2o[3, 4, 4]) == pytest.approx(moles[0] / moles.sum(), rel=1e-5)
    assert "x -14 to -8, y -2 to 2, z -2 to 2 m" in read.describe()
