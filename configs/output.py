"""Standard output and error of the commands, which never end the work that they tell of.

Characters that the terminal's encoding does not have are written in its own letters. If nobody reads any more (``… |
head``, a closed descriptor), what is still to be said is dropped and the work goes on.
"""

import codecs
import contextlib
import errno
import os
import sys
import unicodedata
from collections.abc import Iterator
from typing import Any

PLAIN = "huesphere.plain"  # name of the error handler for characters that an encoding does not have
IN_ASCII = {
    "°": "deg",
    "±": "+/-",
    "–": "-",
    "—": "-",
    "−": "-",
    "…": "...",
    "≤": "<=",
    "≥": ">=",
    "≈": "~",
    "×": "x",
    "·": "*",
    "→": "->",
    "∞": "inf",
    "λ": "lambda",
    "α": "alpha",
    "ρ": "rho",
    "σ": "sigma",
}
# Errors of the operating system that mean that the output has no reader
NO_READER = (errno.EPIPE, errno.EBADF)


@contextlib.contextmanager
def patient_output() -> Iterator[None]:
    """Make ``sys.stdout`` and ``sys.stderr`` patient within the block, and flush them at its end."""
    _open_descriptors()
    kept = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (_Patient(stream, fd) for stream, fd in zip(kept, (1, 2), strict=True))
    try:
        yield
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        sys.stdout, sys.stderr = (
            stream if stream is not None else one for stream, one in zip(kept, (sys.stdout, sys.stderr), strict=True)
        )


class _Patient:
    """A text stream that writes what it can. All else is as in the stream that it wraps."""

    def __init__(self, stream: Any, descriptor: int) -> None:
        # Python has no stream for a descriptor that was closed when it started.
        self._stream = open(descriptor, "w", closefd=False) if stream is None else stream  # noqa: SIM115

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._stream)

    def write(self, text: str) -> int:
        """Write ``text``; returns its length, whether it could be written or not."""
        try:
            # Asked here, since the stream of errors would write \xb0 instead of refusing a character.
            text.encode(self._stream.encoding or "ascii")
            self._stream.write(text)
        except UnicodeEncodeError:
            self._write_plain(text)
        except OSError as error:
            self._drop(error)
        return len(text)

    def writelines(self, lines: Any) -> None:
        """Write each of ``lines``."""
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        """Hand on what was written."""
        try:
            self._stream.flush()
        except OSError as error:
            self._drop(error)

    def _write_plain(self, text: str) -> None:
        encoding = self._stream.encoding or "ascii"
        data = text.encode(encoding, PLAIN)
        buffer = getattr(self._stream, "buffer", None)
        try:
            if buffer is None:
                self._stream.write(data.decode(encoding, "replace"))
            else:
                self._stream.flush()
                buffer.write(data)
        except OSError as error:
            self._drop(error)

    def _drop(self, error: OSError) -> None:
        """Send what is to come, and what is in the buffer, nowhere. Other errors, such as a full disk, are raised."""
        if error.errno not in NO_READER:
            raise error
        nowhere = os.open(os.devnull, os.O_WRONLY)
        try:
            os.dup2(nowhere, self._stream.fileno())
        finally:
            os.close(nowhere)


def _open_descriptors() -> None:
    """Open the standard descriptors that are closed, lest the first file that is opened takes the place of one."""
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free


def _in_plain_letters(error: UnicodeError) -> tuple[bytes, int]:
    """An error handler of ``codecs``: characters in letters that the encoding has; bytes of file names as they are."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return b"".join(_plain(c, error.encoding) for c in error.object[error.start : error.end]), error.end


def _plain(character: str, encoding: str) -> bytes:
    if "\udc80" <= character <= "\udcff":  # a byte of a file name that is not in the system's encoding
        return bytes([ord(character) - 0xDC00])
    letters = IN_ASCII.get(character) or unicodedata.normalize("NFKD", character).encode("ascii", "ignore").decode()
    return (letters or "?").encode(encoding, "replace")


codecs.register_error(PLAIN, _in_plain_letters)
