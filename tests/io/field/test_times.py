"""Files of several times are read at one of them, whichever format tells the times and however."""

from typing import NamedTuple

import numpy as np
import pytest
import pyvista
from vtkmodules.vtkFiltersCore import vtkAppendFilter
from vtkmodules.vtkIOHDF import vtkHDFWriter

from jaxir.io.field import load_flow, load_surface_field
from tests.scenes import box_mesh

CELLS = (3, 2, 2)


class Zone(NamedTuple):
    """A zone of a Tecplot file: the values 100 step + x of T on x, y, z from `low` to `low` + 1 along x."""

    header: str
    step: int
    low: float = 0.0


def columns(step, low=0.0):
    z, y, x = np.meshgrid(*(np.linspace(0, 1, n + 1) for n in CELLS[::-1]), indexing="ij")
    return np.stack([(x + low).ravel(), y.ravel(), z.ravel(), (100 * step + x + low).ravel()])


def tecplot(path, *zones, variables='"X" "Y" "Z" "T"'):
    size = " ".join(f"{name}={n + 1}" for name, n in zip("IJK", CELLS, strict=True))
    lines = ['TITLE="ZONE by ZONE, SOLUTIONTIME=7"', f"VARIABLES={variables}"]
    for zone in zones:
        lines.append(f"ZONE {size} {zone.header}")
        rows = columns(zone.step, zone.low)
        lines += [" ".join(map(repr, row)) for row in (rows if "BLOCK" in zone.header else rows.T).tolist()]
    path.write_text("\n".join([*lines, ""]))


def xdmf(path, *times):
    x, y, z, _ = columns(0)
    text = ""
    for step, time in enumerate(times, 1):
        counts = " ".join(str(n + 1) for n in CELLS[::-1])
        points = " ".join(map(repr, np.stack([x, y, z], axis=1).ravel().tolist()))
        values = " ".join(map(repr, columns(step)[3].tolist()))
        text += '<Grid Name="g" GridType="Uniform">' + ("" if time is None else f'<Time Value="{time}"/>')
        text += f'<Topology TopologyType="3DSMesh" Dimensions="{counts}"/><Geometry GeometryType="XYZ">'
        text += f'<DataItem Dimensions="{x.size} 3" Format="XML">{points}</DataItem></Geometry>'
        text += f'<Attribute Name="T" Center="Node"><DataItem Dimensions="{counts}" Format="XML">{values}</DataItem>'
        text += "</Attribute></Grid>"
    if len(times) > 1:
        text = f'<Grid Name="all" GridType="Collection" CollectionType="Temporal">{text}</Grid>'
    path.write_text(f'<?xml version="1.0"?><Xdmf Version="2.0"><Domain>{text}</Domain></Xdmf>')


def vtkhdf(path, *times):
    xdmf(path.with_suffix(".xdmf"), *times)
    source = pyvista.get_reader(str(path.with_suffix(".xdmf"))).reader
    grids, writer = vtkAppendFilter(), vtkHDFWriter()
    grids.SetInputConnection(source.GetOutputPort())
    writer.SetInputConnection(grids.GetOutputPort())
    writer.SetFileName(str(path))
    writer.SetWriteAllTimeSteps(True)
    writer.Write()


def pvd(path, *times):
    text = ""
    for step, time in enumerate(times, 1):
        x, y, z, value = columns(step)
        grid = pyvista.StructuredGrid()
        grid.points, grid.dimensions = np.stack([x, y, z], axis=1), [n + 1 for n in CELLS]
        grid.point_data["T"] = value
        grid.save(path.with_name(f"{step}.vts"))
        text += f'<DataSet timestep="{time}" part="0" file="{step}.vts"/>'
    path.write_text(f'<VTKFile type="Collection" version="0.1"><Collection>{text}</Collection></VTKFile>')


def write(path, *times):
    if path.suffix == ".dat":
        tecplot(path, *(Zone(f"STRANDID=1, SOLUTIONTIME = {time}", i) for i, time in enumerate(times, 1)))
    else:
        {".xdmf": xdmf, ".vtkhdf": vtkhdf, ".pvd": pvd}[path.suffix](path, *times)
    return path


def level(path, **more):
    """The step of a file: T less x, over 100."""
    flow = load_flow(path, {"T": 0.0}, unit="m", shape=CELLS, **more)
    step = (flow.fields["T"] - np.asarray(flow.grid.centres())[..., 0]) / 100
    assert flow.covered == 1 and np.ptp(step) < 1e-5
    return round(float(step[0, 0, 0]), 4)


@pytest.mark.parametrize("name", ["flow.xdmf", "flow.vtkhdf", "flow.pvd", "flow.dat"])
def test_a_file_is_read_at_its_last_time_or_at_one_asked_for(tmp_path, name):
    path = write(tmp_path / name, 0.5, 2.0)
    assert [level(path), level(path, time=0.5), level(path, time=2.0)] == [2, 1, 2]
    with pytest.raises(ValueError, match=rf"{name}: time 7.0 not found, the file holds \[0.5, 2.0\]"):
        level(path, time=7.0)


@pytest.mark.parametrize("name", ["flow.vtkhdf", "flow.dat"])
def test_a_surface_is_read_at_its_last_time_or_at_one_asked_for(tmp_path, name):
    path, mesh = write(tmp_path / name, 0.5, 2.0), box_mesh((1.0, 1.0, 1.0), centre=(0.5, 0.5, 0.5))
    for time, step in ((None, 2), (0.5, 1)):
        report = load_surface_field(path, mesh, "T", unit="m", time=time).report
        assert report.mesh_mean == pytest.approx(100 * step + 0.5, rel=1e-5)


def test_an_xdmf_file_without_times_is_read(tmp_path):
    path = write(tmp_path / "flow.xdmf", None)
    assert level(path) == 1
    with pytest.raises(ValueError, match="flow.xdmf: time 0.0 not found, the file holds no times"):
        level(path, time=0.0)


def test_zones_of_a_tecplot_file_without_a_time_are_there_at_all_times(tmp_path):
    still = Zone("", 5, low=1.0), Zone("STRANDID=0 SOLUTIONTIME=3", 6, low=2.0)
    tecplot(tmp_path / "flow.dat", *still, Zone("solutiontime=2", 2), Zone("solutiontime=1", 1))
    for time, step in ((None, 2), (1.0, 1)):
        flow = load_flow(tmp_path / "flow.dat", {"T": 0.0}, unit="m", shape=(3, 1, 1), time=time)
        np.testing.assert_allclose(flow.fields["T"][:, 0, 0], [100 * step + 0.5, 501.5, 602.5], rtol=1e-6)


def test_tecplot_files_of_which_vtk_would_make_something_else_are_refused(tmp_path):
    path, one = tmp_path / "flow.dat", Zone("", 1)
    for zones, variables, message in (
        ((one, Zone("", 2)), '"X" "Y" "Z" "T"', "got the same cells in blocks 0 and 1, .* in a Tecplot file SOLUTION"),
        ((Zone("SOLUTIONTIME=soon", 1),), '"X" "Y" "Z" "T"', "flow.dat: SOLUTIONTIME: got 'SOON', expected a number"),
        (
            (Zone("ZONETYPE=Ordered DATAPACKING=BLOCK", 1),),
            '"X" "Y" "Z" "T"',
            "flow.dat:3: got a zone with ZONETYPE=ORDERED and DATAPACKING=BLOCK, which VTK reads as POINT, expected",
        ),
        ((one,), '"X [m]" "Y [m]" "Z [m]" "T"', r"VARIABLES: got X \[m\], Y \[m\], Z \[m\], T .*, expected X, Y and Z"),
        ((one,), '"T" "X" "Y" "Z"', "VARIABLES: got Z as fields, expected X, Y and Z"),
        ((one,), '"X" "Y" "Z" "K"', "VARIABLES: got K as fields, expected X, Y and Z"),
    ):
        tecplot(path, *zones, variables=variables)
        with pytest.raises(ValueError, match=message):
            level(path)
    tecplot(path, Zone("DATAPACKING=BLOCK", 1))
    assert level(path) == 1
