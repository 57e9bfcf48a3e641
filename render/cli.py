"""`render`: from a config to pictures with known normals."""

from argparse import RawDescriptionHelpFormatter
from collections.abc import Callable
from pathlib import Path

from huesphere.configs.commandline import Parser, finish, path_argument, say, say_wrapped
from huesphere.configs.errors import InputError
from huesphere.render.jobs import add_options
from huesphere.render.listing import KINDS, listed

EXAMPLES = """\
examples:
  render --config mozart_5lights.yaml
  render --config mozart_5gels.yaml --transport linear,full --set camera.read_noise=1e-3
  render --config mozart_5lights.yaml --shape mozart_depth.npz --out run_scan
  render --config photographs --shape ballPNG --set lights.0.colours=gels
  render --config sweep.yaml --jobs 8       eight processes; --shard 3/20 is the third of twenty parts
  render --list                             the configs that ship with huesphere
  render --list spectra                     names for a config: spectra, cameras, reflectances
  render --schema > huesphere.schema.json   for editors that complete YAML
"""


MOST_NAMED = 8
OF_EACH_STEP = ("shape: ", "engine: ", "accuracy: ")  # lines that are left out for sweeps


def main() -> None:
    finish(_command)


def _command() -> None:
    parser = Parser(prog="render", description=__doc__, epilog=EXAMPLES, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("--config", metavar="NAME_OR_PATH", help="a packaged config by name, or a YAML file")
    parser.add_argument(
        "--out", type=path_argument, default=Path("run"), metavar="DIR", help="the run folder (default: run)"
    )
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="override a key: camera.bits=12"
    )
    parser.add_argument(
        "--shape",
        metavar="PATH",
        help="a depth map or mesh in place of the config's shape; with photographs.yaml a folder or npz of photographs",
    )
    parser.add_argument("--transport", metavar="LIST", help="of linear, direct, one-bounce, full; comma-separated")
    parser.add_argument("--seed", type=int, metavar="N", help="of light transport and camera noise")
    parser.add_argument("--engine", choices=("auto", "transport", "reference"), default="auto")
    add_options(parser)
    parser.add_argument("--shard", metavar="I/N", help="only the I-th of N parts of a sweep, from 1, for job arrays")
    parser.add_argument("--retry-failed", action="store_true", help="try items again that failed before")
    parser.add_argument("--overwrite", action="store_true", help="render items again that another config made")
    parser.add_argument("--verbose", action="store_true", help="of a sweep: a line for each step, not one a minute")
    parser.add_argument(
        "--list",
        nargs="?",
        const="configs",
        choices=KINDS,
        metavar="WHAT",
        help="name the packaged configs, or the spectra, cameras or reflectances, and leave",
    )
    parser.add_argument("--no-layers", action="store_true", help="do not write layers.exr, which relighting needs")
    parser.add_argument("--no-previews", action="store_true", help="do not write preview.png")
    parser.add_argument("--schema", action="store_true", help="print the JSON Schema of a config and leave")
    arguments = parser.parse_args()
    if arguments.schema:
        from huesphere.configs.load import export_schema

        say(export_schema().rstrip("\n"))
    elif arguments.list is not None:
        for line in listed(arguments.list):
            say(line)
    elif arguments.config is None:
        parser.error("--config is missing")
    else:
        _render(arguments)


def _render(arguments) -> None:
    from huesphere.configs.load import load_configs

    overrides = list(arguments.set)
    if arguments.transport is not None:
        if any(assignment.partition("=")[0].strip() == "render.transport" for assignment in overrides):
            raise InputError("--transport and --set render.transport=… say the same", expected="one of them")
        overrides.append(f"render.transport=[{arguments.transport}]")
    if arguments.seed is not None:  # before the others: a seed that --set names holds
        overrides = [f"render.seed={arguments.seed}", f"camera.seed={arguments.seed}", *overrides]
    configs = load_configs(arguments.config, overrides=overrides, shape=arguments.shape)

    from huesphere.render.plan import parse_shard
    from huesphere.render.progress import LINE_EVERY, SECONDS_OF_SWEEPS, shown_progress
    from huesphere.render.run import render_configs

    quiet = len(configs) > 1 and not arguments.verbose
    with shown_progress(Path(arguments.config).stem, every=SECONDS_OF_SWEEPS if quiet else LINE_EVERY) as progress:
        ids = render_configs(
            configs,
            arguments.out,
            engine=arguments.engine,
            overwrite=arguments.overwrite,
            retry_failed=arguments.retry_failed,
            jobs=arguments.jobs,
            scheduler=arguments.scheduler,
            shard=parse_shard(arguments.shard) if arguments.shard is not None else None,
            left_out=("layers.exr",) * arguments.no_layers + ("preview.png",) * arguments.no_previews,
            progress=progress,
            log=_said_once() if quiet else say,
        )
    if not ids:
        say(f"nothing of the sweep is in part {arguments.shard}")
        return
    named = ", ".join(ids) if len(ids) <= MOST_NAMED else f"{ids[0]} … {ids[-1]}"
    count = "1 item" if len(ids) == 1 else f"{len(ids)} items"
    say_wrapped(f"{count} in {arguments.out}/: {named}")
    say(f"next: evaluate {arguments.out}")


def _said_once() -> Callable[[str], None]:
    """A log for sweeps: each line once, and nothing that every step says in its own way."""
    told: set[str] = set()

    def log(line: str) -> None:
        if line not in told and not line.startswith(OF_EACH_STEP):
            told.add(line)
            say(line)

    return log


if __name__ == "__main__":
    main()
