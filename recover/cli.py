"""`recover`: surface normals from one colour picture, or from every picture of a run folder."""

import textwrap
from argparse import ArgumentTypeError, Namespace, RawDescriptionHelpFormatter
from collections import Counter
from contextlib import nullcontext
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from huesphere.configs.commandline import TERMINAL_WIDTH, Parser, finish, path_argument, say, say_wrapped
from huesphere.configs.errors import InputError
from huesphere.recover.methods.table import METHODS, check_methods
from huesphere.render.jobs import add_options

if TYPE_CHECKING:
    from huesphere.recover.io.stored import ReadOptions
    from huesphere.recover.rig.ball import Ball

FOR_PICTURES = ("region", "mask", "encoding", "effort")  # options of pictures by path, as the parser stores them

MOST_TOLD = 12  # most pictures of a run folder whose estimates are told one by one

EXAMPLES = """\
examples:
  recover run                                  every picture of a run folder, by the methods of its config
  recover run --method weak-integrability --overwrite
  recover run --depth                          depth too, also of estimates that are there already
  recover photo.jpg --mask outline.png         writes photo-huesphere/: normals, depth, report.html
  recover shots/*.jpg --jobs 8 --out results   a folder and a page for each
  recover photo.tif --region 120,80,380,360 --encoding linear
  recover photo.dng --dark dark.dng --flat flat.dng        a camera's own file, with its frames
  recover --calibrate press*.png --ball 155,118,36,3.8 --ball 134,108,36,3.8 --reference empty.png    writes rig.json
  recover touch.png --rig rig.json --reference empty.png   normals and depth at once, lights known from the ball
"""
FOR_RIGS = ("reference", "ball")
NOT_OF_RIGS = ("region", "effort")  # options that a rig has no use for


def main() -> None:
    finish(_command)


# More than sixty lines: most are the options, one a line, and then the ways to go on in the order of their tests.
def _command() -> None:
    listed = "\n".join(f"  {line}" for line in _listed(78))
    parser = Parser(
        prog="recover",
        description=__doc__,
        epilog=f"{EXAMPLES}\nmethods (auto if none is named):\n{listed}\n",
        formatter_class=RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "sources", type=path_argument, nargs="*", metavar="RUN_DIR | PICTURE", help="a run folder, or pictures by path"
    )
    parser.add_argument("--method", action="append", default=[], metavar="NAME", help="may be given more than once")
    parser.add_argument("--list", action="store_true", help="name the methods, with what each does, and leave")
    parser.add_argument("--verbose", action="store_true", help="of many pictures: a line for each estimate")
    parser.add_argument(
        "--depth", action="store_true", help="depth in pixels as well, gaps between normals interpolated"
    )
    parser.add_argument(
        "--out", type=path_argument, metavar="DIR", help="where to write (default: the run folder, or NAME-huesphere)"
    )
    add_options(parser)
    parser.add_argument("--overwrite", action="store_true", help="make estimates again that are there already")
    alone = parser.add_argument_group("for a picture")
    alone.add_argument(
        "--effort", choices=("quick", "normal", "thorough"), help="pixels on which lights are found: 10k, 90k, all"
    )
    alone.add_argument("--region", type=_region, metavar="X0,Y0,X1,Y1", help="pixels from the top left, ends excluded")
    alone.add_argument("--mask", type=path_argument, metavar="PATH", help="the object: bright, or not 0, there")
    alone.add_argument(
        "--encoding", choices=("auto", "srgb", "linear"), help="of the samples (default: auto, as the file says)"
    )
    alone.add_argument("--part", metavar="NAME", help="of an OpenEXR or TIFF file of several: name, or number from 0")
    alone.add_argument("--layer", metavar="NAME", help="of an OpenEXR file: ViewLayer.Combined, or Combined")
    alone.add_argument("--dark", type=path_argument, metavar="PATH", help="dark frame, lens covered: subtracted")
    alone.add_argument("--flat", type=path_argument, metavar="PATH", help="flat frame, an even white surface: divides")
    alone.add_argument("--white-level", type=_level, metavar="N", help="stored value from which samples are clipped")
    alone.add_argument("--half-size", action="store_true", help="raw files: a pixel for each cell of the mosaic")
    alone.add_argument("--white-balance", choices=("none", "camera"), default="none", help="raw files (default: none)")
    _add_rig_options(parser)
    arguments = parser.parse_args()
    if arguments.list:
        for line in _listed(TERMINAL_WIDTH):
            say(line)
        return
    if not arguments.sources:
        parser.error("the following arguments are required: RUN_DIR | PICTURE")
    methods = tuple(dict.fromkeys(arguments.method))
    check_methods(methods)
    for source in arguments.sources:
        if not source.exists():
            raise InputError("no such run folder or picture", where=source)
    folders = [source for source in arguments.sources if source.is_dir()]
    if arguments.calibrate or arguments.rig is not None:
        _by_rig(folders, methods, arguments)
        return
    _refuse_rig_options(arguments)
    if folders and len(arguments.sources) > 1:
        raise InputError("several sources", got="a folder among them", expected="pictures", where=folders[0])
    asked = {"depth": arguments.depth, "overwrite": arguments.overwrite, "report": say_wrapped, "out": arguments.out}
    if folders:
        _of_run(folders[0], methods, arguments, asked)
    else:
        _of_pictures(arguments.sources, methods, arguments, asked)


def _add_rig_options(parser: Parser) -> None:
    """Options of calibrated rigs."""
    fixed = parser.add_argument_group("for a rig of fixed lights: a tactile sensor, or lamps that stay where they are")
    fixed.add_argument("--calibrate", action="store_true", help="the pictures show a ball: write rig.json, into --out")
    fixed.add_argument(
        "--ball",
        type=_ball,
        action="append",
        metavar="X,Y,R[,MM]",
        help="its centre and radius in pixels from the top left, its radius in mm; one a picture (default: found)",
    )
    fixed.add_argument(
        "--reference", type=path_argument, metavar="PATH", help="the empty rig: pictures are divided by it"
    )
    fixed.add_argument("--rig", type=path_argument, metavar="RIG_JSON", help="normals by a calibrated rig")


def _refuse_rig_options(arguments: Namespace) -> None:
    """Raise InputError for options that only --calibrate and --rig have a use for."""
    for name in FOR_RIGS:
        if getattr(arguments, name) is not None:
            raise InputError(f"--{name} is for --calibrate and --rig", got="neither", where=arguments.sources[0])


def _listed(width: int) -> list[str]:
    """The methods and what each does, in lines of at most ``width`` characters."""
    column = max(map(len, METHODS)) + 2
    texts = (f"{name:<{column}}{method.does}" for name, method in METHODS.items())
    return [line for text in texts for line in textwrap.wrap(text, width, subsequent_indent=" " * column)]


def _of_run(folder: Path, methods: tuple[str, ...], arguments: Namespace, asked: dict[str, Any]) -> None:
    """Recover every picture of a run folder. Raises InputError for options that are for pictures by path."""
    from huesphere.recover.io.stored import ReadOptions
    from huesphere.recover.run import recover_run
    from huesphere.render.manifest import read_manifest, require_all_items
    from huesphere.render.progress import SECONDS_OF_SWEEPS, shown_progress

    given = [name for name in FOR_PICTURES if getattr(arguments, name) is not None]
    given += [f.name for f in fields(ReadOptions) if getattr(arguments, f.name) != f.default]
    if given:
        option = f"--{given[0].replace('_', '-')}"
        raise InputError(f"{option} is for a picture", got="a run folder", where=folder)
    many = len(read_manifest(folder)["items"]) > MOST_TOLD and not arguments.verbose
    with (
        shown_progress("recover", every=SECONDS_OF_SWEEPS)
        if many
        else nullcontext(lambda share, what: None) as progress
    ):
        asked |= {"progress": progress} | ({"report": lambda line: None} if many else {})
        made = recover_run(folder, methods, jobs=arguments.jobs, scheduler=arguments.scheduler, **asked)
    require_all_items(folder)
    if many and made:
        counts = Counter(one.status for _, one in made)
        told = ", ".join(f"{number} {status}" for status, number in counts.most_common())
        say(f"{len(made)} estimates: {told} (--verbose tells each)")
    if not made:
        say("nothing to do: every estimate is there (--overwrite makes them again)")


def _of_pictures(paths: list[Path], methods: tuple[str, ...], arguments: Namespace, asked: dict[str, Any]) -> None:
    """Recover pictures by path, one at a time or, if there are several, in several processes."""
    from huesphere.recover.one_picture import recover_picture, recover_pictures
    from huesphere.render.progress import shown_progress

    if arguments.scheduler is not None:
        raise InputError("--scheduler is for a run folder", got="a picture", where=paths[0])
    asked |= {name: getattr(arguments, name) for name in FOR_PICTURES if getattr(arguments, name) is not None}
    asked["options"] = _read_options(arguments)
    if len(paths) > 1:
        written = recover_pictures(paths, methods, jobs=arguments.jobs, **asked)
        say(f"written: {len(written)} folders, {written[0]} … {written[-1]}, each with a page, report.html")
        return
    if arguments.jobs > 1:
        raise InputError("--jobs is for several pictures or a run folder", got="a picture", where=paths[0])
    folder = recover_picture(paths[0], methods, shown=shown_progress, **asked)
    say_wrapped(f"written: {folder}, page: {folder / 'report.html'}")


def _by_rig(folders: list[Path], methods: tuple[str, ...], arguments: Namespace) -> None:
    """Calibrate a rig, or use one. Raises InputError for options that have no meaning then."""
    from huesphere.recover.rig.command import RigOptions, calibrate_rig, recover_by_rig

    option = "--calibrate" if arguments.calibrate else "--rig"
    if folders:
        raise InputError(f"{option} is for pictures", got="a folder", where=folders[0])
    given = [name for name in NOT_OF_RIGS if getattr(arguments, name) is not None]
    given += ["method"] * bool(methods) + ["jobs"] * (arguments.jobs > 1)
    given += ["scheduler"] * (arguments.scheduler is not None)
    given += ["rig"] * (arguments.calibrate and arguments.rig is not None)
    given += ["depth"] * (arguments.calibrate and arguments.depth)
    given += ["ball"] * (not arguments.calibrate and arguments.ball is not None)
    if given:
        raise InputError(f"--{given[0]} cannot go with {option}", where=arguments.sources[0])
    options = RigOptions(
        reference=arguments.reference,
        mask=arguments.mask,
        encoding=arguments.encoding or "auto",
        reading=_read_options(arguments),
        out=arguments.out,
        overwrite=arguments.overwrite,
    )
    if arguments.calibrate:
        say(f"written: {calibrate_rig(arguments.sources, arguments.ball or (), options, report=say_wrapped)}")
        return
    written = recover_by_rig(arguments.sources, arguments.rig, options, report=say_wrapped)
    for folder in written:
        say_wrapped(f"written: {folder}, page: {folder / 'report.html'}")


def _read_options(arguments: Namespace) -> "ReadOptions":
    """What the command line says of how a picture file is to be read."""
    from huesphere.recover.io.stored import ReadOptions

    return ReadOptions(**{field.name: getattr(arguments, field.name) for field in fields(ReadOptions)})


def _ball(text: str) -> "Ball":
    """Centre x, y and radius in pixels, and perhaps the radius in millimetres."""
    try:
        numbers = [float(part) for part in text.split(",")]
        good = len(numbers) in (3, 4) and all(abs(number) < 1e9 for number in numbers)
    except ValueError:
        good = False
    if not good or (len(numbers) == 4 and numbers[3] <= 0):
        raise ArgumentTypeError(f"got {text}, expected X,Y,R in pixels, or X,Y,R,MM with the radius in millimetres")
    from huesphere.recover.rig.ball import Ball

    return Ball(*numbers)


def _region(text: str) -> tuple[int, int, int, int]:
    """Four whole numbers, comma-separated."""
    try:
        x0, y0, x1, y1 = (int(part) for part in text.split(","))
    except ValueError:
        raise ArgumentTypeError(f"got {text}, expected four whole numbers X0,Y0,X1,Y1") from None
    return x0, y0, x1, y1


def _level(text: str) -> float:
    """A positive number."""
    try:
        level = float(text)
    except ValueError:
        level = float("nan")
    if not 0 < level < float("inf"):
        raise ArgumentTypeError(f"got {text}, expected a positive number, in the file's own units")
    return level


if __name__ == "__main__":
    main()
