"""Output that nobody reads, or that the terminal has no letters for, does not end the work."""

import io
import os
import subprocess
import sys
import textwrap

import pytest

from huesphere.configs.output import _Patient

PROGRAM = textwrap.dedent(
    """
    import sys
    from huesphere.configs.commandline import finish
    def command():
        print("±3° of " + sys.argv[2])
        for n in range(20000):
            print("line", n, flush=n % 1000 == 0)
        print("caf\\udce9 — ✓ 界", file=sys.stderr)
        open(sys.argv[1], "w").write("done")
    finish(command)
    """
)


def run(tmp_path, tail="", **environment):
    (tmp_path / "program.py").write_text(PROGRAM, encoding="utf-8")
    command = f'"{sys.executable}" "{tmp_path}/program.py" "{tmp_path}/done" it {tail}'
    return subprocess.run(["bash", "-c", command], capture_output=True, env={**os.environ, **environment}, timeout=60)


@pytest.mark.parametrize(
    "tail",
    [
        "| head -1 >/dev/null; exit ${PIPESTATUS[0]}",
        ">&-",
        ">&- 2>&-",
        ">&- 2>&- <&-",
        "2>&1 | true; exit ${PIPESTATUS[0]}",
    ],
)
def test_a_closed_output_does_not_end_the_work(tmp_path, tail):
    done = run(tmp_path, tail)
    assert done.returncode == 0
    assert (tmp_path / "done").read_text() == "done"
    assert b"Traceback" not in done.stderr
    assert b"Broken" not in done.stderr


def test_a_full_disk_is_still_an_error(tmp_path):
    done = run(tmp_path, ">/dev/full")
    assert done.returncode == 1
    assert done.stderr.startswith(b"error: No space left on device")


@pytest.mark.parametrize(
    ("environment", "first", "last"),
    [
        ({"PYTHONIOENCODING": "ascii"}, b"+/-3deg of it", b"caf\xe9 - ? ?\n"),
        ({"PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "LC_ALL": "C"}, b"+/-3deg of it", b"caf\xe9 - ? ?\n"),
        ({"PYTHONIOENCODING": "latin-1"}, b"\xb13\xb0 of it", b"caf\xe9 - ? ?\n"),
        ({"PYTHONIOENCODING": "utf-8"}, "±3° of it".encode(), b"caf\xe9 \xe2\x80\x94 \xe2\x9c\x93 \xe7\x95\x8c\n"),
    ],
)
def test_what_an_encoding_does_not_have_is_written_in_its_letters(tmp_path, environment, first, last):
    done = run(tmp_path, **environment)
    assert done.returncode == 0
    assert done.stdout.splitlines()[0] == first
    assert done.stderr == last


def test_a_stream_without_bytes_below_it_is_written_to_as_well():
    class Narrow(io.StringIO):
        encoding = "ascii"

    stream = Narrow()
    assert _Patient(stream, 1).write("5° → 6°") == 7
    assert stream.getvalue() == "5deg -> 6deg"
