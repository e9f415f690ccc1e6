"""Users who can change the code that a process executes."""

from __future__ import annotations

import os
import stat
import sys
from pathlib import Path

import pytest

from dcp_codec.common import atomic_write as wholefile
from dcp_codec.common.trust import invoking_user, untrusted_writer
from dcp_codec.network import sockets

needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files away")


def test_own_files_are_trusted(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("")
    file.chmod(0o644)
    assert untrusted_writer(file) is None


@pytest.mark.parametrize("which", ["file", "folder", "above"])
def test_files_writable_by_all_users_are_not_trusted(tmp_path: Path, which: str) -> None:
    folder = tmp_path / "above" / "folder"
    folder.mkdir(parents=True)
    file = folder / "file"
    file.write_text("")
    changed = {"file": file, "folder": folder, "above": folder.parent}[which]
    changed.chmod(0o777)
    assert str(untrusted_writer(file)).startswith(f"{changed} can be changed by every user")


def test_a_link_is_followed_to_its_target(tmp_path: Path) -> None:
    open_folder = tmp_path / "open"
    open_folder.mkdir()
    (open_folder / "file").write_text("")
    (tmp_path / "link").symlink_to(open_folder / "file")
    assert untrusted_writer(tmp_path / "link") is None
    open_folder.chmod(0o777)
    assert str(open_folder) in str(untrusted_writer(tmp_path / "link"))
    # A link in an open folder can be replaced, wherever it leads.
    (tmp_path / "file").write_text("")
    (open_folder / "back").symlink_to(tmp_path / "file")
    assert str(open_folder) in str(untrusted_writer(open_folder / "back"))


def test_others_cannot_replace_files_in_a_sticky_folder(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    tmp_path.chmod(0o1777)
    assert untrusted_writer(tmp_path / "file") is None


@needs_root
def test_owners_and_groups(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "file"
    file.write_text("")
    os.chown(file, 65534, 65534)
    assert "belongs to user nobody" in str(untrusted_writer(file))  # prose: data
    assert untrusted_writer(file, owners=(65534,)) is None
    monkeypatch.setenv("SUDO_UID", "65534")
    assert invoking_user() == (65534,)
    monkeypatch.setenv("SUDO_UID", "nobody")
    assert invoking_user() == ()
    os.chown(file, 0, 65534)
    file.chmod(0o664)
    assert "can be changed by group nogroup" in str(untrusted_writer(file))
    os.chown(file, 0, 0)
    assert untrusted_writer(file) is None


def test_a_file_is_synchronised_before_it_is_renamed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    order: list[str] = []
    fsync, replace = os.fsync, Path.replace

    def noted_fsync(fd: int) -> None:
        order.append("fsync folder" if stat.S_ISDIR(os.fstat(fd).st_mode) else "fsync file")
        fsync(fd)

    def noted_replace(self: Path, target: Path) -> Path:
        order.append("rename")
        return replace(self, target)

    def umask(_: int) -> int:
        raise AssertionError("the umask belongs to all threads")

    monkeypatch.setattr(os, "fsync", noted_fsync)
    monkeypatch.setattr(Path, "replace", noted_replace)
    monkeypatch.setattr(os, "umask", umask)
    wholefile.write_whole(tmp_path / "whole", b"octets")
    assert order == ["fsync file", "rename", "fsync folder"]
    assert (tmp_path / "whole").read_bytes() == b"octets"
    assert [each.name for each in tmp_path.iterdir()] == ["whole"]


def test_the_advice_names_only_an_interpreter_of_a_virtual_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = tmp_path / "venv" / "bin" / "python3"
    own.parent.mkdir(parents=True)
    own.write_text("")
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "venv"))
    monkeypatch.setattr(sys, "executable", str(own))
    assert sockets._raw_socket_advice().endswith(f"sudo setcap cap_net_raw+ep {own}")
    system = tmp_path / "python3"
    system.write_text("")
    own.unlink()
    own.symlink_to(system)
    assert str(system) not in sockets._raw_socket_advice()
    monkeypatch.setattr(sys, "prefix", sys.base_prefix)
    monkeypatch.setattr(sys, "executable", str(system))
    assert str(system) not in sockets._raw_socket_advice()
