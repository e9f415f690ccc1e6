"""The client protocols of BP and the selection of payloads for a beacon (dcp-bp.md#bp-transmit-path).

The client that has waited longest is served first: a served client moves to the end of the order. A client whose
payload did not fit therefore moves forward, and is first, with the whole beacon free, after at most as many beacons
as there were clients before it. After each client had its turn, clients with allowMultiplePayloads have further
turns in the same order, until nothing fits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from .queue import Client

Chosen = list[tuple[int, bytes]]


class ClientList:
    """``currentClientProtocols``, and the order of serving."""

    ##= BP-LST-05

    def __init__(self) -> None:
        ##= BP-INI-01
        self._clients: dict[int, Client] = {}
        self._order: list[Client] = []

    def __contains__(self, protocol_id: int) -> bool:
        return protocol_id in self._clients

    def __iter__(self) -> Iterator[Client]:
        """Iterate over the clients in the order of registration."""
        return iter(self._clients.values())

    def get(self, protocol_id: int) -> Client | None:
        """Return the client that is registered under an identifier."""
        return self._clients.get(protocol_id)

    def insert(self, client: Client) -> None:
        """Add a client whose identifier is not registered."""
        self._clients[client.protocol_id] = client
        self._order.append(client)

    def remove(self, protocol_id: int) -> None:
        """Remove a client and its payloads."""
        ##= DATA-13 BP-DRG-04
        client = self._clients.pop(protocol_id)
        client.stands = False
        ##= BP-DRG-03
        self._order.remove(client)

    def take(self, room: int, size: Callable[[bytes], int], most: int) -> Chosen:
        """Take payloads for a beacon with ``room`` octets for blocks: at most ``most`` (protocol id, payload)."""
        chosen: Chosen = []
        turn = self._order
        served: dict[int, Client] = {}
        while turn:
            again: list[Client] = []
            for client in turn:
                ##= BP-TX-08
                if len(chosen) == most:
                    break
                payload = None if client.queue is None else client.queue.head()
                if client.queue is None or payload is None:
                    continue
                ##= BP-TX-04 BP-FMT-02
                taken = size(payload)
                ##= BP-TX-06
                if taken > room:
                    # Payloads of a client keep their order, so this client has no further turn in this beacon.
                    continue
                room -= taken
                chosen.append((client.protocol_id, payload))
                client.queue.sent()
                served.setdefault(client.protocol_id, client)
                ##= BP-QM-08
                if client.several:
                    again.append(client)
            turn = again if len(chosen) < most else []
        ##= BP-TX-03
        self._order = [client for client in self._order if client.protocol_id not in served]
        self._order.extend(served.values())
        return chosen
