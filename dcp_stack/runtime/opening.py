"""Opening a node from its settings, in the order in which the settings can be refused."""

from __future__ import annotations

import contextlib
import importlib
import logging
import random
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

import msgspec

from dcp_codec.codec import Codec
from dcp_stack.config import NodeConfig
from dcp_stack.links.base import Link, LinkError
from dcp_stack.links.opening import open_link
from dcp_stack.links.recording import Recorder, recording_path
from dcp_stack.links.rotation import Limits, RotatingRecorder, numbered_after, recordings_of
from dcp_stack.neighbour_file import NeighbourFileError, NeighbourFileWriter
from dcp_stack.node import Node
from dcp_stack.positions.base import PositionSource, SourceError
from dcp_stack.positions.opening import open_source

from .channels import ControlSocket, StandardStreams
from .daemon import log_to
from .driver import Driver
from .errors import NodeError
from .memory import settle
from .privileges import become, find_user, made_by_root
from .settings import Settings, SettingsError, codec_of, node_config
from .sharing import share

log = logging.getLogger(__name__)

STDIO = "stdio"


class MakeNode(Protocol):
    """A function that makes a node from its configuration."""

    def __call__(self, config: NodeConfig, *, rng: random.Random, now: int, wall: int) -> Node:
        """Return a node; the parameters are those of :class:`~dcp_stack.node.Node`."""
        ...


@contextlib.contextmanager
def open_node(settings: Settings, make: MakeNode = Node) -> Iterator[Driver]:
    """Open a node that is ready to run. If it raises NodeError, everything opened before is closed again.

    ``make`` is called instead of :class:`~dcp_stack.node.Node`, for nodes with another behaviour.
    """
    try:
        with contextlib.ExitStack() as stack:
            driver = _open(settings, make, stack)
            # From here on the driver closes everything, in its own order.
            stack.pop_all()
        yield driver
    except (LinkError, SourceError, NeighbourFileError) as error:
        raise NodeError(str(error)) from None


def _open(settings: Settings, make: MakeNode, stack: contextlib.ExitStack) -> Driver:
    """Open all parts of a node; ``stack`` closes them if a later one fails."""
    user = None if settings.user is None else find_user(settings.user)
    if settings.control == STDIO and settings.position == "stdin":
        raise SettingsError("control and position cannot both be standard input")
    codec = codec_of(settings)
    spec = _link_spec(settings)
    config = node_config(settings, codec, default_id=_address_of(settings.interface))
    link = open_link(spec, config)
    stack.callback(link.close)
    config = _fitted(config, link)
    rng = random.Random(settings.seed)  # noqa: S311 - for jitter, not for secrets
    now, wall = time.monotonic_ns(), time.time_ns()
    try:
        node = make(config, rng=rng, now=now, wall=wall)
    except ValueError as error:
        fitted = config.bp.max_packet_size != settings.bp.max_packet_size
        why = f" (beacons of at most {link.max_packet_size} octets, the maximum of {link.name})" if fitted else ""
        raise SettingsError(f"{error}{why}") from None
    positions: PositionSource | None = None
    if settings.position is not None:
        positions = open_source(settings.position, codec, rng=rng)
        stack.callback(positions.close)
    metrics = None
    if settings.metrics is not None:
        from .metrics import MetricsServer

        metrics = MetricsServer(settings.metrics)
        stack.callback(metrics.close)
    control: ControlSocket | None = None
    neighbours: NeighbourFileWriter | None = None
    names = [each for each in (settings.control, settings.neighbour_file) if each is not None and each != STDIO]
    of_root = {each for each in names if user is not None and made_by_root(each)}
    for made_now in (of_root, set(names) - of_root):
        if user is not None and made_now is not of_root:
            _load_what_follows(settings)
            logged_by_user = settings.log_file if settings.log_file and not made_by_root(settings.log_file) else None
            become(user)
            if logged_by_user is not None:
                log_to(logged_by_user)
        if settings.control in made_now:
            control = ControlSocket(settings.control)
            stack.callback(control.close)
            if user is not None and made_now is of_root:
                control.give_to(user.uid, user.gid)
        if settings.neighbour_file in made_now:
            neighbours = NeighbourFileWriter(settings.neighbour_file, codec.profile, config.node_id, now=now, wall=wall)
            stack.callback(neighbours.close)
    # Last, because a node that is refused must not leave a recording.
    recorder = _recorder(settings, config, codec, wall)
    if recorder is not None:
        stack.callback(recorder.close)
    driver = Driver(
        node,
        link,
        recorder=recorder,
        positions=positions,
        neighbour_file=neighbours,
    )
    if metrics is not None:
        from .metrics import NodeCollector

        metrics.serve(NodeCollector(driver.server, link, recorder))
        driver.add_control(metrics)
        log.info("metrics at http://127.0.0.1:%d/metrics", metrics.port)
    if control is not None:
        share(control.path, settings.control_group, settings.control_mode)
        driver.add_control(control)
    if settings.control == STDIO:
        # End of input stops the node: the program that started it has closed the connection.
        driver.add_control(StandardStreams(driver.stop))
    settle()
    log.info("node %s on %s", config.node_id.hex(":"), link.name, extra={"fields": _about(settings, config, recorder)})
    return driver


def _load_what_follows(settings: Settings) -> None:
    """Load modules that are needed later: the user may not be permitted to read the interpreter's folders."""
    if settings.record is not None:
        importlib.import_module("dcp_codec.capture.mcap.writer")


def _about(settings: Settings, config: NodeConfig, recorder: RotatingRecorder | None) -> dict[str, object]:
    """Return the fields of the log line about the start."""
    record = None if recorder is None else str(recorder.path)
    about = {"profile": config.profile.name, "control": settings.control, "record": record}
    return {name: value for name, value in about.items() if value is not None}


def _link_spec(settings: Settings) -> str:
    """Return the text that names the link. Raises SettingsError if none or two are given."""
    if settings.interface is not None and settings.link is not None:
        raise SettingsError("interface and link both name the link; give only one of them")
    if settings.interface is not None:
        return f"eth:{settings.interface}"
    if settings.link is not None:
        return settings.link
    raise SettingsError("no link given; use --interface IF for Ethernet (interface = ...), or --link udp (link = ...)")


def _address_of(interface: str | None) -> bytes | None:
    """Return the address of an interface, the default of the node identifier; None if it cannot be determined."""
    if interface is None:
        return None
    from dcp_codec.network.interfaces import hardware_address

    try:
        return hardware_address(interface)[1]
    except OSError:
        # Opening the link reports the cause.
        return None


def _fitted(config: NodeConfig, link: Link) -> NodeConfig:
    """Limit beacons to what the link can carry. Raises SettingsError if the settings require longer ones."""
    wanted = config.bp.max_packet_size
    if (wanted or config.profile.limits.max_beacon_size) <= link.max_packet_size:
        return config
    if wanted is not None:
        raise SettingsError(
            f"bp.max_packet_size: {link.name} carries at most {link.max_packet_size} octets, not {wanted}"
        )
    log.info("beacons of at most %d octets, the maximum of %s", link.max_packet_size, link.name)
    bp = msgspec.structs.replace(config.bp, max_packet_size=link.max_packet_size)
    return msgspec.structs.replace(config, bp=bp)


def _recorder(settings: Settings, config: NodeConfig, codec: Codec, wall: int) -> RotatingRecorder | None:
    """Return the recorder, or None if nothing is to be recorded. Raises SettingsError or LinkError."""
    if settings.record is None:
        return None
    about = {"node": config.node_id.hex(":"), "vantage": config.node_id.hex(":")}
    place = settings.record
    first = recording_path(place, config.node_id, wall)
    into_folder = first != Path(place)
    if settings.record_keep is not None and not into_folder:
        raise SettingsError(f"record_keep: {place} is a file; to keep the last files, set record to a folder")
    limits = Limits(
        octets=None if settings.record_max_mb is None else max(round(settings.record_max_mb * 1e6), 1),
        seconds=None if settings.record_max_minutes is None else settings.record_max_minutes * 60,
        files=settings.record_keep,
    )

    def following() -> Path:
        return recording_path(place, config.node_id, time.time_ns()) if into_folder else numbered_after(first)

    return RotatingRecorder(
        lambda path: Recorder(path, codec, decoded=settings.record_decoded, about=about),
        first,
        following,
        limits=limits,
        siblings=lambda: recordings_of(first.parent, config.node_id),
    )
