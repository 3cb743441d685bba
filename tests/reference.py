"""Plain double precision references for the plume tests, independent of the library."""

import numpy as np


def reference_crossings(origin, spacing, shape, start, direction, t_max):
    """Cells and lengths of one ray by sorting its crossings with all planes of the grid."""
    origin, spacing = np.asarray(origin, float), np.asarray(spacing, float)
    cuts = [0.0]
    for axis in range(3):
        if direction[axis] != 0:
            planes = origin[axis] + spacing[axis] * np.arange(shape[axis] + 1)
            cuts += list((planes - start[axis]) / direction[axis])
    cuts = np.unique(np.clip(cuts, 0.0, t_max if np.isfinite(t_max) else max(cuts)))
    middle = start + (0.5 * (cuts[1:] + cuts[:-1]))[:, None] * direction
    index = np.floor((middle - origin) / spacing).astype(int)
    inside = np.all((index >= 0) & (index < np.asarray(shape)), axis=1)
    cell = np.ravel_multi_index(index[inside].T, shape) if inside.any() else np.zeros(0, int)
    return cell, np.diff(cuts)[inside]


def reference_radiance(cell, length, extinction, emission, behind):
    """Front to back in double precision with numpy's expm1; extinction and emission are [cell, node]."""
    radiance, passed = np.zeros_like(behind, dtype=float), np.ones_like(behind, dtype=float)
    for c, step in zip(cell, length, strict=True):
        u = extinction[c] * step
        radiance = radiance + passed * emission[c] * step * np.where(u == 0, 1, -np.expm1(-u) / np.where(u == 0, 1, u))
        passed = passed * np.exp(-u)
    return radiance + passed * behind
