"""The house stands: imports run downward only, and a scene compiles no more than it holds."""

import ast
from pathlib import Path

import jaxir

PACKAGE = Path(jaxir.__file__).parent
FLOORS = {"optics": 0, "geometry": 0, "scene": 1, "transport": 2, "render": 3, "fit": 3, "io": 4}
FOUNDATION = 0


def _room(module: str) -> str | None:
    parts = module.split(".")
    return parts[1] if parts[0] == "jaxir" and len(parts) > 1 else None


def _imports(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module)
        elif isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
    return found


def test_imports_run_downward_only():
    seen = 0
    for path in PACKAGE.rglob("*.py"):
        inside = path.relative_to(PACKAGE)
        room = inside.parts[0].removesuffix(".py")
        if room.startswith("_") and room != "__main__":
            if room != "__init__":
                assert all(_room(m) is None or _room(m).startswith("_") for m in _imports(path)), path
            continue
        if room not in FLOORS:
            continue
        for module in _imports(path):
            other = _room(module)
            if other is None or other.startswith("_"):
                continue
            seen += 1
            allowed = other == room or FLOORS[other] < FLOORS[room]
            assert allowed, f"{inside} imports {module}: upward or across the wings"
    assert seen > 20
