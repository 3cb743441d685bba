"""Words of a command, and how it ends."""

from __future__ import annotations

import argparse
import sys
import warnings
from functools import cache
from pathlib import Path
from typing import NoReturn

from jaxir._version import __version__
from jaxir.command_line._commands import film_command, render_command, show_command, signature_command
from jaxir.command_line._formats import FILM_FORMATS, RENDER_FORMATS, REPORT_FORMATS, SHOW_FORMATS, SIGNATURE_FORMATS
from jaxir.command_line._quantities import QUANTITIES
from jaxir.command_line._report import report_command
from jaxir.plot import COLOURS, PICTURE_SCALES
from jaxir.plot import QUANTITIES as PICTURES
from jaxir.transport import KINDS

DESCRIPTION = "Infrared radiance images and signatures of scenes described in TOML files."
EPILOG = """
A scene file describes mesh, materials, temperatures, plume, lights, air, cameras and bands;
examples/*.toml are complete ones, docs/scene_files.md lists every key.

exit status: 0 when every file was written, 1 for a scene that is wrong, 2 for a wrong command
"""


def main(argv: list[str]) -> int:
    """Run a command.

    Args:
        argv: its words.

    Returns:
        The exit status. Errors of the scene and its files are one line on stderr.
    """
    arguments = _parser().parse_args(argv)
    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        # A scene is checked when it is read and again for every image: what was said is not said again.
        said = cache(lambda text: _say(f"warning: {text}"))
        warnings.showwarning = lambda message, *rest: said(str(message))
        try:
            arguments.command(arguments)
        except KeyboardInterrupt:
            _say("interrupted; nothing was written that is not complete")
            return 130
        except (ValueError, OSError, ImportError, MemoryError, RuntimeError) as error:
            if arguments.traceback:
                raise
            _say(str(error) or type(error).__name__)
            return 1
    return 0


def run() -> NoReturn:
    """The command `jaxir`, which `python -m jaxir` runs too: `main` of the process's words, then the end."""
    sys.exit(main(sys.argv[1:]))


def _say(text: str) -> None:
    """One line on stderr."""
    print(f"jaxir: {' '.join(text.split())}", file=sys.stderr)


def _parser() -> argparse.ArgumentParser:
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(
        prog="jaxir", description=DESCRIPTION, epilog=EPILOG, formatter_class=raw, allow_abbrev=False
    )
    parser.add_argument("--version", action="version", version=f"jaxir {__version__}")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for name, run, said, formats in (
        ("render", render_command, "radiance images, one for each camera", RENDER_FORMATS),
        ("signature", signature_command, "radiant intensity over aspects", SIGNATURE_FORMATS),
        ("film", film_command, "images of all states of the section over, as a film or a strip", FILM_FORMATS),
        ("report", report_command, "images, signature, components and errors in one HTML page", REPORT_FORMATS),
        ("show", show_command, "read and check a scene, say what it holds, draw it; nothing is rendered", SHOW_FORMATS),
    ):
        listed = "\n".join(f"  {suffix:<6} {format_.said}" for suffix, format_ in formats.items())
        command = commands.add_parser(
            name,
            help=said,
            description=said[0].upper() + said[1:] + ".",
            epilog=f"formats, by the ending of FILE:\n{listed}\n",
            formatter_class=raw,
            allow_abbrev=False,
        )
        command.set_defaults(command=run)
        command.add_argument("scene", type=Path, metavar="SCENE.toml", help="the scene file")
        default = {
            "render": "the scene's name with .npz, here",
            "signature": "the scene's name with .csv, here",
            "film": "the scene's name with .gif, here",
            "report": "the scene's name with _report.html, here",
        }
        command.add_argument(
            "-o",
            "--output",
            action="append",
            type=Path,
            metavar="FILE",
            help=f"a file to write, may be repeated (default: {default.get(name, 'none')})",
        )
        if name == "show":
            command.add_argument("--colour", choices=COLOURS, default="part", help="of the faces (default: part)")
        else:
            repeated = "" if name == "report" else "May be repeated, which puts its name into the files' names "
            command.add_argument(
                "-q",
                "--quantity",
                action="store" if name == "report" else "append",
                choices=list(QUANTITIES),
                help="; ".join(f"{quantity}: {what}" for quantity, what in QUANTITIES.items())
                + f". {repeated}(default: apparent)",
            )
        if name == "signature":
            kept = "where every finished view is kept, so that the same command goes on after it was killed"
            command.add_argument("--folder", type=Path, metavar="FOLDER", help=kept)
        if name in ("render", "signature"):
            command.add_argument(
                "--errors",
                action="store_true",
                help="look for what bounces, panels of jets and sunlit cells err, too; compiles more",
            )
            command.add_argument(
                "--components",
                choices=KINDS,
                help="split results by where their light comes from: sources, or parts for each part of the skin, too",
            )
        if name in PICTURE_SCALES:
            command.add_argument("--scale", choices=PICTURE_SCALES[name], help="of a picture")
        if name in ("render", "film"):
            command.add_argument("--picture", choices=PICTURES, help="what a picture shows (default: radiance)")
        command.add_argument("--traceback", action="store_true", help="show where in the program an error arose")
    return parser
