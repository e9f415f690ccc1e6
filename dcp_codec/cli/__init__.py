"""The ``dcp-codec`` command."""

from __future__ import annotations

from dcp_codec.common.commandline import CommandLine, CommandSection

#: Entry point of ``dcp-codec``.
main = CommandLine(
    name="dcp-codec",
    package="dcp_codec.cli",
    commands={
        "decode": "Show every beacon, state report and variable instruction of recordings.",
        "stats": "Count beacons, losses and records in recordings.",
        "guess": "Rank the wire profiles for a recording.",
        "convert": "Convert between MCAP, pcap and pcapng, or write an MCAP for ROS 2.",
        "filter": "Copy the frames that meet a condition.",
        "merge": "Merge recordings in the order of their time stamps.",
        "record": "Record the frames on an interface, passively.",
        "track": "Write positions as CSV, GPX or KML.",
        "wireshark": "Install dissectors in Wireshark.",
        "layout": "Write a Foxglove layout for an MCAP file.",
        "encode": "Encode JSON as beacons: hex, or a recording.",
        "export": "Write the wire format for Wireshark, Kaitai, scapy, JSON Schema, or as Markdown.",
        "profiles": "List the wire profiles, show one, or draft one from a recording.",
    },
    further=(
        CommandSection(
            "Commands of dcp-conformance-tables",
            "dcp_tables.cli",
            {
                "table": "Turn recordings into tables: Parquet, CSV, DuckDB.",
                "report": "Write a page about recordings: values held, losses, ages, positions, anomalies.",
            },
        ),
    ),
    about="Decode recordings of DCP (Drone Coordination Protocol), and locate the octet that is wrong.",
    exit_status="0 all good; 1 malformed DCP frames were seen; 2 wrong usage, or input that could not be read "
    "(to its end).",
)
