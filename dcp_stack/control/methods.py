"""The methods and notifications of the control interface by name."""

from __future__ import annotations

from typing import Final

import msgspec

from . import messages as m


class Method(msgspec.Struct, frozen=True):
    """One method: its parameters, its result, and what it is about in a line."""

    params: type[m.Params]
    result: type[m.Result]
    about: str
    optional: bool = False
    """An implementation may do without it and still claim the contract."""


METHODS: Final[dict[str, Method]] = {
    "UT-Hello": Method(m.Nothing, m.HelloConfirm, "who answers, and which methods it serves"),
    "UT-Reset": Method(m.Nothing, m.UTConfirm, "back to the state after the start"),
    "UT-Subscribe": Method(m.Subscribe, m.UTConfirm, "be told about variables, neighbours, payloads", optional=True),
    "UT-Status": Method(m.Nothing, m.StatusConfirm, "the state of the node, for people", optional=True),
    "BP-RegisterProtocol": Method(m.RegisterProtocol, m.RegisterProtocolConfirm, "register a client protocol"),
    "BP-DeregisterProtocol": Method(m.ForProtocol, m.BPConfirm, "deregister a client protocol"),
    "BP-ListRegisteredProtocols": Method(m.Nothing, m.ListRegisteredProtocolsConfirm, "list the client protocols"),
    "BP-TransmitPayload": Method(m.TransmitPayload, m.BPConfirm, "hand down a payload"),
    "BP-ClearBuffer": Method(m.ForProtocol, m.BPConfirm, "forget the payloads that wait"),
    "BP-QueryNumberBufferedPayloads": Method(
        m.ForProtocol, m.QueryNumberBufferedPayloadsConfirm, "how many payloads wait"
    ),
    "BP-MGMT-Activate": Method(m.Nothing, m.BPConfirm, "send and receive beacons"),
    "BP-MGMT-Deactivate": Method(m.Nothing, m.BPConfirm, "neither send nor receive beacons"),
    "BP-GetParameters": Method(m.Nothing, m.BPParametersConfirm, "the parameters of BP"),
    "BP-SetParameter": Method(m.SetParameter, m.BPConfirm, "set a parameter of BP"),
    "SRP-UpdateSafetyData": Method(m.UpdateSafetyData, m.SRPConfirm, "hand down the own state"),
    "SRP-NeighbourTable": Method(m.NeighbourTableRequest, m.NeighbourTableConfirm, "the neighbour table, or one entry"),
    "SRP-GetParameters": Method(m.Nothing, m.SRPParametersConfirm, "the parameters of SRP", optional=True),
    "SRP-SetParameter": Method(m.SetParameter, m.SRPConfirm, "set a parameter of SRP", optional=True),
    "RTDB-DescribeDatabase": Method(m.Nothing, m.DescribeDatabaseConfirm, "the VarSpecs of all variables"),
    "RTDB-DescribeVariable": Method(m.ForVariable, m.DescribeVariableConfirm, "everything about one variable"),
    "RTDB-Create": Method(m.Create, m.VardisConfirm, "create a variable"),
    "RTDB-Update": Method(m.Update, m.VardisConfirm, "give an own variable a value"),
    "RTDB-Delete": Method(m.ForVariable, m.VardisConfirm, "delete an own variable"),
    "RTDB-Read": Method(m.ForVariable, m.ReadConfirm, "the value of a variable"),
    "VD-MGMT-Activate": Method(m.Nothing, m.VardisConfirm, "let VarDis work"),
    "VD-MGMT-Deactivate": Method(m.Nothing, m.VardisConfirm, "let VarDis rest; the database is kept"),
    "VD-GetParameters": Method(m.Nothing, m.VardisParametersConfirm, "the parameters of VarDis"),
    "VD-SetParameter": Method(m.SetParameter, m.VardisConfirm, "set a parameter of VarDis"),
}

NOTIFICATIONS: Final[dict[str, type[m.Result]]] = {
    "BP-ReceivePayload.indication": m.ReceivePayloadIndication,
    "BP-PayloadTransmitted.indication": m.PayloadTransmittedIndication,
    "UT-VariableChanged": m.VariableChangedNotification,
    "UT-NeighbourSeen": m.NeighbourSeenNotification,
    "UT-NeighbourExpired": m.NeighbourExpiredNotification,
}
