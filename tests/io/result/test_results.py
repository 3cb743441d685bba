"""Images and tables: every format read back, nothing half written."""

import dataclasses
import inspect

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import jaxir
from jaxir.io.result import save_image, save_netcdf, save_signature, save_tiff
from tests.scenes import plate


@pytest.fixture(scope="module")
def image():
    scene = jaxir.Scene(plate())
    return jaxir.render(scene, jaxir.orthographic_camera(0.0, 0.0, 0.1, (12, 16)), (jaxir.MWIR, jaxir.LWIR), samples=2)


def test_npz_holds_image_and_conditions(image, tmp_path):
    save_image(tmp_path / "image.npz", image)
    with np.load(tmp_path / "image.npz") as held:
        np.testing.assert_array_equal(held["radiance"], image.radiance)
        np.testing.assert_array_equal(held["standard_error"], image.standard_error)
        assert list(held["bands"]) == ["MWIR", "LWIR"] and str(held["unit"]) == "W m-2 sr-1"


def test_tiff_holds_one_page_per_band(image, tmp_path):
    import tifffile

    save_tiff(tmp_path / "image.tif", image)
    with tifffile.TiffFile(tmp_path / "image.tif") as held:
        assert [page.description for page in held.pages] == [f"{b} radiance, W m-2 sr-1" for b in image.bands]
        for index, page in enumerate(held.pages):
            assert page.dtype == np.float32
            np.testing.assert_array_equal(page.asarray(), image.radiance[:, :, index])


def test_signature_table(tmp_path):
    table = jaxir.signature(jaxir.Scene(plate()), [(0.0, 0.0), (30.0, -10.0)], jaxir.LWIR, shape=(16, 16))
    save_signature(tmp_path / "table.csv", table)
    header, *rows = (tmp_path / "table.csv").read_text().splitlines()
    assert header == "azimuth_deg,elevation_deg,LWIR_W_per_sr,LWIR_standard_error_W_per_sr"
    held = np.array([[float(cell) for cell in row.split(",")] for row in rows])
    np.testing.assert_allclose(held[:, 2], table.intensity[:, 0], rtol=1e-6)
    np.testing.assert_allclose(held[:, :2], [(0.0, 0.0), (30.0, -10.0)], rtol=1e-6)


def test_what_would_make_two_columns_of_one_name_or_a_file_of_a_folder_is_refused(tmp_path):
    angle, value = jnp.zeros(1), jnp.ones((1, 2))
    table = jaxir.Signature(angle, angle, value, 0 * value, ("M", "M_standard_error"), 0 * value)
    with pytest.raises(ValueError, match="that make the column M_standard_error_W_per_sr twice"):
        save_signature(tmp_path / "table.csv", table)
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(ValueError, match="folder.csv: is a folder, expected the name of a file"):
        save_signature(tmp_path / "folder.csv", dataclasses.replace(table, bands=("M", "L")))
    assert [path.name for path in tmp_path.iterdir()] == ["folder.csv"]


def test_components_are_written_by_name(image, tmp_path):
    xarray = pytest.importorskip("xarray")
    share = np.array([0.75, 0.25], np.float32)[None, None, :, None]
    split = dataclasses.replace(
        image, components=("skin, a b", "Sun"), parts=jnp.asarray(share * np.asarray(image.radiance)[:, :, None])
    )
    save_image(tmp_path / "image.npz", split)
    save_netcdf(tmp_path / "image.nc", split)
    with np.load(tmp_path / "image.npz") as held, xarray.open_dataset(tmp_path / "image.nc", engine="scipy") as data:
        assert held["components"].tolist() == data.component.values.tolist() == ["skin, a b", "Sun"]
        for name in ("component_radiance", "component_intensity"):
            np.testing.assert_array_equal(held[name], data[name])
        np.testing.assert_allclose(held["component_intensity"].sum(axis=0), image.radiant_intensity(), rtol=1e-6)
        assert data.component_radiance.dims == ("row", "column", "component", "band")
    angles, value = jnp.asarray([0.0, 30.0]), jnp.asarray([[1.0], [2.0]])
    parts = jnp.stack([0.75 * value, 0.25 * value], axis=1)
    table = jaxir.Signature(
        angles, 0 * angles, value, 0 * value, ("LWIR",), 0 * value, None, None, split.components, parts
    )
    save_signature(tmp_path / "table.csv", table)
    save_netcdf(tmp_path / "table.nc", table)
    header, first, second = (tmp_path / "table.csv").read_text().splitlines()
    assert header.split(",")[4:] == ["LWIR_skin_a_b_W_per_sr", "LWIR_Sun_W_per_sr"]
    assert second.split(",")[4:] == ["1.5", "0.5"]
    with xarray.open_dataset(tmp_path / "table.nc", engine="scipy") as data:
        np.testing.assert_array_equal(data.component_intensity, parts)
    save_signature(tmp_path / "alike.csv", dataclasses.replace(table, components=("skin, a b", "skin, a-b")))
    header, _, second = (tmp_path / "alike.csv").read_text().splitlines()
    assert header.split(",")[4:] == ["LWIR_skin_a_b_W_per_sr", "LWIR_skin_a_b_2_W_per_sr"]
    assert second.split(",")[4:] == ["1.5", "0.5"]


def test_conditions_are_attributes_of_netcdf_or_refused(image, tmp_path):
    xarray = pytest.importorskip("xarray")
    save_netcdf(tmp_path / "image.nc", image, {"mach": 0.8, "seed": 2**40})
    with xarray.open_dataset(tmp_path / "image.nc", engine="scipy") as data:
        assert data.attrs["mach"] == 0.8 and data.attrs["seed"] == str(2**40)
    for name, value, said in (("a b", 1, "got name 'a b'"), ("", 1, "got name ''"), ("x", None, "got x None")):
        with pytest.raises(ValueError, match=f"conditions: {said}, expected"):
            inspect.unwrap(save_netcdf)(tmp_path / "other.nc", image, {name: value})
    assert not (tmp_path / "other.nc").exists()


def test_errors_are_written_part_by_part(image, tmp_path):
    xarray = pytest.importorskip("xarray")
    errors = image.error_budget()
    save_image(tmp_path / "image.npz", image, errors=errors)
    save_netcdf(tmp_path / "image.nc", image, errors=errors)
    with np.load(tmp_path / "image.npz") as held, xarray.open_dataset(tmp_path / "image.nc", engine="scipy") as data:
        for name in ("intensity", "sampling", "spectral", "quadrature", "truncation", "bounces", "outside", "total"):
            column = name if name == "intensity" else f"{name}_error"
            np.testing.assert_array_equal(held[column], getattr(errors, name))
            np.testing.assert_array_equal(data[column], getattr(errors, name))
            assert data[column].dims == ("band",) and data[column].attrs["units"] == "W sr-1"
    table = jaxir.signature(jaxir.Scene(plate()), [(0.0, 0.0), (30.0, 0.0)], jaxir.LWIR, shape=(16, 16))
    errors = eqx.tree_at(lambda e: e.spectral, table.error_budget(), None)  # what is not known has no column
    save_signature(tmp_path / "table.csv", table, errors=errors)
    save_netcdf(tmp_path / "table.nc", table, errors=errors)
    header, first, _ = (tmp_path / "table.csv").read_text().splitlines()
    columns = header.split(",")
    assert columns[3:5] == ["LWIR_standard_error_W_per_sr", "LWIR_quadrature_error_W_per_sr"]
    assert columns[-1] == "LWIR_total_error_W_per_sr" and not [name for name in columns if "spectral" in name]
    assert float(first.split(",")[-1]) == pytest.approx(float(errors.total[0, 0]), rel=1e-6)
    with xarray.open_dataset(tmp_path / "table.nc", engine="scipy") as data:
        assert data.total_error.dims == ("view", "band") and "spectral_error" not in data


@pytest.mark.parametrize("save", [save_image, save_tiff])
def test_nothing_is_left_of_a_failed_write(save, image, tmp_path):
    with pytest.raises(ValueError, match="expected a file name that ends in"):
        save(tmp_path / "image.png", image)
    with pytest.raises(ValueError, match="does not exist"):
        save(tmp_path / "absent" / ("image.npz" if save is save_image else "image.tif"), image)
    assert not list(tmp_path.iterdir())


def test_results_of_another_kind_are_refused(image, tmp_path):
    """By users' processes, whose types nobody checks."""
    as_image, as_tiff, as_table = map(inspect.unwrap, (save_image, save_tiff, save_signature))
    for save, name in ((as_image, "a.npz"), (as_tiff, "a.tif")):
        with pytest.raises(ValueError, match="image: got 3, expected an image, of jaxir.render"):
            save(tmp_path / name, 3)
    with pytest.raises(ValueError, match="signature: got a Image, expected a signature, of jaxir.signature"):
        as_table(tmp_path / "a.csv", image)
    assert not list(tmp_path.iterdir())
