"""Mitsuba 3 on the experiments it can do (extra `peers`; a shared library of LLVM >= 19 in DRJIT_LIBLLVM_PATH)."""

import functools
import importlib.util
import subprocess
import sys

import numpy as np

PROBE = """
import drjit
import mitsuba

mitsuba.set_variant("llvm_ad_mono")
film = {"type": "hdrfilm", "width": 4, "height": 4}
shape = {"type": "rectangle", "emitter": {"type": "area", "radiance": 1.0}}
sensor = {"type": "perspective", "film": film}
scene = {"type": "scene", "integrator": {"type": "path"}, "sensor": sensor, "shape": shape}
drjit.eval(mitsuba.render(mitsuba.load_dict(scene), spp=4))
"""


@functools.cache
def trouble(probe=PROBE):
    """Why Mitsuba does not run here, in a line; "" where it does.

    Asked in a process of its own, by a small image: with an old LLVM it ends the process instead of raising an error,
    and sums alone do not show that.
    """
    if importlib.util.find_spec("mitsuba") is None:
        return 'it is not installed (pip install "jaxir[peers]")'
    ran = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True)
    if ran.returncode == 0:
        return ""
    how = f"ends by signal {-ran.returncode}" if ran.returncode < 0 else f"ends with status {ran.returncode}"
    said = [line.strip() for line in ran.stderr.splitlines() if line.strip()]
    return f"a process that loads it {how}{f': {said[-1][:150]}' if said else ''}"


def load():
    """The modules mitsuba and drjit in the variant `llvm_ad_mono`, on one thread; None where they do not run."""
    why = trouble()
    if why:
        print(f"Mitsuba is not measured: {why}")
        return None
    try:
        import drjit
        import mitsuba

        mitsuba.set_variant("llvm_ad_mono")
        drjit.set_thread_count(1)
        mitsuba.set_log_level(mitsuba.LogLevel.Error)
        drjit.eval(drjit.arange(mitsuba.Float, 4) + 1)
    except Exception as error:  # whatever is missing, the study goes on without it
        print(f"Mitsuba is not measured: {error}")
        return None
    return mitsuba, drjit


def sensor(mi, frame, target, width, shape, sampler, count):
    """An orthographic sensor that sees what `jaxir.orthographic_camera` sees; `width` is that of the image [m]."""
    side = mi.ScalarTransform4f
    origin = (np.asarray(target) + 100 * frame[2]).tolist()
    look = side().look_at(origin=origin, target=np.asarray(target).tolist(), up=frame[1].tolist())
    return {
        "type": "orthographic",
        "to_world": look @ side().scale([width / 2, width / 2, 1]),
        "near_clip": 0.1,
        "far_clip": 300.0,
        "film": {
            "type": "hdrfilm",
            "width": shape[1],
            "height": shape[0],
            "pixel_format": "luminance",
            "rfilter": {"type": "box"},
        },
        "sampler": {"type": sampler, "sample_count": count},
    }


def mesh(mi, vertices, faces, bsdf, emitter=None):
    """Triangles with face normals."""
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf)
    if emitter is not None:
        properties["emitter"] = mi.load_dict(emitter)
    properties["face_normals"] = True
    shape = mi.Mesh("mesh", len(vertices), len(faces), props=properties)
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = np.asarray(vertices, np.float32).ravel()
    parameters["faces"] = np.asarray(faces, np.uint32).ravel()
    parameters.update()
    return shape


def renderer(mi, dr, scene, count, channels=1):
    """A function of a seed: the image [row, column], or of several channels, of `count` rays per pixel."""
    loaded = mi.load_dict(scene)

    def run(seed):
        image = mi.render(loaded, spp=count, seed=seed)
        dr.eval(image)
        dr.sync_thread()
        return np.asarray(image)[:, :, 0] if channels == 1 else np.asarray(image)[:, :, :channels]

    return run


def exact_walk(mi, dr, low, spacing, shape, extinction, emission, origin, direction):
    """The exact sum over the cells of each ray, cell by cell in a symbolic Dr.Jit loop; a function of a seed.

    Rays start outside the grid and meet it; the walk is that of Amanatides and Woo (Eurographics 1987).
    """
    table_u, table_j = (mi.Float(np.ascontiguousarray(field, np.float32).ravel()) for field in (extinction, emission))
    o = [mi.Float(np.ascontiguousarray(origin[:, axis], np.float32)) for axis in range(3)]
    d = [mi.Float(np.ascontiguousarray(direction[:, axis], np.float32)) for axis in range(3)]
    stride = (shape[1] * shape[2], shape[2], 1)

    def run(_):
        near, far = mi.Float(0), mi.Float(1e30)
        entry, leave = [], []
        for axis in range(3):
            moving = dr.abs(d[axis]) > 1e-12
            inverse = dr.select(moving, 1 / d[axis], 1e30)
            t0 = (low[axis] - o[axis]) * inverse
            t1 = (low[axis] + shape[axis] * spacing[axis] - o[axis]) * inverse
            entry.append(dr.select(moving, dr.minimum(t0, t1), -1e30))
            leave.append(dr.select(moving, dr.maximum(t0, t1), 1e30))
            near, far = dr.maximum(near, entry[-1]), dr.minimum(far, leave[-1])
        cells, steps, nexts, widths = [], [], [], []
        for axis in range(3):
            place = (o[axis] + near * d[axis] - low[axis]) / spacing[axis]
            cell = dr.clip(mi.Int(dr.floor(place)), 0, shape[axis] - 1)
            moving = dr.abs(d[axis]) > 1e-12
            step = dr.select(d[axis] > 0, mi.Int(1), mi.Int(-1))
            edge = low[axis] + (cell + dr.select(step > 0, mi.Int(1), mi.Int(0))) * spacing[axis]
            nexts.append(dr.select(moving, (edge - o[axis]) / d[axis], 1e30))
            widths.append(dr.select(moving, spacing[axis] / dr.abs(d[axis]), 1e30))
            cells.append(cell)
            steps.append(step)
        x, y, z = cells
        nx, ny, nz = nexts
        t, total, passed = mi.Float(near), mi.Float(0), mi.Float(1)
        active = near < far

        def body(x, y, z, nx, ny, nz, t, total, passed, active):
            end = dr.minimum(dr.minimum(dr.minimum(nx, ny), nz), far)
            index = mi.UInt32(x * stride[0] + y * stride[1] + z * stride[2])
            mu, j = dr.gather(mi.Float, table_u, index, active), dr.gather(mi.Float, table_j, index, active)
            length = dr.maximum(end - t, 0)
            u = mu * length
            lost = dr.select(u < 1e-3, u * (1 - u / 2 + u * u / 6), 1 - dr.exp(-u))
            total += dr.select(active, passed * lost * j / dr.maximum(mu, 1e-30), 0)
            passed *= dr.select(active, 1 - lost, 1)
            go_x, go_y = nx <= dr.minimum(ny, nz), ny <= nz
            move_x, move_y = go_x, ~go_x & go_y
            move_z = ~go_x & ~go_y
            x += dr.select(move_x, steps[0], 0)
            y += dr.select(move_y, steps[1], 0)
            z += dr.select(move_z, steps[2], 0)
            nx += dr.select(move_x, widths[0], 0)
            ny += dr.select(move_y, widths[1], 0)
            nz += dr.select(move_z, widths[2], 0)
            inside = (x >= 0) & (y >= 0) & (z >= 0) & (x < shape[0]) & (y < shape[1]) & (z < shape[2])
            return x, y, z, nx, ny, nz, mi.Float(end), total, passed, active & inside & (end < far)

        state = (x, y, z, nx, ny, nz, t, total, passed, active)
        state = dr.while_loop(state, lambda *state: state[-1], body)
        dr.eval(state[7])
        dr.sync_thread()
        return np.asarray(state[7])

    return run
