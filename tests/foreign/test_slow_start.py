"""How long the tester waits for a real process that starts slowly, or never answers."""

from __future__ import annotations

from .rig import foreign

SANITY = "TC_DCP_SANITY_BV_01"
ONE = "TC_VD_UPD_BV_01"


def test_an_implementation_that_opened_the_link_and_never_answers_is_not_waited_for_long():
    """It has opened the link: what has not come some seconds later will not come."""
    with foreign(faults=["never-answers"], adapter=False) as target:
        run = target.run(ONE)
        assert run.status == 3, run.text
        assert "waiting for the implementation to start: it has opened the link, nothing heard on udp" in run.err
        assert "nothing was heard: is it running, on this link" in run.text


def test_a_slow_start_is_waited_for_and_named(tmp_path):
    pics = tmp_path / "pics.toml"
    pics.write_text("[access]\nstart_timeout = 60\n", encoding="utf-8")
    with foreign(start_delay=6.0, adapter=False) as target:
        run = target.run(SANITY, "--pics", str(pics))
        assert run.status == 0, run.text
        assert "waiting for the implementation to start: its process runs, nothing heard on udp" in run.err
