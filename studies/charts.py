"""Charts that several studies draw."""

from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402

from jaxir.render import Image, Signature  # noqa: E402


def out_folder(study: str) -> Path:
    """Where a study writes: studies/out/NAME."""
    folder = Path(__file__).parent / "out" / study
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def radiance_panels(path: Path, images: dict[str, Image]) -> None:
    """One row per image, one column per band, each band on one scale, colour bar in W m-2 sr-1."""
    bands = next(iter(images.values())).bands
    figure, axes = plt.subplots(
        len(images),
        len(bands),
        figsize=(4.4 * len(bands), 1.9 * len(images) + 0.6),
        squeeze=False,
        layout="constrained",
    )
    for column, band in enumerate(bands):
        top = max(float(np.asarray(image.radiance)[:, :, column].max()) for image in images.values())
        low = min(float(np.asarray(image.radiance)[:, :, column].min()) for image in images.values())
        scale = matplotlib.colors.LogNorm(max(low, top * 1e-5), top) if top > 0 else None
        for row, (name, image) in enumerate(images.items()):
            axis = axes[row, column]
            height, width = image.camera.shape
            x, y = (0.5 * n * float(p) for n, p in zip((width, height), image.camera.pixel, strict=True))
            shown = axis.imshow(
                np.maximum(np.asarray(image.radiance)[:, :, column], top * 1e-5),
                norm=scale,
                cmap="inferno",
                extent=(-x, x, -y, y),
            )
            axis.set_title(f"{band}, {name}")
            axis.set_ylabel("m" if column == 0 else "")
        figure.colorbar(
            shown, ax=axes[:, column], location="bottom", label="radiance [W m$^{-2}$ sr$^{-1}$]", shrink=0.9, aspect=40
        )
    figure.savefig(path, dpi=110)
    plt.close(figure)


def polar_signature(path: Path, table: Signature) -> None:
    """Radiant intensity against azimuth, logarithmic radius, one curve per band."""
    figure, axis = plt.subplots(subplot_kw={"projection": "polar"}, figsize=(6, 6), layout="constrained")
    angle = np.deg2rad(np.append(table.azimuth, table.azimuth[0]))
    for index, band in enumerate(table.bands):
        value = np.asarray(table.intensity)[:, index]
        axis.plot(angle, np.append(value, value[0]), label=band)
    axis.set_rscale("log")
    axis.set_title("radiant intensity [W/sr] against azimuth from the nose")
    axis.legend(loc="lower left")
    figure.savefig(path, dpi=110)
    plt.close(figure)
