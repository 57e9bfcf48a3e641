"""The edge of every command: arguments in, exit code out (0 done, 2 bad input in one line, 1 anything else)."""

import argparse
import errno
import os
import sys
from collections.abc import Callable
from difflib import get_close_matches
from typing import NoReturn

from huesphere.configs.errors import InputError, Unfinished

BAD_PATH = (errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.ENAMETOOLONG, errno.ELOOP)  # what was given, not the disk


class Parser(argparse.ArgumentParser):
    """An argument parser whose complaints are one line, with the nearest known option where one is near."""

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


def finish(command: Callable[[], None]) -> NoReturn:
    """Run ``command`` and leave the process with the exit code that its end deserves."""
    try:
        command()
        sys.stdout.flush()
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        _interrupted()
    except BrokenPipeError:
        # The reader of a pipe went away (`… | head`): that is its right, and no failure of ours.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(0)
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
    """Whether Ctrl-C is behind ``error``: compiled code wraps it in an error of its own."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, KeyboardInterrupt):
            return True
        cause = cause.__cause__ or cause.__context__
    return False


def _interrupted() -> NoReturn:
    print("interrupted: what was finished is kept", file=sys.stderr)
    sys.exit(1)
