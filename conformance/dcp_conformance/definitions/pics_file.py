"""PICS files to be filled in: each key has the source of its value, or a question."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

import msgspec

from dcp_conformance.errors import UsageError

from .pics import Pics

#: Questions about keys that are not set.
QUESTIONS: Final[dict[str, str]] = {
    "sut.name": "What is the implementation called?",
    "sut.version": "Which version or commit of it is this?",
    "sut.vendor": "Who makes it?",
    "sut.notes": "Anything that readers of the report should know?",
    "access.interface": "On which Ethernet interface does the tester reach it?",
    "access.link": 'Or over which UDP group, as "udp:239.255.77.1:4953"?',
    "access.ether_type": "Which EtherType do its beacons have, if not that of the profile?",
    "access.ut": 'Where is its upper tester: "unix:PATH", "tcp:HOST:PORT", "exec:COMMAND" or "commands:FILE"?',
    "access.start": "Which command starts it?",
    "access.stop": "Which command stops it, if ending that process is not enough?",
    "access.restart": "Which command restarts it after a crash?",
    "access.start_timeout": "How many seconds may it need from a start to the first answer?",
    "pics.srp": "Does it have a State Reporting Protocol?",
    "pics.vardis": "Does it have a VarDis?",
    "pics.multiple_payloads": "May several payloads of one client share a beacon (BP-QM-08)?",
    "pics.several_containers": "Does it send several containers of one type in a payload (VD-IC-04)?",
    "pics.transmit_payload_confirm": "Is BP-TransmitPayload confirmed (BP-TXP-08)?",
    "pics.payload_transmitted_indication": "Are clients told when a payload was transmitted (BP-PTI-01)?",
    "pics.triggered_beacons": "May a new payload bring the next beacon forward (BP-TXP-07)?",
    "pics.jitter": "Do beacon intervals vary on purpose (BP-TX-02)?",
    "pics.loss_estimation": "Are losses estimated from sequence numbers (BP-RX-11)?",
    "pics.neighbour_statistics": "Does the neighbour table have further fields or queries (SRP-NT-04)?",
    "pics.srp_seqno_filter": "Are state reports with an older sequence number refused (SRP-RX-04)?",
    "pics.runtime_parameters": "Can parameters be set while it runs (BP-PAR-01)?",
    "pics.parameter_feedback": "Is it told when a parameter is refused (BP-PAR-07)?",
    "pics.describe_extra_fields": "Does DescribeDatabase have further fields (VD-DDB-03)?",
    "pics.empty_description": "Does RTDB-Create take an empty description (VD-CRE-15, X21)?",
    "pixit.profile": "Which wire profile does it speak: a built-in name, or the path of a file?",
    "pixit.node_id": "What is its node identifier? Without it, that of the first beacon that is heard.",
    "pixit.network_id": "Which network identifier do its beacons have, where they have one?",
    "pixit.beacon_period_ms": "What is BPPAR_BEACON_PERIOD? All time windows are multiples of it.",
    "pixit.reaction_periods": "After how many beacon periods is a reaction in a beacon? Measured if not set.",
    "pixit.least_patience_ms": "How long does it need for anything, however short the beacon period?",
    "pixit.quiet_beacons": "After how many beacons without a record will there be no more of it?",
    "pixit.period_tolerance": "How far may the mean interval be from the period, as a fraction of it?",
    "pixit.clock_tolerance_ms": "How far may its clock be from the tester's?",
    "pixit.timer_tolerance_ms": "How late may its timers be, beyond what the specification allows?",
    "pixit.reset": 'How does it get back to its initial state: "auto", "ut", "restart" or "none"?',
    "pixit.max_packet_size": "What is BPPAR_MAXIMUM_PACKET_SIZE, in octets?",
    "pixit.max_payload_size": "What is VARDISPAR_MAX_PAYLOAD_SIZE, in octets?",
    "pixit.max_value_length": "What is VARDISPAR_MAX_VALUE_LENGTH, in octets?",
    "pixit.max_description_length": "What is VARDISPAR_MAX_DESCRIPTION_LENGTH, in octets?",
    "pixit.max_repetitions": "What is VARDISPAR_MAX_REPETITIONS?",
    "pixit.max_summaries": "What is VARDISPAR_MAX_SUMMARIES?",
    "pixit.variables": "How many variables can it store, if that is limited?",
    "pixit.neighbours": "How many entries can its neighbour table have, if that is limited?",
    "pixit.clients": "How many clients can register with BP beside SRP and VarDis, if that is limited?",
    "pixit.queue_entries": "How many payloads can the queue of a client hold, if that is limited?",
    "pixit.loss": "Which share of the frames does the link lose, as 0.02?",
    "pixit.neighbour_timeout_ms": "What is SRPPAR_NEIGHBOUR_TABLE_TIMEOUT?",
    "pixit.scrubbing_period_ms": "What is VARDISPAR_SCRUBBING_PERIOD, or that of SRP?",
    "pixit.buffer_check_period_ms": "What is VARDISPAR_BUFFER_CHECK_PERIOD?",
    "pixit.link_down": "Which command takes its link down (not the tester's end), as if a cable was pulled?",
    "pixit.link_up": "Which command takes its link up again?",
    "pixit.var_ids": "First and last variable identifier that the tester may use, if not all of them?",
}
_TITLES = {
    "sut": "Which implementation this is about.",
    "access": "How the tester reaches it: run --pics FILE needs no further options.",
    "pics": "Capabilities that it claims. A key that is not set denies nothing: cases that need it are not applicable.",
    "readings": 'Readings of disputed text that it follows, as X05 = "literal-minimum". A missing key claims nothing.',
    "pixit": "Information that the tester needs. A key that is not set has the value of the profile, or the one shown.",
}


def pics_text(pics: Pics, remarks: Iterable[str] = ()) -> str:
    """The file. Remarks that begin with a key (``pics.srp: why``) stand beside it, the others on top."""
    reasons: dict[str, str] = {}
    others: list[str] = []
    for remark in remarks:
        key, colon, why = remark.partition(": ")
        if colon and key in QUESTIONS:
            reasons[key] = why
        else:
            others.append(remark)
    lines = ["# PICS and PIXIT, drafted by dcp-conformance probe. Uncomment what you know."]
    lines += [f"# Note: {_one_line(each)}" for each in others]
    for table, title in _TITLES.items():
        if table == "readings":
            lines += [
                "",
                f"# {title}",
                "[readings]",
                *(f"{name} = {_toml(value)}" for name, value in pics.readings.items()),
            ]
            continue
        part = getattr(pics, table)
        lines += ["", f"# {title}", f"[{table}]"]
        defaults = type(part)()
        for name in part.__struct_fields__:
            lines += _lines(f"{table}.{name}", name, getattr(part, name), getattr(defaults, name), reasons)
    return "\n".join(lines) + "\n"


def write_pics(pics: Pics, path: Path | None, remarks: Iterable[str] = ()) -> None:
    """Write the file, or print it if ``path`` is None or ``-``.

    Raises :class:`UsageError`: it exists already, or cannot be written.
    """
    text = pics_text(pics, remarks)
    if path is None or str(path) == "-":
        sys.stdout.write(text)
        return
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise UsageError(f"{path}: exists already; what people wrote there is not overwritten") from None
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror or error}") from None


def _lines(key: str, name: str, value: Any, default: Any, reasons: dict[str, str]) -> list[str]:
    if key in reasons or value != default:
        why = reasons.get(key)
        return [*([f"# {_one_line(why)}"] if why else []), f"{name} = {_toml(value)}"]
    shown = "" if default is None or default == "" else f" {_toml(default)}"
    return [f"# {QUESTIONS.get(key, f'What is {name}?')}", f"# {name} ={shown}"]


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    # TOML knows the escapes of JSON, except for this one character.
    return json.dumps(msgspec.to_builtins(value), ensure_ascii=False).replace("\x7f", "\\u007f")


def _one_line(text: str) -> str:
    return "".join(char if char.isprintable() else " " for char in text)
