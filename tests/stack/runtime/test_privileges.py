"""Actions of a node as root before it changes to another user: that user cannot exploit them."""

from __future__ import annotations

import os
import socket
import stat
from pathlib import Path
from typing import Any

import pytest

from dcp_stack.cli import main
from dcp_stack.node import Node
from dcp_stack.runtime import daemon, opening
from dcp_stack.runtime.channels import ControlSocket, ControlSocketError
from dcp_stack.runtime.driver import Driver
from dcp_stack.runtime.privileges import User, roots_alone
from dcp_stack.runtime.settings import Settings, load_settings

needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can give up being root")
NOBODY = 65534


def test_the_mode_of_the_socket_does_not_come_from_the_umask(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def umask(_: int) -> int:
        raise AssertionError("the umask belongs to all threads")

    monkeypatch.setattr(os, "umask", umask)
    control = ControlSocket(tmp_path / "control")
    assert stat.S_IMODE((tmp_path / "control").lstat().st_mode) == 0o600
    control.close()


@needs_root
def test_a_folder_of_another_user_is_not_controlled_by_root_alone(tmp_path: Path) -> None:
    assert roots_alone(tmp_path)
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    os.chown(theirs, NOBODY, NOBODY)
    below = theirs / "below"
    below.mkdir()
    assert not roots_alone(theirs)
    assert not roots_alone(below)
    (tmp_path / "link").symlink_to(theirs)
    assert not roots_alone(tmp_path / "link")
    assert not roots_alone(Path("/tmp"))
    assert not roots_alone(tmp_path / "missing")


@needs_root
def test_root_does_not_chown_a_socket_that_another_user_could_replace(tmp_path: Path) -> None:
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    os.chown(theirs, NOBODY, NOBODY)
    secret = tmp_path / "secret"
    secret.write_text("of root")
    control = ControlSocket(theirs / "control")
    # An attack between bind and chown.
    (theirs / "control").unlink()
    (theirs / "control").symlink_to(secret)
    with pytest.raises(ControlSocketError, match="not only root can change its folder"):
        control.give_to(NOBODY, NOBODY)
    assert secret.stat().st_uid == 0
    control.close()


@needs_root
def test_a_link_in_a_folder_of_root_is_not_followed(tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_text("of root")
    control = ControlSocket(tmp_path / "control")
    (tmp_path / "control").unlink()
    (tmp_path / "control").symlink_to(secret)
    control.give_to(NOBODY, NOBODY)
    assert secret.stat().st_uid == 0
    control.close()


class _Opened:
    """Opens a node with ``become`` replaced, and says what there was when the privileges were given up."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, **settings: Any) -> None:
        self.then: set[str] | None = None
        watched = [Path(each) for each in (settings.get("control"), settings.get("neighbour_file")) if each]

        def become(user: User) -> None:
            self.then = {each.name for each in watched if each.exists()}

        monkeypatch.setattr(opening, "become", become)
        merged = load_settings(None, {"link": "udp:239.255.73.9:34567", "user": "nobody", **settings})
        assert isinstance(merged, Settings)
        with opening.open_node(merged, Node) as driver:
            self.after = {each.name for each in watched if each.exists()}
            driver._close()


@needs_root
def test_files_in_the_users_folder_are_created_as_the_user(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    os.chown(tmp_path, NOBODY, NOBODY)
    names = {"control": str(tmp_path / "control"), "neighbour_file": str(tmp_path / "table")}
    opened = _Opened(monkeypatch, **names)
    assert opened.then == set()
    assert opened.after == {"control", "table"}


@needs_root
def test_files_in_a_folder_of_root_are_created_as_root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = {"control": str(tmp_path / "control"), "neighbour_file": str(tmp_path / "table")}
    opened = _Opened(monkeypatch, **names)
    assert opened.then == opened.after == {"control", "table"}


@needs_root
def test_root_does_not_open_the_log_file_in_a_folder_of_the_user(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps: list[str] = []
    monkeypatch.setattr(opening, "become", lambda user: steps.append(user.name))
    monkeypatch.setattr(daemon, "log_to", steps.append)
    monkeypatch.setattr(opening, "log_to", steps.append)
    monkeypatch.setattr(Driver, "run", lambda self, ready: self._close())
    started = ["run", "--link", "udp:239.255.73.9:34567", "--user", "nobody", "--control", "none", "--log-file"]
    for owner, order in ((NOBODY, ["nobody", "log"]), (0, ["log", "nobody"])):
        os.chown(tmp_path, owner, owner)
        with pytest.raises(SystemExit) as stop:
            main([*started, str(tmp_path / "log")])
        assert not stop.value.code
        assert [Path(each).name for each in steps] == order
        steps.clear()


def test_a_socket_can_be_connected_to(tmp_path: Path) -> None:
    control = ControlSocket(tmp_path / "control")
    with socket.socket(socket.AF_UNIX) as client:
        client.connect(str(tmp_path / "control"))
    control.close()
