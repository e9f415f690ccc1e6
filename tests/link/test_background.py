"""A session as people paste it: nodes in the background, talked to at once, and ended."""

from __future__ import annotations

import json
import os
import re
import stat

from .node_processes import LINK, command


def run(*arguments: object) -> str:
    """Run a command that has to succeed, and return its output."""
    done = command(*arguments)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_pasted_session(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    log, other = tmp_path / "log", tmp_path / "other.sock"
    told = run("run", "--daemon", "--link", LINK, "--node-id", "02:00:00:00:00:01", "--log-file", log)
    try:
        found = re.fullmatch(
            rf"node 02:00:00:00:00:01 runs as process (\d+), control socket {tmp_path}/dcp-node.sock\n", told
        )
        assert found is not None, told
        # The node is ready: no command has to wait.
        assert run("var", "create", 7, "--text", "hello", "--descr", "greeting") == "VARDIS-STATUS-OK\n"
        run("wait")
        assert json.loads(run("status", "--json"))["runtime"]["pid"] == int(found[1])
        # A second node does not take the first one's socket.
        run("run", "--daemon", "--link", LINK, "--control", other, "--log-file", log)
        run("stop", "--control", other)
        taken = command("run", "--link", LINK, "--print-config")
        assert taken.returncode == 0
    finally:
        run("stop")
    assert not (tmp_path / "dcp-node.sock").exists()
    assert "event=running" in log.read_text()
    # It is really over, and said so in an orderly way.
    assert "event=ended" in log.read_text()
    assert command("status").returncode == 3


def test_a_node_that_cannot_start_reports_it_at_once(tmp_path):
    done = command("run", "--daemon", "--link", LINK, "--control", "/no/such/folder/s")
    assert (done.returncode, done.stdout) == (2, "")
    assert "there is no folder /no/such/folder" in done.stderr


def test_a_group_may_use_the_socket(tmp_path):
    settings = tmp_path / "node.toml"
    path = tmp_path / "node.sock"
    settings.write_text(f'link = "{LINK}"\ncontrol = "{path}"\ncontrol_group = "{os.getgid()}"\n')
    run("run", "--daemon", "--config", settings)
    try:
        assert stat.S_IMODE(path.stat().st_mode) == 0o660
    finally:
        run("stop", "--control", path)


def test_a_variable_that_other_nodes_ignore_causes_a_warning(tmp_path):
    path = tmp_path / "node.sock"
    run("run", "--daemon", "--link", LINK, "--control", path)
    try:
        run("param", "set", "VARDISPAR_MAX_REPETITIONS", 15, "--control", path)
        done = command("var", "create", 7, "--text", "x", "--descr", "", "--control", path)
        assert done.returncode == 0
        assert "other nodes ignore a variable without a description" in done.stderr
    finally:
        run("stop", "--control", path)
