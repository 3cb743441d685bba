"""Write docs/paper.md: every equation, experiment and figure of Yu et al. (2021), ours beside theirs.

python -m studies.paper
"""

import csv
import json
from collections.abc import Callable, Iterable

from studies._study import FIGURES, HERE

PAGE = HERE.parent / "docs" / "paper.md"
HEAD = """# The paper, ours beside theirs

Yu, Duan, Cong, Dai, *Optimal calculation method of aircraft infrared physical imaging simulation*, Infrared and Laser
Engineering 50(4), 2021 ([10.3788/IRLA20200241](https://doi.org/10.3788/IRLA20200241)). This page is written by
`python -m studies.paper` from the tables that the studies leave in `studies/figures`.
"""

EQUATIONS = (  # equation, what it says, here, held by
    (
        "(1)",
        "a pixel is the mean of the radiance of its rays",
        "two independent sets of even points in each pixel, with an unbiased standard error: `render`",
        "`tests/imaging/test_render.py`",
    ),
    (
        "(2)",
        "through air: transmittance times radiance, and the path's own",
        "`StandardAtmosphere`, `TableAtmosphere` from tape7, node by node",
        "`tests/scene/test_air.py`",
    ),
    (
        "(3)",
        "skin emits, and reflects by its brdf",
        "`Skin`; Kirchhoff's law from `Lambert`, `SandfordRobertson`, `RoughConductor` or `BrdfTable`",
        "`tests/optics/test_brdf.py`",
    ),
    (
        "(4), (5)",
        "plume: emission and transmission along the ray",
        "`GridPlume` (exact over its cells), `JetPlume` (quadrature to a tolerance)",
        "`tests/medium`",
    ),
    (
        "(6)–(9)",
        "direct light by samples of lights and brdf, weighted by squares of densities",
        "`Method(DirectSampling(lights, brdf))`; `ClosedForm()` where one exists",
        "`tests/transport/test_mis.py`",
    ),
    (
        "(10)–(18)",
        "points, lines and both combined along the ray",
        "`jaxir.estimate(lit, paths, PointIntegration(), key)`, `LineIntegration()`, `CombinedIntegration()`; "
        "else the exact sum, whose variance is 0",
        "`tests/transport/test_path_estimator.py`",
    ),
    (
        "(5), Fig. 5",
        "scattering by particles",
        "forced collision to `Method(orders=)`, or `DiscreteOrdinates()` without samples",
        "`tests/transport/test_scattering.py`, `test_ordinates.py`",
    ),
    (
        "(19), (20)",
        "relative root mean square errors of pixels and images",
        "printed by the studies; every pixel and intensity has its own error, `Image.error_budget()`",
        "`tests/imaging/test_budget.py`",
    ),
    (
        "depth 10, ambient light beyond",
        "bounces off skin and orders of scattering",
        "`Method(bounces=10, orders=10)`; the rest is estimated and told (`ErrorBudget.bounces`, `.truncation`), not "
        "closed by an assumed radiance, which `Method(ambient=)` does",
        "`tests/imaging/test_budget.py`",
    ),
)


def table(name: str) -> list[dict[str, str]]:
    """Rows of a study's table."""
    with (FIGURES / f"{name}.csv").open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def grid(head: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """A table of the page."""
    head = list(head)
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(str(cell) for cell in line)} |" for line in lines) + "\n"


def percent(value: object) -> str:
    """Of a number that is a share of one hundred, or nothing where the paper has none."""
    return f"{float(str(value)):.3g}" if str(value) else ""


def equations() -> str:
    """All equations."""
    return "## Equations\n\n" + grid(("equation", "what it says", "here", "held by"), EQUATIONS)


def plates() -> str:
    """Figs. 6 and 7."""
    paper = {"Fig. 6": 0.048, "Fig. 7": 0.023}
    cases: dict[tuple[str, str], list[dict[str, str]]] = {}
    for row in table("plate"):
        cases.setdefault((row["figure"], row["case"]), []).append(row)
    rows = []
    for (figure, case), own in cases.items():
        true, rays, faces = (
            [float(row[f"{name}_W_per_sr"]) for row in own] for name in ("closed_form", "by_rays", "by_faces")
        )
        worst = (
            f"{100 * max(abs(a / b - 1) for a, b in zip(found, true, strict=True)):.1g}" for found in (rays, faces)
        )
        rows.append((figure, case, f"{true[0]:.5g}", *worst, paper[figure.split(",")[0]]))
    head = ("figure", "plate of 1 m²", "W/sr at 0°", "worst error by rays, 0–85° [%]", "by faces [%]", "paper [%]")
    return (
        "## Figs. 6 and 7: emitting and sunlit plates\n\n"
        + grid(head, rows)
        + "\nThe paper's “parallel source of radiance 100” agrees with its own curve only as an irradiance of "
        "100 W m⁻².\n\n`python -m studies.plate`\n\n![Plates](../studies/figures/plate.png)\n"
    )


def disc() -> str:
    """Fig. 8 and Table 1."""
    rows = []
    found = {(row["method"], int(row["rays"])): row for row in table("skin_convergence")}
    for count in (1, 10, 100, 1000, 10000):
        cells: list[object] = [count]
        for method in ("brdf", "both"):
            row = found[method, count]
            cells += [f"{100 * float(row[key]):.3g}" for key in ("paper", "rrmse_8_bit", "rrmse")]
        rows.append(cells)
    each = ("paper", "ours, as an image of 8 bits", "ours")
    head = ["rays", *(f"{how} [%]: {what}" for how in ("brdf alone", "brdf and light") for what in each)]
    sobol = {count: 100 * float(found["light, Sobol", count]["rrmse"]) for count in (64, 1024)}
    return (
        "## Fig. 8 and Table 1: a plate under a disc\n\n"
        + grid(head, rows)
        + "\nWhat does not hold: the paper's last rows are those of an image clipped at 12.75 and cut to 8 bits. The "
        "place of the disc is not given; 1.8 m above and 1.2 m aside along both edges gives its numbers. Scrambled "
        f"Sobol points on the light err by {sobol[64]:.2g} % with 64 and {sobol[1024]:.1g} % with 1024, the closed "
        "form by 1e-5 %.\n\n`python -m studies.skin_convergence`\n\n"
        "![Table 1](../studies/figures/skin_convergence_images.png)\n"
    )


def boxes() -> str:
    """Figs. 9 and 10."""
    rows, every = [], table("plume_boxes")
    for box in ("thick", "thin"):
        for estimator in ("point", "line", "combined", "exact sum"):
            own = [row for row in every if row["box"] == box and row["estimator"] == estimator]
            cells: list[object] = [box, estimator]
            for count in (1, 10, 100):
                errors = [float(row["error_percent"]) for row in own if int(row["rays"]) == count]
                cells.append(f"{(sum(e * e for e in errors) / len(errors)) ** 0.5:.2g}")
            rows.append(cells)
    head = ("box", "estimator", "rms error over 0–80° [%], 1 ray", "10 rays", "100 rays")
    return (
        "## Figs. 9 and 10: thick and thin boxes\n\n" + grid(head, rows) + "\nThat points suit the thick box and lines "
        "the thin one holds; the exact sum needs none of them.\n\n`python -m studies.plume_boxes`\n\n"
        "![Boxes](../studies/figures/plume_boxes.png)\n"
    )


def ramp() -> str:
    """Fig. 11 and Table 2."""
    rows = [
        (row["estimator"], row["rays"], *(percent(row[f"{key}_percent"]) for key in ("paper", "measured", "theory")))
        for row in table("plume_convergence")
    ]
    return (
        "## Fig. 11 and Table 2: a medium whose absorption grows\n\n"
        + grid(("estimator", "rays", "paper [%]", "ours [%]", "theory [%]"), rows)
        + "\nWhat does not hold: the paper's errors are about half of theory's, as if pixels without medium were "
        "counted; and .020 % for the combination at 1000 rays cannot hold after .638 % at 100, since an error falls as "
        "one over the root of the rays. The ranking holds.\n\n`python -m studies.plume_convergence`\n\n"
        "![Ramp](../studies/figures/plume_convergence.png)\n"
    )


def flow() -> str:
    """Fig. 12."""
    own = table("computed_flow")
    names = [key for key in own[0] if key.endswith("W_per_sr") and "error" not in key]
    rows = [
        (row["plume"], row["azimuth_deg"], *(f"{float(row[k]):.3g} ± {float(row[error_of(k)]):.1g}" for k in names))
        for row in own
    ]
    head = ("plume", "azimuth [°]", *(f"{name.split('_')[0]} [W/sr]" for name in names))
    return (
        "## Fig. 12: the plume as a computed flow\n\nThe paper's flow field is not public. Here Table 3's exhaust is "
        "marched downstream as a round turbulent jet, written as VTK and read by `load_flow` like any other "
        "solution.\n\n" + grid(head, rows) + "\nIn flight the plume is several times longer than in still air, because "
        "it is hardly faster than the air around it: `JetPlume`, a jet in still air, wants `core_length` and "
        "`spreading` set for that.\n\n`python -m studies.computed_flow`\n\n"
        "![Flow](../studies/figures/computed_flow.png)\n"
    )


def error_of(name: str) -> str:
    """The column of a column's error."""
    return name.replace("_W_per_sr", "_error_W_per_sr")


def aircraft() -> str:
    """Table 3 and Figs. 13 to 15."""
    record = json.loads((FIGURES / "stealth_aircraft.json").read_text(encoding="utf-8"))
    seen = record["pixels of 500 x 500 that see the skin"]
    said = "\n".join(f"- {line}" for line in record["conclusions"])
    return (
        "## Table 3 and Figs. 13 to 15: the stealth aircraft\n\nThe paper's mesh is not public; ours is a generic "
        "aircraft of its length, span and height. In images of 500 × 500 pixels "
        f"{seen['ground']:,} see it from the ground and {seen['air']:,} from the air (Fig. 13: 35,000, of another "
        "shape and view). The paper's sun of 10 W m⁻² sr⁻¹ is read as an irradiance of 10 W m⁻² in SWIR.\n\n"
        f"{said}\n\n`python -m studies.stealth_aircraft`; with `--quick` in minutes, which these lines and figures are "
        "from.\n\n![Fig. 15](../studies/figures/stealth_aircraft.png)\n\n"
        "![Fig. 14](../studies/figures/stealth_intensities.png)\n"
    )


PARTS: tuple[Callable[[], str], ...] = (plates, disc, boxes, ramp, flow, aircraft)


def page() -> str:
    """The page."""
    return "\n".join([HEAD, equations(), *(part() for part in PARTS)])


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    print(f"wrote {PAGE}")
