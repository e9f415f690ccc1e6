"""The default place of the control socket, and its permissions."""

from __future__ import annotations

import grp
import os
import socket
import stat

import pytest

from dcp_stack.control.places import SYSTEM, default_socket, find_socket, is_answered, places
from dcp_stack.runtime.settings import SettingsError
from dcp_stack.runtime.sharing import find_group, parse_mode, share


class TestPlaces:
    def test_the_runtime_folder_of_the_user(self, tmp_path, monkeypatch):
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
        assert default_socket() == tmp_path / "dcp-node.sock"
        assert places() == [tmp_path / "dcp-node.sock", SYSTEM]

    @pytest.mark.parametrize("folder", [None, "", "relative", "/there/is/none"])
    def test_without_a_runtime_folder_only_root_has_a_default_place(self, folder, monkeypatch):
        monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
        if folder is not None:
            monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        monkeypatch.setattr(os, "geteuid", lambda: 1000)
        assert default_socket() is None
        monkeypatch.setattr(os, "geteuid", lambda: 0)
        assert default_socket() == SYSTEM
        assert places() == [SYSTEM]

    def test_an_existing_socket_is_found(self, tmp_path, monkeypatch):
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
        monkeypatch.setattr("dcp_stack.control.places.SYSTEM", tmp_path / "system.sock")
        assert find_socket() is None
        (tmp_path / "system.sock").touch()
        assert find_socket() == tmp_path / "system.sock"
        (tmp_path / "dcp-node.sock").touch()
        assert find_socket() == tmp_path / "dcp-node.sock"

    def test_a_socket_without_a_listener(self, tmp_path):
        path = tmp_path / "s"
        assert not is_answered(path)
        with socket.socket(socket.AF_UNIX) as listener:
            listener.bind(str(path))
            assert not is_answered(path)
            listener.listen(1)
            assert is_answered(path)
        assert not is_answered(path)

    def test_a_socket_of_another_kind_is_in_use(self, tmp_path):
        """A node must not remove it: connecting fails, but another program may receive from it."""
        path = tmp_path / "log"
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as other:
            other.bind(str(path))
            assert is_answered(path)


@pytest.fixture
def bound(tmp_path):
    path = tmp_path / "node.sock"
    with socket.socket(socket.AF_UNIX) as listener:
        os.fchmod(listener.fileno(), 0o600)
        listener.bind(str(path))
        yield path


class TestSharing:
    def test_nothing_changes_without_settings(self, bound):
        share(bound, None, None)
        assert stat.S_IMODE(bound.stat().st_mode) == 0o600

    def test_a_group_may_use_it(self, bound):
        group = grp.getgrgid(os.getgid())
        share(bound, group.gr_name, None)
        assert (stat.S_IMODE(bound.stat().st_mode), bound.stat().st_gid) == (0o660, group.gr_gid)

    def test_a_configured_mode(self, bound):
        share(bound, None, "0666")
        assert stat.S_IMODE(bound.stat().st_mode) == 0o666

    @pytest.mark.parametrize("text", ["rw", "0060", "99", "7777", "-1", "0400"])
    def test_invalid_modes(self, text):
        with pytest.raises(SettingsError, match="control_mode"):
            parse_mode(text)

    def test_groups(self):
        assert find_group("0") == 0
        with pytest.raises(SettingsError, match="groupadd"):
            find_group("no-such-group-here")

    def test_a_link_in_its_place_is_not_followed(self, bound, tmp_path):
        """A user who can write to the folder cannot make the node change the mode of another file."""
        victim = tmp_path / "victim"
        victim.write_text("secret")
        victim.chmod(0o600)
        bound.unlink()
        bound.symlink_to(victim)
        with pytest.raises(SettingsError, match="not a socket any more"):
            share(bound, None, "0666")
        assert stat.S_IMODE(victim.stat().st_mode) == 0o600
