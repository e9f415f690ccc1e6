"""Metrics of a node for Prometheus and compatible collectors: OpenMetrics over HTTP on the loopback interface.

The format comes from prometheus_client, the parser of requests from the standard library. Both are imported only if
metrics are requested (10 MB). There is no thread: a scrape is answered between two turns of the node.
"""

from __future__ import annotations

import errno
import io
import logging
import os
import socket
import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, Final, get_args

import msgspec

from dcp_codec.common.extras import advice
from dcp_stack.control.server import ControlServer
from dcp_stack.links.base import Link
from dcp_stack.links.rotation import RotatingRecorder
from dcp_stack.vardis.delivery import Kind

from .channels import Listener
from .errors import NodeError

if TYPE_CHECKING:
    from prometheus_client.core import Metric

log = logging.getLogger(__name__)

MAX_REQUEST: Final = 8192
MAX_SCRAPERS: Final = 8
PATIENCE: Final = 5_000_000_000
"""ns within which a scraper must have sent its request and read the answer."""


#: Help texts of counters of BP and of the link; counters of payloads have a label for the protocol.
_MEANINGS: Final = {
    "beacons-sent": "Beacons passed to the link.",
    "beacons-received": "Well-formed beacons of this network from other nodes.",
    "beacons-left-out": "Beacons skipped because their time had passed.",
    "beacons-without-payload": "Beacon times at which there was no payload to send.",
    "beacons-with-other-count": "Beacons received with fewer or more payloads than they announce.",
    "frames-received": "Frames received from the link, valid or not.",
    "octets-received": "Octets of these frames, without the header of the bearer.",
    "octets-sent": "Octets of beacons sent, without the header of the bearer.",
    "payloads-received": "Payloads received for a registered protocol.",
    "payloads-sent": "Payloads sent in beacons.",
    "payloads-stored": "Payloads that BP accepted from the client protocol.",
    "payloads-displaced": "Payloads that BP accepted by dropping the oldest one.",
    "payloads-discarded": "Payloads that BP refused because the buffer of their protocol was full.",
    "sent": "Frames that the system accepted for transmission.",
    "received": "Frames read from the system.",
    "send_errors": "Frames that were too long or that the system refused.",
    "ignored": "Frames of other protocols, too long to be read, or our own ones on a loopback interface.",
    "kernel_drops": "Frames that the system dropped before they were read.",
    "outages": "Number of times that the interface went down.",
    "own_address": "Frames from our own address; another node may use the same one.",
}

_RECORDING: Final = {
    "frames": "Frames in the recording.",
    "frames_lost": "Frames that could not be recorded.",
    "interruptions": "Interruptions of the recording, as by a full disk.",
}


class MetricsError(NodeError):
    """The endpoint cannot be opened; the message names the cause and a remedy."""


class NodeCollector:
    """The collector of a node's metrics, with the method ``collect`` that prometheus_client calls."""

    def __init__(self, server: ControlServer, link: Link, recorder: RotatingRecorder | None = None) -> None:
        self._server = server
        self._link = link
        self._recorder = recorder

    def collect(self) -> Iterator[Metric]:
        """Yield all metrics. No label has a received value: other stations could create any number of series."""
        from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily

        node, link, recorder = self._server.node, self._link, self._recorder
        config = node.config
        about = {
            "node_id": config.node_id.hex(":"),
            "profile": config.profile.name,
            "spec_version": str(config.profile.spec_version),
            "link": link.name,
        }
        yield InfoMetricFamily("dcp_node", "Identifier, profile and link of the node.", value=about)
        families: dict[str, CounterMetricFamily] = {}
        for name, number in node.bp.counters().items():
            base, *protocol = name.split("/")
            if base == "drops":
                # Contained in dcp_drops below.
                continue
            if base not in families:
                labels = ["protocol"] if protocol else []
                families[base] = CounterMetricFamily(f"dcp_bp_{base.replace('-', '_')}", _meaning(base), labels=labels)
            families[base].add_metric(protocol, number)
        yield from families.values()
        drops = CounterMetricFamily(
            "dcp_drops",
            "Parts of received frames that were ignored, by reason; most are normal for the protocol.",
            labels=["layer", "reason"],
        )
        for name, number in sorted(self._server.drops.items()):
            drops.add_metric(name.split("/", 1), number)
        yield drops
        for name, number in msgspec.structs.asdict(link.counters).items():
            yield CounterMetricFamily(f"dcp_link_{name}", _meaning(name), value=number)
        if recorder is not None:
            yield GaugeMetricFamily("dcp_recording_active", "Whether frames are being recorded.", recorder.recording)
            for name, meaning in _RECORDING.items():
                yield CounterMetricFamily(f"dcp_recording_{name}", meaning, value=getattr(recorder, name))
        yield GaugeMetricFamily("dcp_link_up", "Whether the link can carry frames.", link.up)
        yield GaugeMetricFamily("dcp_bp_active", "Whether BP is active.", node.bp.active)
        sessions = len(self._server.sessions)
        yield GaugeMetricFamily("dcp_control_sessions", "Connected clients of the control socket.", sessions)
        if node.srp is not None and node.srp.registered:
            neighbours = len(node.srp.neighbours)
            yield GaugeMetricFamily("dcp_srp_neighbours", "Neighbours in the neighbour table of SRP.", neighbours)
        if node.vardis is not None:
            yield GaugeMetricFamily("dcp_vardis_active", "Whether VarDis is active.", node.vardis.active)
            known = node.vardis.describe_database().variables if node.vardis.active else ()
            about_variables = "Variables in the database, by state."
            variables = GaugeMetricFamily("dcp_vardis_variables", about_variables, labels=["state"])
            deleted = sum(each.is_deleted for each in known)
            variables.add_metric(["alive"], len(known) - deleted)
            variables.add_metric(["deleted"], deleted)
            yield variables
            about_obstacles = "Variables that do not reach a neighbour, by reason."
            obstacles = GaugeMetricFamily("dcp_vardis_obstacles", about_obstacles, labels=["reason"])
            reasons = Counter(each.kind for each in node.vardis.obstacles(time.monotonic_ns()))
            for reason in get_args(Kind):
                obstacles.add_metric([reason], reasons[reason])
            yield obstacles


def _meaning(counter: str) -> str:
    """Return the help text of a counter; unknown counters get their name."""
    return _MEANINGS.get(counter, f"{counter.replace('-', ' ').capitalize()}.")


class MetricsServer(Listener):
    """An HTTP server for ``GET /metrics`` on 127.0.0.1."""

    def __init__(self, port: int) -> None:
        """Raises MetricsError if the port is in use or prometheus_client is missing."""
        try:
            import http.server

            from prometheus_client.openmetrics import exposition
        except ImportError:
            raise MetricsError(advice("prometheus_client")) from None
        self._exposition: Any = exposition
        self._parser: Any = http.server.BaseHTTPRequestHandler
        try:
            listening = socket.create_server(("127.0.0.1", port), backlog=MAX_SCRAPERS)
        except OSError as error:
            why = "the port is in use" if error.errno == errno.EADDRINUSE else os.strerror(error.errno or 0)
            raise MetricsError(f"metrics: 127.0.0.1:{port}: {why}") from None
        super().__init__("metrics", listening, MAX_SCRAPERS)
        self._collector: NodeCollector | None = None

    @property
    def port(self) -> int:
        """The port; the chosen one if 0 was requested."""
        port: int = self._socket.getsockname()[1]
        return port

    def serve(self, collector: NodeCollector) -> None:
        """Set the source of the metrics."""
        self._collector = collector

    def open_session(self) -> Scrape:
        """Return the session of a new scraper."""
        return Scrape(self._answer)

    def _answer(self, request: bytes) -> bytes:
        """Return the whole HTTP response to a request."""
        status, body, kind = self._respond(request)
        head = (
            f"HTTP/1.0 {status}\r\nContent-Type: {kind}\r\nContent-Length: {len(body)}\r\nConnection: close\r\n"
            "X-Content-Type-Options: nosniff\r\n\r\n"
        )
        return head.encode() + body

    def _respond(self, request: bytes) -> tuple[str, bytes, str]:
        """Return status, body and content type for a request."""
        plain = "text/plain; charset=utf-8"
        asked = self._parser.__new__(self._parser)
        # Let http.server parse the octets without a connection; its own error answers are discarded.
        asked.rfile, asked.wfile = io.BytesIO(request), io.BytesIO()
        asked.client_address = ("", 0)
        asked.log_message = lambda *_: None
        asked.raw_requestline = asked.rfile.readline(MAX_REQUEST)
        if not asked.parse_request():
            return "400 Bad Request", b"bad request\n", plain
        # Protection from DNS rebinding: pages in a browser must not read the metrics under a foreign host name.
        host = str(asked.headers.get("Host", "127.0.0.1")).rsplit(":", 1)[0]
        if host not in ("127.0.0.1", "localhost", "[::1]"):
            return "403 Forbidden", b"use the host name 127.0.0.1\n", plain
        if asked.command != "GET":
            return "405 Method Not Allowed", b"GET only\n", plain
        if asked.path.partition("?")[0] not in ("/metrics", "/"):
            return "404 Not Found", b"the only page is /metrics\n", plain
        try:
            return "200 OK", self._exposition.generate_latest(self._collector), self._exposition.CONTENT_TYPE_LATEST
        except Exception:
            log.exception("metrics failed")
            return "500 Internal Server Error", b"see the log of the node\n", plain


class Scrape:
    """One request and its answer, as a session of a channel."""

    def __init__(self, answer: Callable[[bytes], bytes]) -> None:
        """``answer`` returns the whole HTTP response to a request."""
        self.output = bytearray()
        self.overrun = False
        self._answer = answer
        self._request = bytearray()
        self._since: int | None = None
        self._ended = False
        """Whether the request was answered, or will never be complete."""

    @property
    def wants_input(self) -> bool:
        """Whether the request is not complete."""
        return not self._ended

    @property
    def finished(self) -> bool:
        """Whether the exchange has ended."""
        return self._ended and not self.output

    def receive(self, data: bytes) -> None:
        """Add octets of the request; answer it if it is complete."""
        self._request += data
        complete = b"\r\n\r\n" in self._request
        self._ended = complete or len(self._request) > MAX_REQUEST
        if complete:
            self.output += self._answer(bytes(self._request))

    def end_of_input(self) -> None:
        """End the exchange: the request will not become complete."""
        self._ended = True

    def process(self, *, now: int, wall: int) -> bool:  # noqa: ARG002 - the same call for every session
        """Note whether the scraper exceeds ``PATIENCE``. Return False: it has only one request."""
        self._since = self._since or now
        self.overrun = now - self._since > PATIENCE
        return False

    def sent(self, count: int) -> None:
        """Remove octets of the answer that were sent."""
        del self.output[:count]

    def close(self) -> None:
        """Do nothing: no other object knows the session."""
