"""The table ``holdings``: the states of variables at nodes, from the ledger.

The ledger follows beacons in plain Python, and needs those before: this table is made in a second pass, on request.
"""

from __future__ import annotations

from typing import Final

import pyarrow as pa
from dcp_spec.profile.definition import Link

from dcp_codec.analysis.holdings import Holding, holdings
from dcp_codec.analysis.ledger import Ledger
from dcp_codec.capture import open_capture
from dcp_codec.codec import Codec
from dcp_codec.framing.locate import OtherTraffic, locate

from .columns import IDENTIFIER, TIME
from .input.damaged import batch_of

#: Type, whether it can be null, and meaning of each column.
_COLUMNS: dict[str, tuple[pa.DataType, bool, str]] = {
    "node": (IDENTIFIER, False, "node whose beacons state it"),
    "varId": (pa.int64(), False, "variable"),
    "state": (IDENTIFIER, False, "held, deleted, or unknown (the node requests the create)"),
    "seqno": (pa.int64(), True, "sequence number; null unless held"),
    "producer": (IDENTIFIER, True, "producer in the last create of the node; null if it sent none"),
    "creationTime": (pa.int64(), True, "creation time in that create; null before 2.0"),
    "since": (TIME, False, "time of the first beacon with this state"),
    "until": (TIME, False, "time of the last one"),
    "firstFrame": (pa.int64(), False, "frame of the first one"),
    "lastFrame": (pa.int64(), False, "frame of the last one"),
    "values": (pa.int64(), False, "frames in which the node sent the value"),
    "firstValueFrame": (pa.int64(), True, "the first of them"),
    "requests": (pa.int64(), False, "requests of the node in this state"),
    "lagValues": (pa.int64(), True, "later values of the producer by `until`; null if it had not left the state"),
    "lag": (pa.int64(), True, "from the producer's change to `until`; null if it had not left the state"),
}
_NS = ("since", "until", "lag")
HOLDINGS_SCHEMA: Final = pa.schema(
    [
        pa.field(name, kind, nullable=null, metadata={"doc": doc} | ({"unit": "ns"} if name in _NS else {}))
        for name, (kind, null, doc) in _COLUMNS.items()
    ]
)


def read_holdings(path: str, codec: Codec, link: Link) -> pa.RecordBatch:
    """Return the table of one recording. With more than 60,000 states, brief ones are left out.

    Raises :class:`~dcp_codec.capture.CaptureError` if the recording cannot be opened.
    """
    ledger = Ledger()
    with open_capture(path) as reader:
        for frame in reader:
            framing = locate(frame.data, link)
            if isinstance(framing, OtherTraffic):
                continue
            beacon = codec.salvage(frame.data[framing.start : framing.end]).beacon
            if beacon is not None:
                node = beacon.bp.sender_id if beacon.bp is not None else framing.src or b""
                ledger.feed(frame.number, frame.time_ns, node, beacon)
    rows = holdings(ledger, codec.profile.types.node_id.representation)
    return batch_of([each._asdict() for each in rows], HOLDINGS_SCHEMA)


assert tuple(_COLUMNS) == Holding._fields
