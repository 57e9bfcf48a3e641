"""`recover`: surface normals from one colour picture, or from every picture of a run folder."""

from argparse import ArgumentTypeError, RawDescriptionHelpFormatter
from pathlib import Path

from huesphere.configs.commandline import Parser, finish, say
from huesphere.configs.errors import InputError
from huesphere.recover.methods.table import METHODS
from huesphere.render.jobs import add_options

EXAMPLES = """\
examples:
  recover run                                  every picture of a run folder, by the methods of its config
  recover run --method weak-integrability --overwrite
  recover run --depth                          depth too, also of estimates that are there already
  recover photo.jpg --mask outline.png         writes photo-huesphere/: normals, depth, report.html
  recover photo.tif --region 120,80,380,360 --encoding linear
"""


def main() -> None:
    finish(_command)


def _command() -> None:
    listed = "\n".join(f"  {name:<26}{method.does}" for name, method in METHODS.items())
    parser = Parser(
        prog="recover",
        description=__doc__,
        epilog=f"{EXAMPLES}\nmethods (auto if none is named):\n{listed}\n",
        formatter_class=RawDescriptionHelpFormatter,
    )
    parser.add_argument("source", type=Path, metavar="RUN_DIR | PICTURE", help="a run folder, or a picture by path")
    parser.add_argument("--method", action="append", default=[], metavar="NAME", help="may be given more than once")
    parser.add_argument(
        "--depth", action="store_true", help="depth in pixels as well, gaps between normals interpolated"
    )
    add_options(parser)
    parser.add_argument("--overwrite", action="store_true", help="make estimates again that are there already")
    alone = parser.add_argument_group("for a picture")
    alone.add_argument("--region", type=_region, metavar="X0,Y0,X1,Y1", help="pixels from the top left, ends excluded")
    alone.add_argument("--mask", type=Path, metavar="PATH", help="the object: a picture that is bright there")
    alone.add_argument("--encoding", choices=("auto", "srgb", "linear"), help="of the samples (default: auto)")
    alone.add_argument("--out", type=Path, metavar="DIR", help="where to write (default: NAME-huesphere)")
    arguments = parser.parse_args()
    methods = tuple(dict.fromkeys(arguments.method))
    for_picture = {name: getattr(arguments, name) for name in ("region", "mask", "encoding", "out")}
    asked = {"depth": arguments.depth, "overwrite": arguments.overwrite, "report": say}

    from huesphere.recover.run import check_methods, recover_picture, recover_run
    from huesphere.render.manifest import require_all_items

    check_methods(methods)
    if not arguments.source.exists():
        raise InputError("no such run folder or picture", where=arguments.source)
    if arguments.source.is_dir():
        given = [name for name, value in for_picture.items() if value is not None]
        if given:
            raise InputError(f"--{given[0]} is for a picture", got="a run folder", where=arguments.source)
        made = recover_run(arguments.source, methods, jobs=arguments.jobs, scheduler=arguments.scheduler, **asked)
        require_all_items(arguments.source)
        if not made:
            say("nothing to do: every estimate is there (--overwrite makes them again)")
    else:
        if arguments.scheduler is not None or arguments.jobs > 1:
            raise InputError("--jobs and --scheduler are for a run folder", got="a picture", where=arguments.source)
        options = {name: value for name, value in for_picture.items() if value is not None}
        folder = recover_picture(arguments.source, methods, **asked, **options)
        say(f"written: {folder}, page: {folder / 'report.html'}")


def _region(text: str) -> tuple[int, int, int, int]:
    """Four whole numbers, comma-separated."""
    try:
        x0, y0, x1, y1 = (int(part) for part in text.split(","))
    except ValueError:
        raise ArgumentTypeError(f"got {text}, expected four whole numbers X0,Y0,X1,Y1") from None
    return x0, y0, x1, y1


if __name__ == "__main__":
    main()
