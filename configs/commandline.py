"""The argument parser and the exit codes of all commands: 0 for success, 2 for bad input, 1 for any other error."""

import argparse
import contextlib
import errno
import os
import signal
import sys
import textwrap
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn, TextIO

from huesphere.configs.errors import InputError, Unfinished
from huesphere.configs.file_paths import expanded
from huesphere.configs.output import patient_output
from huesphere.configs.suggest import closest
from huesphere.configs.visible import visible

TERMINAL_WIDTH = 80  # characters of tables and lines
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
                near = closest(word.split("=")[0], known)
                if near:
                    hint = f"; did you mean {near}?"
                    break
        raise InputError(f"{self.prog}: {message}{hint} (see {self.prog} --help)")

    def _print_message(self, message: str, file: Any = None) -> None:
        try:
            super()._print_message(message, file)
        except BrokenPipeError:
            discard(sys.stdout if file is None else file)


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
        say(f"huesphere {installed_version()}")
        parser.exit()


def installed_version() -> str:
    """The version of the installed distribution, or a remark in brackets if huesphere is not installed."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("huesphere")
    except PackageNotFoundError:
        return "(version unknown: huesphere is not installed as a package)"


def finish(command: Callable[[], None]) -> NoReturn:
    """Run ``command``, print its error in one line if it has one, and exit with the code for that end.

    SIGTERM and SIGHUP end it as Ctrl-C does: what is half done is removed, workers are ended, the rest is kept.
    """
    _end_on_signals()
    with patient_output():
        _finish(command)


def _finish(command: Callable[[], None]) -> NoReturn:
    try:
        command()
        _flush()
    except InputError as error:
        _fail(f"error: {error}", 2)
    except KeyboardInterrupt:
        _interrupted()
    except BrokenPipeError:
        discard(sys.stdout)  # somebody closed an output in the midst of work that is not finished
        _fail("error: an output was closed before the work was done: the same command goes on", 1)
    except Unfinished as error:
        _fail(f"error: {error}", 1)
    except Exception as error:
        if is_interrupt(error):
            _interrupted()
        if isinstance(error, OSError) and error.strerror:  # a full disk, a folder that may not be written
            text = f"error: {error.filename or ''}: {error.strerror}".replace(" : ", " ")
            _fail(text, 2 if error.errno in BAD_PATH else 1)
        if isinstance(error, MemoryError):
            _fail("error: not enough memory: smaller pictures, fewer lights or fewer --jobs need less", 1)
        raise
    sys.exit(0)


def say(line: str, stream: TextIO | None = None) -> None:
    """Print a line for the user to ``stream``, stdout by default, with control characters shown (`visible`).

    If the reader has closed the output, as in `… | head`, the work goes on without it.
    """
    stream = sys.stdout if stream is None else stream
    try:
        print(visible(line), file=stream, flush=True)
    except BrokenPipeError:
        discard(stream)


def say_wrapped(text: str) -> None:
    """Say each line of ``text`` in lines of at most TERMINAL_WIDTH characters.

    What goes on in a further line is four spaces in from where the line begins.
    """
    for line in text.split("\n"):
        margin = len(line) - len(line.lstrip(" "))
        for part in wrapped(line, indent=margin + 4) or [""]:
            say(part)


def wrapped(text: str, *, indent: int = 0) -> list[str]:
    """``text`` in lines of at most TERMINAL_WIDTH characters, ``indent`` spaces before all but the first.

    A word that is longer, such as a path, stays whole.
    """
    spaces = " " * indent
    return textwrap.wrap(
        visible(text), TERMINAL_WIDTH, subsequent_indent=spaces, break_long_words=False, break_on_hyphens=False
    )


def discard(stream: TextIO | None) -> None:
    """Send all that is written to ``stream`` from now on nowhere."""
    with contextlib.suppress(OSError, ValueError, AttributeError):
        void = os.open(os.devnull, os.O_WRONLY)
        os.dup2(void, stream.fileno())  # type: ignore[union-attr]
        os.close(void)


def _flush() -> None:
    """Write out what is still to be printed."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except BrokenPipeError:
            discard(stream)


def _fail(text: str, code: int) -> NoReturn:
    say(text, sys.stderr)
    _flush()
    sys.exit(code)


def _end_on_signals() -> None:
    """Let SIGTERM and SIGHUP raise KeyboardInterrupt, unless they are ignored, as under nohup; a second one kills."""
    if threading.current_thread() is not threading.main_thread():
        return

    def end(number: int, frame: Any) -> NoReturn:
        signal.signal(number, signal.SIG_DFL)
        raise KeyboardInterrupt(signal.Signals(number).name)

    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) == signal.SIG_DFL:
            signal.signal(number, end)


def is_interrupt(error: BaseException) -> bool:
    """Whether ``error`` was caused by Ctrl-C, which compiled code turns into an error of its own."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, KeyboardInterrupt):
            return True
        cause = cause.__cause__ or cause.__context__
    return False


def _interrupted() -> NoReturn:
    _fail("interrupted: what was finished is kept", 1)
