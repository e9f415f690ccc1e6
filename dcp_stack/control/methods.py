"""The methods and notifications of the control interface by name."""

from __future__ import annotations

from typing import Final

import msgspec

from . import messages as m


class Method(msgspec.Struct, frozen=True):
    """A method: the types of its parameters and result, and a description of one line."""

    params: type[m.Params]
    result: type[m.Result]
    about: str
    optional: bool = False
    """Whether an implementation of the interface may omit the method."""


METHODS: Final[dict[str, Method]] = {
    "UT-Hello": Method(m.Nothing, m.HelloConfirm, "name and version of the implementation, and its methods"),
    "UT-Reset": Method(m.Nothing, m.UTConfirm, "restore the state after the start"),
    "UT-Subscribe": Method(m.Subscribe, m.UTConfirm, "receive notifications of events", optional=True),
    "UT-Status": Method(m.Nothing, m.StatusConfirm, "the state of the node, for display", optional=True),
    "BP-RegisterProtocol": Method(m.RegisterProtocol, m.RegisterProtocolConfirm, "register a client protocol"),
    "BP-DeregisterProtocol": Method(m.ForProtocol, m.BPConfirm, "deregister a client protocol"),
    "BP-ListRegisteredProtocols": Method(m.Nothing, m.ListRegisteredProtocolsConfirm, "list the client protocols"),
    "BP-TransmitPayload": Method(m.TransmitPayload, m.BPConfirm, "submit a payload for transmission"),
    "BP-ClearBuffer": Method(m.ForProtocol, m.BPConfirm, "discard the waiting payloads of a client protocol"),
    "BP-QueryNumberBufferedPayloads": Method(
        m.ForProtocol, m.QueryNumberBufferedPayloadsConfirm, "the number of waiting payloads"
    ),
    "BP-MGMT-Activate": Method(m.Nothing, m.BPConfirm, "activate BP: send and receive beacons"),
    "BP-MGMT-Deactivate": Method(m.Nothing, m.BPConfirm, "deactivate BP: neither send nor receive beacons"),
    "BP-GetParameters": Method(m.Nothing, m.BPParametersConfirm, "the parameters of BP"),
    "BP-SetParameter": Method(m.SetParameter, m.BPConfirm, "set a parameter of BP"),
    "SRP-UpdateSafetyData": Method(m.UpdateSafetyData, m.SRPConfirm, "set the safety data of this node"),
    "SRP-NeighbourTable": Method(m.NeighbourTableRequest, m.NeighbourTableConfirm, "the neighbour table, or one entry"),
    "SRP-GetParameters": Method(m.Nothing, m.SRPParametersConfirm, "the parameters of SRP", optional=True),
    "SRP-SetParameter": Method(m.SetParameter, m.SRPConfirm, "set a parameter of SRP", optional=True),
    "RTDB-DescribeDatabase": Method(m.Nothing, m.DescribeDatabaseConfirm, "the VarSpecs of all variables"),
    "RTDB-DescribeVariable": Method(m.ForVariable, m.DescribeVariableConfirm, "all data of one variable"),
    "RTDB-Create": Method(m.Create, m.VardisConfirm, "create a variable"),
    "RTDB-Update": Method(m.Update, m.VardisConfirm, "set the value of an own variable"),
    "RTDB-Delete": Method(m.ForVariable, m.VardisConfirm, "delete an own variable"),
    "RTDB-Read": Method(m.ForVariable, m.ReadConfirm, "the value of a variable"),
    "VD-MGMT-Activate": Method(m.Nothing, m.VardisConfirm, "activate VarDis"),
    "VD-MGMT-Deactivate": Method(m.Nothing, m.VardisConfirm, "deactivate VarDis; the database is kept"),
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
