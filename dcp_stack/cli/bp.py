"""``dcp-node bp``: client protocols of the Beaconing Protocol and their payloads."""

from __future__ import annotations

import json
import time
from typing import Any

import click

from dcp_stack.control.client import Notification

from .common import (
    EXIT_STATUS,
    columns,
    connect,
    node_options,
    octets_given,
    octets_options,
    printable,
    show_notifications,
    shown_value,
    simple,
    utf8,
    watch_options,
)

MODES = {
    "once": "BP_QMODE_ONCE",
    "repeat": "BP_QMODE_REPEAT",
    "droptail": "BP_QMODE_QUEUE_DROPTAIL",
    "drophead": "BP_QMODE_QUEUE_DROPHEAD",
    "queue": "BP_QMODE_QUEUE",
}


@click.group("bp", epilog=EXIT_STATUS)
def command() -> None:
    """Register client protocols, send and watch their payloads (services of BP)."""


@command.command("list", epilog=EXIT_STATUS)
@node_options
def list_(control: str, as_json: bool) -> int:
    """List the registered protocols."""
    return simple(control, as_json, "BP-ListRegisteredProtocols", _table)


def _table(result: dict[str, Any]) -> str:
    rows = [
        [
            str(each["protocolId"]),
            str(each["maxPayloadSize"]),
            each["queueMode"].removeprefix("BP_QMODE_"),
            str(each["maxEntries"]),
            "yes" if each["allowMultiplePayloads"] else "no",
            str(each.get("buffered", "")),
            printable(each["protocolName"]),
        ]
        for each in result["protocols"]
    ]
    header = ("protId", "max size", "mode", "entries", "multiple", "buffered", "name")
    return columns(header, rows, right=(0, 1, 3, 5), give=(6,)) if rows else "no protocols"


@command.command("register", epilog=EXIT_STATUS)
@click.argument("prot_id", type=int, metavar="PROTID")
@click.option("--name", default="", callback=utf8, metavar="TEXT", help="Name of the protocol.")
@click.option(
    "--max-size", type=int, default=100, show_default=True, metavar="N", help="Maximum payload length in octets."
)
@click.option("--mode", type=click.Choice([*MODES]), default="once", show_default=True, help="Queueing mode.")
@click.option(
    "--entries",
    type=int,
    default=8,
    show_default=True,
    metavar="N",
    help="Length of the queue, for the queueing modes.",
)
@click.option("--multiple", is_flag=True, help="Allow several payloads in one beacon.")
@node_options
def register(
    prot_id: int, name: str, max_size: int, mode: str, entries: int, multiple: bool, control: str, as_json: bool
) -> int:
    """Register PROTID. It stays registered until it is deregistered; 'bp watch' shows its received payloads."""
    return simple(
        control,
        as_json,
        "BP-RegisterProtocol",
        protId=prot_id,
        name=name or f"protocol {prot_id}",
        maxPayloadSize=max_size,
        queueingMode=MODES[mode],
        maxEntries=entries,
        allowMultiplePayloads=multiple,
    )


@command.command("deregister", epilog=EXIT_STATUS)
@click.argument("prot_id", type=int, metavar="PROTID")
@node_options
def deregister(prot_id: int, control: str, as_json: bool) -> int:
    """Deregister PROTID; its waiting payloads are discarded."""
    return simple(control, as_json, "BP-DeregisterProtocol", protId=prot_id)


@command.command("send", epilog=EXIT_STATUS)
@click.argument("prot_id", type=int, metavar="PROTID")
@octets_options("--payload")
@node_options
def send(prot_id: int, octets: str | None, text: str | None, control: str, as_json: bool) -> int:
    """Submit a payload for the next beacons."""
    payload = octets_given("--payload", octets, text)
    return simple(control, as_json, "BP-TransmitPayload", protId=prot_id, payload=payload)


@command.command("clear", epilog=EXIT_STATUS)
@click.argument("prot_id", type=int, metavar="PROTID")
@node_options
def clear(prot_id: int, control: str, as_json: bool) -> int:
    """Discard the waiting payloads."""
    return simple(control, as_json, "BP-ClearBuffer", protId=prot_id)


@command.command("query", epilog=EXIT_STATUS)
@click.argument("prot_id", type=int, metavar="PROTID")
@node_options
def query(prot_id: int, control: str, as_json: bool) -> int:
    """Show the number of waiting payloads."""
    return simple(
        control, as_json, "BP-QueryNumberBufferedPayloads", lambda result: str(result.get("number", "")), protId=prot_id
    )


@command.command("watch", epilog=EXIT_STATUS)
@click.argument("prot_ids", type=int, nargs=-1, required=True, metavar="PROTID...")
@watch_options("payloads")
@click.option("--sent", is_flag=True, help="Also show transmissions of this node.")
@node_options
def watch(
    prot_ids: tuple[int, ...], count: int | None, seconds: float | None, sent: bool, control: str, as_json: bool
) -> int:
    """Show the payloads received for client protocols.

    Payloads for SRP and VarDis are not shown, since these protocols process them. With --json, one object per line.
    """
    wanted = {"BP-ReceivePayload.indication"} | ({"BP-PayloadTransmitted.indication"} if sent else set())

    def show(told: Notification) -> str:
        if told.method not in wanted:
            return ""
        return json.dumps({"indication": told.method, **told.params}) if as_json else _line(told.params)

    with connect(control) as client:
        client.call("UT-Subscribe", protIds=[*prot_ids])
        return show_notifications(client, count, seconds, "payloads", show)


def _line(indication: dict[str, Any]) -> str:
    start = f"{time.strftime('%H:%M:%S')}  {indication['protId']:>5}"
    if "payload" not in indication:
        return f"{start}  transmitted"
    sender = indication.get("senderId", "?")
    return f"{start}  {indication['length']:>5} from {sender}  {shown_value(indication['payload'])}"
