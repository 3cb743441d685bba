from contextlib import nullcontext

import numpy as np
import pytest

from jaxir.io.spectra import load_atmosphere_csv, load_tape7, load_tape7_sun
from jaxir.optics.spectrum import MWIR, Band, resolved_nodes

NODES = resolved_nodes([MWIR], points=1, pair_points=0)
WAVENUMBER = np.arange(1990.0, 3350.0, 5.0)
TRANSMITTANCE = 0.5 + 0.4 * np.sin(WAVENUMBER / 90)
THERMAL = 1e-6 * np.exp(-WAVENUMBER / 400)  # W cm-2 sr-1 / cm-1
SOLAR = np.full_like(THERMAL, 2e-10)
MAGNITUDE = {1: "0P", 2: "1P"}


def tape7(mode):
    """The file as MODTRAN 4 writes it, column by column."""
    lines = [f"TM  6    2    {mode}    0", "   10.000     0.000   30.000", ""]
    if mode == 0:
        lines += ["    FREQ COMBIN    H2O   UMIX     O3  TRACE     N2    H2O MOLEC AER+CLD  HNO3 AER+CLD    -LOG"]
        lines += ["    CM-1  TRANS  TRANS  TRANS  TRANS  TRANS   CONT   CONT   SCAT  TRANS  TRANS abTRNS  COMBIN"]
    elif mode == 3:
        lines += ["    FREQ   TRANS     SOL TR  SOLAR"]
    else:
        lines += [
            "    FREQ  TOT TRANS  PTH THRML  THRML SCT  SURF EMIS   SOL SCAT  SING SCAT  GRND RFLT"
            "  DRCT RFLT  TOTAL RAD  REF SOL  SOL@OBS   DEPTH"
        ]
    for nu, t, thermal, solar in zip(WAVENUMBER, TRANSMITTANCE, THERMAL, SOLAR, strict=True):
        depth = -np.log(t)
        if mode == 0:
            lines.append(f"{nu:8.2f}" + f" {t:6.4f}" * 11 + f" {depth:7.3f}")
        elif mode == 1:  # discrete ordinates: thermal scattering, solar terms and direct reflection stay blank
            blank = " " * 11
            lines.append(
                f"{nu:8.2f}{t:11.4E}{thermal:11.4E}{blank}{7e-9:11.4E}{blank}{blank}{3e-9:11.4E}{blank}"
                f"{thermal + 1e-8:11.4E}{'':18}{depth:8.3f}"
            )
        elif mode == 2:
            values = (thermal, thermal / 9, 7e-9, solar, solar / 2, 3e-9, 1e-9, thermal + solar + 1e-8)
            tail = f"{1e-8:9.2E}{1e-8:9.2E}{depth:8.3f}"
            lines.append(f"{nu:8.2f}{t:11.8f}" + "".join(f"{v:11.4E}" for v in values) + tail)
        else:
            lines.append(f"{nu:8.2f}{t:8.4f}{1e-6:9.2E}{2e-6:9.2E}".ljust(95) + f"{depth:10.3E}")
    return [*lines, "  -9999.", ""]


@pytest.mark.parametrize("mode", [0, 1, 2, 3])
def test_tape7_round_trip(mode, tmp_path):
    file = tmp_path / "case.tp7"
    file.write_text("\n".join(tape7(mode)))
    warns = pytest.warns(UserWarning, match="case.tp7: got no path radiance") if mode in (0, 3) else nullcontext()
    with warns:
        air = load_tape7(file)
    assert np.allclose(air.wavenumber, WAVENUMBER) and np.allclose(air.transmittance, TRANSMITTANCE, atol=1e-4)
    expected = {1: THERMAL, 2: THERMAL + SOLAR}.get(mode)
    if expected is None:
        assert air.spectral_path_radiance is None and air.described.endswith("2.99 to 5.025 um, without path radiance")
    else:
        assert np.allclose(air.spectral_path_radiance, expected * 1e4, rtol=1e-4)
        assert air.described == "TableAtmosphere, 2.99 to 5.025 um"
    assert air.on(NODES).transmittance.shape == (NODES.count,)


def test_tape7_of_other_versions(tmp_path):
    lines = [line.replace("TOT TRANS", "tot_trans").replace("PTH THRML", "PTH_THRML") for line in tape7(2)]
    lines = [line[2:] if line.startswith("    FREQ") else line for line in lines]  # header shifted by two
    descending = lines[:4] + lines[-3:3:-1] + lines[-2:]
    file = tmp_path / "case.7sc"
    for begin in (0, 3):  # an editor may have left the header alone, behind a mark
        file.write_text("\n".join(descending[begin:]), encoding="utf-8-sig")
        air = load_tape7(file)
        assert np.allclose(air.wavenumber, WAVENUMBER) and np.allclose(air.transmittance, TRANSMITTANCE, atol=1e-6)


@pytest.mark.parametrize("between", ["\t", " "])
@pytest.mark.parametrize("total", ["TOT_TRANS", "TRANS"])
def test_values_that_do_not_lie_below_their_columns_are_refused(total, between, tmp_path):
    """The thermal radiance was read as the transmittance, or radiances as blank columns."""
    rows = [between.join([f"{nu}", "0.5", "1.0E-7", "5.0E-8"]) for nu in range(2000, 2020, 5)]
    head = between.join(["FREQ", total, "PTH_THRML", "SOL_SCAT"])
    file = tmp_path / "case.tp7"
    file.write_text("\n".join(["card", head, *rows, "-9999."]))
    with pytest.raises(ValueError, match="case.tp7:3: got values that do not end below the names of their columns"):
        load_tape7(file)


def cut(lines, low, high):
    """The file of a part of the range."""
    begin = 5 if "CM-1" in lines[4] else 4
    kept = [line for line in lines[begin:-2] if low <= float(line[:8]) <= high]
    return lines[:begin] + kept + lines[-2:]


def write_pieces(folder, *ranges, mode=2):
    """Files of parts of the range."""
    files = [folder / f"{index}.tp7" for index in range(len(ranges))]
    for file, ends in zip(files, ranges, strict=True):
        file.write_text("\n".join(cut(tape7(mode), *ends)))
    return files


def test_files_for_several_bands_are_joined(tmp_path):
    whole = write_pieces(tmp_path, (0, 9999))
    one, both = load_tape7(whole[0]), load_tape7(write_pieces(tmp_path, (2500, 9999), (0, 2495)))
    assert both.gaps is None and one.described == both.described
    for name in ("wavenumber", "transmittance", "spectral_path_radiance"):
        np.testing.assert_array_equal(getattr(one, name), getattr(both, name))
    apart = load_tape7(write_pieces(tmp_path, (0, 2400), (2800, 9999)))
    assert apart.described == "TableAtmosphere, 2.99 to 3.571 um, 4.167 to 5.025 um"
    np.testing.assert_allclose(apart.gaps, [[2400, 2800]])
    inside = resolved_nodes([Band("a", 4.2, 4.9), Band("b", 3.1, 3.5)], points=1, pair_points=0)
    np.testing.assert_allclose(apart.on(inside).transmittance, one.on(inside).transmittance, rtol=1e-5)
    with pytest.raises(ValueError, match="expected bins outside 3.571 to 4.167 um, where TableAtmosphere has no data"):
        apart.on(NODES)
    one_file, table = tmp_path / "gap.tp7", tmp_path / "gap.csv"
    one_file.write_text("\n".join([*cut(tape7(2), 0, 2400)[:-2], *cut(tape7(2), 2800, 9999)[4:]]))
    pairs = zip(apart.wavenumber.tolist(), apart.transmittance.tolist(), strict=True)
    table.write_text("\n".join(["wavenumber_cm-1,transmittance", *(f"{nu},{passed}" for nu, passed in pairs)]))
    for air in (load_tape7(one_file), load_atmosphere_csv(table)):
        np.testing.assert_allclose(air.gaps, [[2400, 2800]])
    uneven = np.sort(np.random.default_rng(0).uniform(1000.0, 4000.0, 3000))
    table.write_text("\n".join(["wavenumber_cm-1,transmittance", *(f"{nu:.9g},0.5" for nu in uneven)]))
    assert load_atmosphere_csv(table).gaps is None
    with pytest.raises(ValueError, match=r"1.tp7: begins at 2400 cm-1 .4.167 um., inside .*0.tp7, which ends at 2500"):
        load_tape7(write_pieces(tmp_path, (0, 2500), (2400, 9999)))
    (tmp_path / "d").mkdir()
    dark = write_pieces(tmp_path / "d", (2500, 9999), mode=0)
    with pytest.raises(ValueError, match="d.0.tp7: got no path radiance, expected one as in the other files"):
        load_tape7([*write_pieces(tmp_path, (0, 2495)), *dark])
    with pytest.raises(ValueError, match="path: got no file"):
        load_tape7([])


def test_sunlight_of_tape7_integrates_to_its_irradiance(tmp_path):
    file = tmp_path / "sun.tp7"
    file.write_text("\n".join(tape7(3)))
    sun = load_tape7_sun(file)  # 1e-6 W cm-2 / cm-1 everywhere
    width = np.asarray(NODES.upper) - np.asarray(NODES.lower)
    np.testing.assert_allclose(sun.on(NODES), 1e-2 * width, rtol=1e-4)
    with pytest.raises(ValueError, match="sun.tp7:4: got no column SOL TR, expected MODTRAN's tape7 of IEMSCT 3"):
        file.write_text("\n".join(tape7(2)))
        load_tape7_sun(file)


def test_scanned_files_in_um_are_those_in_wavenumbers(tmp_path):
    """The header and the columns of .7sc in um; a radiance per um is wavelength^2 / 1e4 times as much per cm-1."""
    head = " WAVLEN MCRN  TRANS  PTH THRML  THRML SCT  SURF EMIS   SOL SCAT  SING SCAT  GRND RFLT  DRCT RFLT  TOTAL RAD"
    value = "1.0000E-06 0.0000E+00 0.0000E+00 1.0000E-06 0.0000E+00 0.0000E+00 0.0000E+00 2.0000E-06"
    rows = [f"{3 + 0.01 * i:12.6f} {0.5:6.4f} {value.replace(' 0.0000E+00', '           ', 1)}" for i in range(200)]
    (tmp_path / "a.7sc").write_text("\n".join(["run", "", head, *rows, " -9999.", ""]))
    air = load_tape7(tmp_path / "a.7sc")
    wavenumber = np.asarray(air.wavenumber)
    np.testing.assert_allclose(1e4 / wavenumber[::-1], 3 + 0.01 * np.arange(200), rtol=1e-6)
    np.testing.assert_allclose(air.spectral_path_radiance, 2e-2 * 1e4 / wavenumber**2, rtol=1e-6)
    np.testing.assert_array_equal(air.transmittance, 0.5)


def change(lines, number, old, new):
    lines[number - 1] = lines[number - 1].replace(old, new, 1)
    return lines


@pytest.mark.parametrize(
    ("broken", "where", "what"),
    [
        (lambda lines: lines[:-2], "", "cut"),
        (lambda lines: lines[:10] + [lines[10][:40]] + lines[11:], ":11:", "characters"),
        (lambda lines: [line.replace("FREQ", "NONE") for line in lines], "", "FREQ"),
        (
            lambda lines: [line.replace("FREQ", "WAVLEN (NM)") for line in lines],
            ":4:",
            "got WAVLEN",
        ),
        (lambda lines: [line.replace("TOT TRANS", "ALL OF IT") for line in lines], ":4:", "TOT TRANS"),
        (lambda lines: change(lines, 9, "2010.00", "20l0.00"), ":9:", "number"),
        (lambda lines: change(lines, 9, "2010.00", "1900.00"), ":9:", "monotonic"),
        (lambda lines: [x[:8] + "  1.500000 " + x[19:] if x.startswith(" 2010") else x for x in lines], ":9:", "0, 1"),
        (lambda lines: change(lines, 9, "2010.00", "    nan"), ":9:", "finite"),
    ],
)
def test_broken_tape7_names_the_line(broken, where, what, tmp_path):
    file = tmp_path / "bad.tp7"
    file.write_text("\n".join(broken(tape7(2))))
    with pytest.raises(ValueError, match=rf"bad\.tp7{where}.*{what}"):
        load_tape7(file)


def test_csv_by_wavenumber_and_by_wavelength(tmp_path):
    table = np.stack([WAVENUMBER, TRANSMITTANCE, THERMAL * 1e4], axis=1)
    by_number, by_length = tmp_path / "a.csv", tmp_path / "b.csv"
    header = "# from somewhere\n\nwavenumber_cm-1, transmittance, path_radiance, note\n"
    by_number.write_text(header + "\n".join(",".join(f"{x:.8g}" for x in row) + ",x" for row in table))
    rows = "\n".join(f"{t:.8g},{1e4 / nu:.9g}" for nu, t in zip(WAVENUMBER, TRANSMITTANCE, strict=True))
    by_length.write_text("transmittance,wavelength_um\n" + rows)
    first, second = load_atmosphere_csv(by_number), load_atmosphere_csv(by_length)
    assert np.allclose(first.spectral_path_radiance, THERMAL * 1e4, rtol=1e-5)
    assert np.allclose(first.on(NODES).transmittance, second.on(NODES).transmittance, atol=1e-5)
    assert second.spectral_path_radiance is None and second.described.endswith("without path radiance")


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "no lines"),
        ("a,b\n1,2\n", ":1: got columns"),
        ("wavenumber_cm-1,transmittance\n2000,0.5\n2010\n", ":3: got 1 columns"),
        ("wavenumber_cm-1,transmittance\n2000,0.5\n2010,x\n", ":3: got 'x' for transmittance"),
        ("wavenumber_cm-1,transmittance\n2000,0.5\n2010,1.2\n", ":3: got transmittance 1.2"),
        ("wavenumber_cm-1,transmittance\n2000,0.5\n2010,0.5\n2005,0.5\n", ":4: got wavenumber 2005"),
        ("wavenumber_cm-1,transmittance\n2000,0.5\n2000,0.5\n", ":3: .* twice"),
        ("wavenumber_cm-1,transmittance,path_radiance\n2000,0.5,-1\n", ":2: got path radiance"),
        ("wavenumber_cm-1,transmittance\n2000,0.5\n", "1 samples"),
        ("wavenumber_cm-1,transmittance\n2000,0,5\n", "bad.csv:2: got 3 columns, expected 2"),
        ("wavenumber_cm-1,transmittance,Path_Radiance_um\n2000,0.5,1\n", "got the column Path_Radiance_um, expected"),
        ("wavenumber_cm-1,transmittance,Lpath\n2000,0.5,1\n", "got the column Lpath, expected path_radiance in"),
        ("wavenumber_cm-1,transmittance,emission\n2000,0.5,1\n", "got the column emission, expected path_radiance"),
        ("wavenumber_cm-1,transmittance,path_radiance\n2000,0.5,1e308\n", "bad.csv:2: got path radiance 1e.308"),
        ("wavelength_um,transmittance\n1e-320,0.5\n", "bad.csv:2: got wavenumber inf"),
        ("wavenumber_cm-1,transmittance\n2000,0.5\n2000.00001,0.5\n", "bad.csv:3: .* twice .in float32"),
        ("wavenumber_cm-1,transmittance\n2000,0.5\n2010," + "5" * 140_000, "bad.csv:3: not readable as CSV"),
        ("wavenumber_cm-1,transmittance\n1,0.5\n2,0.6\n3,0.7\n4,0.8\n5,0.", "bad.csv:6: got '0.' without a line end"),
        ("wavenumber_cm-1,transmittance,transmittance\n1,1,1\n2,1,1", "bad.csv:1: got the column transmittance twice"),
        ("wavenumber_cm-1,transmittance\n1,1.3e-04\n2,1.4e-04\n3,1.3e-04\n4,1.3", ":5: got '1.3' .* file is cut"),
    ],
)
def test_broken_csv_names_the_line(text, what, tmp_path):
    file = tmp_path / "bad.csv"
    file.write_text(text)
    with pytest.raises(ValueError, match=what):
        load_atmosphere_csv(file)


def test_csv_of_other_bytes_names_the_line(tmp_path):
    (tmp_path / "bad.csv").write_bytes(b"wavenumber_cm-1,transmittance\n2000,0.5\n2010,\xe9\n")
    with pytest.raises(ValueError, match="bad.csv:3: got the byte 0xe9, expected UTF-8"):
        load_atmosphere_csv(tmp_path / "bad.csv")
    for read in (load_atmosphere_csv, load_tape7):
        with pytest.raises(ValueError, match="none.csv: no such file"):
            read(tmp_path / "none.csv")
