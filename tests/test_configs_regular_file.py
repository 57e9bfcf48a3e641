"""What is read is a regular file of bounded size; what is written stays in the folder that was named."""

import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from huesphere.configs.errors import InputError, Unfinished
from huesphere.configs.own_folder import (
    inside,
    is_private,
    made_folder,
    remove_abandoned,
    remove_tree,
    replacing,
    temporary_name,
    write_text,
)
from huesphere.configs.regular_file import read_bytes, read_text
from huesphere.configs.visible import visible


@pytest.fixture
def precious(tmp_path) -> Path:
    """A folder beside the one that is worked in, which must stay as it is."""
    folder = tmp_path / "precious"
    folder.mkdir()
    (folder / "file.txt").write_text("mine")
    return folder


def test_a_named_pipe_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="a named pipe, expected a regular file"):
        read_bytes(tmp_path / "pipe", most=100)


def test_a_device_without_end_is_refused(tmp_path):
    (tmp_path / "link").symlink_to("/dev/zero")
    for path in (Path("/dev/zero"), tmp_path / "link"):
        with pytest.raises(InputError, match="a device"):
            read_bytes(path, most=100)


def test_a_link_is_followed_only_where_it_may_be(tmp_path, precious):
    (tmp_path / "link").symlink_to(precious / "file.txt")
    assert read_text(tmp_path / "link", most=100) == "mine"
    with pytest.raises(InputError, match="a link, which is not followed"):
        read_text(tmp_path / "link", most=100, follow=False)


def test_a_sparse_file_is_refused_by_its_size(tmp_path):
    with (tmp_path / "sparse").open("wb") as file:
        file.truncate(2**34)
    with pytest.raises(InputError, match="got 16 GiB, expected at most 1 KiB"):
        read_bytes(tmp_path / "sparse", most=1024)


def test_a_file_of_the_system_that_says_it_is_empty_is_read_as_far_as_allowed():
    if not Path("/proc/self/maps").exists():
        pytest.skip("no /proc")
    with pytest.raises(InputError, match="too large"):
        read_bytes(Path("/proc/self/maps"), most=10)


@pytest.mark.parametrize("part", ["..", "a/../../x", "", "a//b", "/etc", "a\0b", "x" * 300])
def test_no_part_of_a_path_leads_out(tmp_path, part):
    with pytest.raises(InputError, match="leads out"):
        inside(tmp_path, part)


def test_a_link_within_the_folder_is_refused_and_the_folder_itself_may_be_one(tmp_path, precious):
    (tmp_path / "run").mkdir()
    (tmp_path / "run/link").symlink_to(precious)
    (tmp_path / "way").symlink_to(tmp_path / "run")
    assert inside(tmp_path / "way", "a/b") == tmp_path / "way/a/b"
    for folder in (tmp_path / "run", tmp_path / "way"):
        with pytest.raises(InputError, match="a link"):
            made_folder(folder, "link/new")
    assert not (precious / "new").exists()


def test_writing_replaces_a_link_and_not_what_it_leads_to(tmp_path, precious):
    (tmp_path / "page.html").symlink_to(precious / "file.txt")
    write_text(tmp_path / "page.html", "new")
    assert (precious / "file.txt").read_text() == "mine"
    assert (tmp_path / "page.html").read_text() == "new"
    assert not (tmp_path / "page.html").is_symlink()


def test_temporary_names_cannot_be_foretold_and_are_never_opened_twice(tmp_path, monkeypatch):
    names = {temporary_name(tmp_path / "a").name for _ in range(50)}
    assert len(names) == 50
    monkeypatch.setattr("huesphere.configs.own_folder.temporary_name", lambda path: tmp_path / "guessed")
    (tmp_path / "guessed").symlink_to(tmp_path / "target")
    with pytest.raises(FileExistsError), replacing(tmp_path / "a"):
        pass
    assert not (tmp_path / "target").exists()


def test_what_was_not_finished_leaves_the_old_file_and_nothing_else(tmp_path):
    write_text(tmp_path / "a", "old")

    def interrupted():
        with replacing(tmp_path / "a") as partial:
            partial.write_text("ne")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
    assert (tmp_path / "a").read_text() == "old"


def test_written_files_have_the_permissions_that_the_user_asks_for(tmp_path):
    before = os.umask(0o027)
    try:
        write_text(tmp_path / "a", "x")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == 0o640


def test_deleting_a_tree_deletes_no_target_of_a_link(tmp_path, precious):
    (tmp_path / "old").mkdir()
    (tmp_path / "old/link").symlink_to(precious)
    (tmp_path / "way").symlink_to(precious)
    remove_tree(tmp_path / "old")
    remove_tree(tmp_path / "way")
    assert (precious / "file.txt").read_text() == "mine"
    assert [path.name for path in tmp_path.iterdir()] == ["precious"]


def test_only_what_a_dead_process_left_is_removed(tmp_path):
    dead = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, text=True)
    ours = temporary_name(tmp_path / "ours")
    theirs = Path(str(ours).replace(f".{os.getpid()}.", f".{dead.stdout.strip()}."))
    for path in (ours, theirs, tmp_path / ".hidden", tmp_path / ".x.elsewhere.1.0123456789abcdef.partial"):
        path.mkdir()
    remove_abandoned(tmp_path)
    assert ours.exists()
    assert not theirs.exists()
    assert (tmp_path / ".hidden").exists()
    assert (tmp_path / ".x.elsewhere.1.0123456789abcdef.partial").exists()


def test_a_folder_that_others_can_write_to_is_not_private(tmp_path):
    (tmp_path / "own").mkdir(mode=0o700)
    (tmp_path / "open").mkdir()
    (tmp_path / "open").chmod(0o777)
    (tmp_path / "link").symlink_to(tmp_path / "own")
    assert [is_private(tmp_path / name) for name in ("own", "open", "link", "none")] == [True, False, False, False]


def test_control_characters_are_shown_and_not_sent():
    assert visible("a\x1b[2J\x07\x9b\x7f\r") == "a\\x1b[2J\\x07\\x9b\\x7f\\x0d"
    assert visible("\u202eabc\u2028") == "\\u202eabc\\u2028"
    assert visible("grün 测试 \t one\ntwo") == "grün 测试 \t one\ntwo"
    assert "\x1b" not in str(InputError("x", got="\x1b[31m", where="\x1b]0;t\x07"))
    assert "\x1b" not in str(Unfinished("a\x1bb"))
