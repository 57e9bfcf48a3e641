"""The argument parser and the exit codes of all commands: 0 for success, 2 for bad input, 1 for any other error."""

import argparse
import errno
import sys
from collections.abc import Callable, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NoReturn

from huesphere.configs.errors import InputError, Unfinished
from huesphere.configs.file_paths import expanded
from huesphere.configs.output import patient_output

# Errors of the operating system that mean that a given path is wrong, rather than that the disk is
BAD_PATH = (errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.ENAMETOOLONG, errno.ELOOP)


class Parser(argparse.ArgumentParser):
    """An argument parser with ``--version``; its errors are InputErrors that suggest the most similar option."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.add_argument("--version", action=_ShowVersion)

    def error(self, message: str) -> NoReturn:
        hint = ""
        if message.startswith("unrecognized arguments:"):
            known = [o for action in self._actions for o in action.option_strings]
            for word in message.split(":", 1)[1].split():
                near = get_close_matches(word.split("=")[0], known, n=1)
                if near:
                    hint = f"; did you mean {near[0]}?"
                    break
        raise InputError(f"{self.prog}: {message}{hint} (see {self.prog} --help)")


def path_argument(text: str) -> Path:
    """The path of an argument, with ``~`` and ``$VARIABLE`` replaced, which a shell does not do in ``--out=~/run``."""
    try:
        return Path(expanded(text))
    except InputError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


class _ShowVersion(argparse.Action):
    """Print the version of huesphere and exit with code 0. The version is looked up only when the option is given."""

    def __init__(self, option_strings: Sequence[str], dest: str) -> None:
        super().__init__(option_strings, argparse.SUPPRESS, nargs=0, help="print the version of huesphere and exit")

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        print(f"huesphere {installed_version()}")
        parser.exit()


def installed_version() -> str:
    """The version of the installed distribution, or a remark in brackets if huesphere is not installed."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("huesphere")
    except PackageNotFoundError:
        return "(version unknown: huesphere is not installed as a package)"


def finish(command: Callable[[], None]) -> NoReturn:
    """Run ``command``, print its error in one line if it has one, and exit with the code for that end."""
    with patient_output():
        _finish(command)


def _finish(command: Callable[[], None]) -> NoReturn:
    try:
        command()
        sys.stdout.flush()
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        _interrupted()
    except Unfinished as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(1)
    except Exception as error:
        if is_interrupt(error):
            _interrupted()
        if isinstance(error, OSError) and error.strerror:  # a full disk, a folder that may not be written
            print(f"error: {error.filename or ''}: {error.strerror}".replace(" : ", " "), file=sys.stderr)
            sys.exit(2 if error.errno in BAD_PATH else 1)
        raise
    sys.exit(0)


def is_interrupt(error: BaseException) -> bool:
    """Whether ``error`` was caused by Ctrl-C, which compiled code turns into an error of its own."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, KeyboardInterrupt):
            return True
        cause = cause.__cause__ or cause.__context__
    return False


def _interrupted() -> NoReturn:
    print("interrupted: what was finished is kept", file=sys.stderr)
    sys.exit(1)
