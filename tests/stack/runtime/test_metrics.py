"""Scrapers of the metrics are answered once, and none keeps its connection."""

from __future__ import annotations

from dcp_stack.runtime.metrics import MAX_REQUEST, PATIENCE, Scrape


def answer(request: bytes) -> bytes:
    return b"answer to " + request.split()[0]


def test_a_request_in_pieces_is_answered_when_it_is_complete():
    scrape = Scrape(answer)
    scrape.receive(b"GET /metrics HTTP/1.0\r\n")
    assert (scrape.wants_input, scrape.finished, scrape.output) == (True, False, b"")
    scrape.receive(b"\r\n")
    assert (scrape.wants_input, scrape.finished, scrape.output) == (False, False, b"answer to GET")
    scrape.sent(6)
    assert (scrape.finished, scrape.output) == (False, b" to GET")
    scrape.sent(7)
    assert scrape.finished


def test_an_endless_or_invalid_request_closes_the_connection():
    endless, silent = Scrape(answer), Scrape(answer)
    endless.receive(b"x" * (MAX_REQUEST + 1))
    silent.end_of_input()
    assert (endless.finished, silent.finished) == (True, True)
    assert (endless.output, silent.output) == (b"", b"")


def test_a_slow_client_is_disconnected():
    scrape = Scrape(answer)
    for now, overrun in ((10, False), (10 + PATIENCE, False), (11 + PATIENCE, True)):
        assert not scrape.process(now=now, wall=0)
        assert scrape.overrun is overrun
