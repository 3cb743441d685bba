"""A generic aircraft of the paper's dimensions, built of closed surfaces: 15.67 m long, 10.72 m span, 2.19 m high."""

import numpy as np

import jaxir

LENGTH, SPAN, HEIGHT, NOZZLE = 15.67, 10.72, 2.19, 0.5  # m
NOSE_X, TAIL_X = LENGTH / 2, -LENGTH / 2
PARTS = ("nose", "fuselage", "wings", "tails", "nozzle")
AMBIENT = 217.95  # K; recovery at Mach 1 with a recovery factor of .85 gives the paper's 255 K
BODY_RADIUS = 0.75  # half height of the fuselage [m]


def loft(rings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Closed surface through rings of points [ring, point, 3]; first and last ring are closed by fans.

    Rings run counterclockwise seen from the side of the last ring, so faces point outward.
    """
    count, points = rings.shape[:2]
    vertices = np.concatenate([rings.reshape(-1, 3), rings[0].mean(0)[None], rings[-1].mean(0)[None]])
    ring, point = np.meshgrid(np.arange(count - 1), np.arange(points), indexing="ij")
    a = (ring * points + point).ravel()
    b = (ring * points + (point + 1) % points).ravel()
    c, d = a + points, b + points
    sides = np.concatenate([np.stack([a, b, d], 1), np.stack([a, d, c], 1)])
    i = np.arange(points)
    j = (i + 1) % points
    first, last = count * points, count * points + 1
    low = np.stack([j, i, np.full(points, first)], 1)
    top = (count - 1) * points
    high = np.stack([top + i, top + j, np.full(points, last)], 1)
    return vertices, np.concatenate([sides, low, high])


def fuselage(stations: int, around: int) -> tuple[np.ndarray, np.ndarray]:
    """Nose to nozzle lip, into the nozzle and across its bottom."""
    s = (1 - np.cos(np.linspace(0, np.pi, stations))) / 2
    x = NOSE_X - LENGTH * s
    s = np.maximum(s, 1e-3)
    swell = np.clip(s / 0.45, 0, 1)
    taper = np.clip((1 - s) / 0.45, 0, 1)
    size = np.sin(swell * np.pi / 2) ** 0.8 * (1 - (1 - taper) ** 2 * (1 - 0.30 / BODY_RADIUS))
    width, height = np.maximum(1.25 * size, 0.02), np.maximum(BODY_RADIUS * size, 0.012)
    blend = np.clip((s - 0.8) / 0.2, 0, 1)  # the tail becomes round
    width = width * (1 - blend) + 0.30 * blend
    height = height * (1 - blend) + 0.30 * blend
    inner = np.array([[TAIL_X, 0.25], [TAIL_X + 0.3, 0.25], [TAIL_X + 0.6, 0.25]])
    x = np.concatenate([x, inner[:, 0]])
    width, height = np.concatenate([width, inner[:, 1]]), np.concatenate([height, inner[:, 1]])
    angle = np.linspace(0, 2 * np.pi, around, endpoint=False)
    ring = np.stack([np.zeros_like(angle), np.cos(angle), -np.sin(angle)], 1)
    scale = np.stack([np.zeros_like(x), width, height], 1)
    return loft(ring[None] * scale[:, None] + np.stack([x, 0 * x, 0 * x], 1)[:, None])


def fin(root: np.ndarray, tip: np.ndarray, chords: tuple[float, float], thickness: float, counts: tuple[int, int]):
    """A swept, tapered surface of lens sections from `root` to `tip` (leading-edge points)."""
    along, around = counts
    half = around // 2
    c = (1 - np.cos(np.linspace(0, np.pi, half + 1))) / 2
    lens = 2 * thickness * c * (1 - c)
    section = np.concatenate([np.stack([-c, lens], 1), np.stack([-c, -lens], 1)[-2:0:-1]])
    span = tip - root
    up = np.cross([1.0, 0.0, 0.0], span)
    up /= np.linalg.norm(up)
    t = np.linspace(0, 1, along)[:, None, None]
    chord = chords[0] * (1 - t) + chords[1] * t
    rings = root + t * span + chord * (section[None, :, :1] * np.array([1.0, 0, 0]) + section[None, :, 1:] * up)
    return loft(rings[:, ::-1])


def generic_aircraft(detail: float = 1.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices [vertex, 3] [m], faces [face, 3] and part [face] (index into `PARTS`); about 10k faces at detail 1."""
    n = lambda count: max(4, int(round(count * detail**0.5)))  # noqa: E731
    pieces = [(fuselage(n(70), 2 * n(24)), 1)]
    for side in (1.0, -1.0):
        mirror = np.array([1.0, side, 1.0])
        wing = fin(np.array([2.6, 0.4, -0.1]), np.array([-2.6, SPAN / 2, -0.1]), (6.6, 1.1), 0.05, (n(20), 2 * n(16)))
        tail = fin(
            np.array([-4.9, 0.35, 0.2]),
            np.array([-6.6, 1.25, HEIGHT - BODY_RADIUS - 0.016]),
            (2.0, 0.9),
            0.06,
            (n(12), 2 * n(12)),
        )
        for (vertices, faces), part in ((wing, 2), (tail, 3)):
            pieces.append(((vertices * mirror, faces if side > 0 else faces[:, ::-1]), part))
    vertices, faces, parts, offset = [], [], [], 0
    for (v, f), part in pieces:
        vertices.append(v)
        faces.append(f + offset)
        parts.append(np.full(len(f), part))
        offset += len(v)
    v, f, part = np.concatenate(vertices), np.concatenate(faces), np.concatenate(parts)
    centre = v[f].mean(1)
    body = part == 1
    part[body & (centre[:, 0] > NOSE_X - 3.0)] = 0
    inside = np.hypot(centre[:, 1], centre[:, 2]) < NOZZLE / 2 + 0.03
    part[body & inside & (centre[:, 0] < TAIL_X + 0.7)] = 4
    return v, f, part.astype(np.int32)


def skin_temperature(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Temperature of each face [K]: recovery at Mach 1, stagnation at the nose, a hot after-body up to 360 K.

    Recovery temperature T (1 + r (gamma - 1) / 2 M^2) with r = .85 on the skin (255 K) and 1 at the nose's tip.
    """
    x = vertices[faces].mean(1)[:, 0]
    front, back = x.max(), x.min()
    recovery = 0.85 + 0.15 * np.exp(-(front - x) / 0.3)
    return AMBIENT * (1 + 0.2 * recovery) + 105.0 * np.exp(-(x - back) / 1.2)


def round_jet(core: float = 2000.0, length: float = 30.0, cells: tuple[int, int, int] = (300, 40, 40)):
    """A round jet behind the nozzle on a grid: (grid, temperature [K], exhaust fraction), both [nx, ny, nz].

    Potential core of six nozzle diameters; beyond it the centre line decays as core length over distance. The profile
    across is Gaussian and widens linearly until the visible diameter is 1.2 m at the end.
    """
    width = 1.2
    spacing = np.array([length / cells[0], width / cells[1], width / cells[2]])
    grid = jaxir.Grid((TAIL_X - length, -width / 2, -width / 2), spacing, cells)
    centre = np.asarray(grid.centres(), np.float64)
    behind = TAIL_X - centre[..., 0]
    radius = np.hypot(centre[..., 1], centre[..., 2])
    core_length = 6 * NOZZLE
    axis = np.minimum(1.0, core_length / np.maximum(behind, 1e-9))
    spread = NOZZLE / 2 + (width / 2 - NOZZLE / 2) * behind / length
    mixing = axis * np.exp(-np.log(2) * (radius / (0.55 * spread)) ** 2 * np.minimum(1, behind / core_length + 0.5))
    mixing = np.where(radius < spread, mixing, 0.0)
    return grid, AMBIENT + (core - AMBIENT) * mixing, mixing
