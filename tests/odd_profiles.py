"""Profiles that use what no built-in one uses, and the codec of any profile by its name."""

from __future__ import annotations

from pathlib import Path

from dcp_spec.profile.loading import profile_names

from dcp_codec import Codec, get_codec

from .parts import also

#: Profiles as a user might write them: what no implementation does, but what a profile can say.
ODD_PROFILES: dict[str, str] = {
    "odd-widths": """
        extends = "dcp-2.0"
        name = "odd-widths"
        [types]
        node_id = { width = 8, representation = "hex" }
        timestamp = { width = 5, byte_order = "little", signed = true }
        magic_no = { width = 3, byte_order = "little" }
        network_id = { width = 3, byte_order = "little" }
        bp_seqno = { width = 3, byte_order = "little" }
        srp_seqno = { width = 7 }
        var_id = { width = 2 }
        var_seqno = { width = 2, byte_order = "little" }
        var_timeout = { width = 6, byte_order = "little" }
        value = { lengths = [{ width = 4 }] }
        [srp]
        record = ["seqno", { opaque = 3, name = "gap" }, "tStamp", "sData", "nodeId"]
        safety_data = [
            { name = "x", type = "f32", byte_order = "little", role = "position.x" },
            { name = "hidden", type = "opaque", octets = 5 },
            { name = "y", type = "f64", role = "position.y" },
            { name = "heading", type = "i16", byte_order = "little" },
            { name = "battery", type = "u8" },
            { name = "serial", type = "u64", byte_order = "little" },
        ]
    """,
    "odd-texts": """
        extends = "dcp-1.2"
        name = "odd-texts"
        [types]
        string = { lengths = [{ width = 1 }, { width = 2, byte_order = "little" }], terminated = true }
        value = { lengths = [{ width = 3 }, { width = 1 }, { width = 2, byte_order = "little" }] }
        var_rep_cnt = { width = 2, byte_order = "little" }
        [bp]
        header = ["seqno", "numPayloads", "length", "senderId", "magicNo", "version"]
        [vardis]
        var_spec = ["descr", "repCnt", "prodId", "varId"]
    """,
    "odd-areas": """
        extends = "dcp-1.1"
        name = "odd-areas"
        [types]
        bp_length = { width = 3, byte_order = "little" }
        value = { lengths = [{ width = 1 }], terminated = true }
        [bp]
        payload_header = ["length", { opaque = 2, name = "gap", note = "alignment" }, "protocolId"]
        payload_area = 200
        [srp]
        record = ["nodeId", "sData", "tStamp", "seqno", { opaque = 1, name = "tail" }]
        [vardis]
        container_extra = [{ extra = { width = 3, signed = true }, name = "hopCount" }]
        list_length = { width = 1 }
        [vardis.container_types]
        SUMMARIES = 255
        UPDATES = 0
        REQUEST-VARUPDATES = 17
        REQUEST-VARCREATES = 4
        CREATE-VARIABLES = 100
        DELETE-VARIABLES = 1
        [limits]
        max_value_length = 31
    """,
    "odd-lengths": """
        extends = "dcp-2.0"
        name = "odd-lengths"
        [types]
        bp_length = { width = 1 }
        protocol_id = { width = 1 }
        node_id = { width = 1, representation = "hex" }
        var_id = { width = 8 }
        [srp]
        record = []
        safety_data = []
    """,
    "odd-own": """
        extends = "dcp-2.0"
        name = "odd-own"
        [bp]
        header = ["version", "magicNo", { name = "hops", extra = { width = 3 } }, "senderId", "networkId", "length",
                  "numPayloads", "seqno", { name = "load", real = { width = 4, byte_order = "little" } }]
        payload_header = ["protocolId", { name = "priority", extra = { width = 1 } }, "length"]
        [srp]
        record = [
            { name = "counter", extra = { width = 2, byte_order = "little" } },
            { name = "pattern", opaque = 6 },
            { name = "battery", real = { width = 8 }, unit = "V" },
        ]
        record_size = 16
        safety_data = []
        [vardis]
        var_spec = ["varId", "prodId", "repCnt", "creationTime", "timeout", "descr", { name = "kind", opaque = 2 }]
        container_extra = [{ name = "label", block = { lengths = [{ width = 1 }] }, text = true }]
        own_containers = [
            { name = "GEO-FENCE", number = 9, record = [
                "varId",
                { name = "lat", extra = { width = 4, signed = true }, unit = "1e-7 deg" },
                { name = "label", block = { lengths = [{ width = 1 }] }, text = true },
                { name = "raw", opaque = 3 },
            ] },
            { name = "Ping", number = 10, record = ["prodId", "seqno", "value"] },
        ]
        [vardis.records]
        VarSumm = ["seqno", "varId", { name = "age", extra = { width = 2 } }]
        VarUpdate = ["varId", "seqno", { name = "quality", real = { width = 4 } }, "value"]
        VarReqCreate = [{ name = "reason", block = { lengths = [], terminated = true }, text = true }, "varId"]
        VarCreate = ["upd", { name = "mark", extra = { width = 1 } }, "spec"]
        VarDelete = ["varId", { name = "cause", extra = { width = 1 } }]
    """,
    "odd-records": """
        extends = "dcp-2.0"
        name = "odd-records"
        [srp]
        record = ["sData", "nodeId", "tStamp", "seqno", { name = "battery", extra = { width = 1 } }]
        [vardis]
        var_spec = ["varId", "prodId", "repCnt", "creationTime", "timeout", "descr",
                    { name = "priority", extra = { width = 1 } }, { name = "key", opaque = 2 }]
        [vardis.records]
        VarSumm = ["varId", "seqno", { name = "age", extra = { width = 2 } }]
        VarUpdate = ["varId", "seqno", { name = "ttl", extra = { width = 1 } }, { name = "key", opaque = 2 }, "value"]
        VarReqCreate = ["varId", { name = "reason", extra = { width = 1 } }]
        VarReqUpdate = ["varId", { name = "hops", extra = { width = 1, signed = true } }, "seqno"]
        VarCreate = [{ name = "mark", real = { width = 4 } }, "spec", "upd"]
        VarDelete = ["varId", { name = "cause", extra = { width = 1 } }]
    """,
    "odd-header-size": """
        extends = "sim-2.0"
        name = "odd-header-size"
        [types]
        node_id = { width = 3, representation = "hex" }
        bp_length = { width = 1 }
        [srp]
        record_size = 63
        [bp]
        header = ["version", "length", "magicNo", "numPayloads", "networkId", "seqno", "senderId"]
    """,
}

#: The profiles for tests of every profile.
NAMES = (*profile_names(), *ODD_PROFILES)
#: The profiles among them that between them have every kind of field; the others are part of `make test-suite`.
CORE = frozenset(("dcp-1.0", "dcp-2.0", "odd-areas", "odd-own"))
#: ``NAMES`` as parameters of a test or fixture, and the built-in profiles among them.
PARAMETERS = [each if each in CORE else also("suite", each)[0] for each in NAMES]
BUILT_IN = PARAMETERS[: len(profile_names())]


def write_profile(name: str, folder: Path) -> Path:
    """The file of an odd profile, in ``folder``."""
    path = folder / f"{name}.toml"
    path.write_text(ODD_PROFILES[name], encoding="utf-8")
    return path


def codec_of(name: str, folder: Path) -> Codec:
    """The codec of one of ``NAMES``; ``folder`` is for the file of an odd one."""
    return Codec(write_profile(name, folder)) if name in ODD_PROFILES else get_codec(name)
