"""The client protocols of BP, and whose payloads go into the next beacon (dcp-bp.md#bp-transmit-path).

Clients are served longest-unserved first: who is put into a beacon goes behind all others, in the order of serving. A
client that found no room is therefore further in front in the next beacon, and after at most as many beacons as there
are clients before it, it is the first one, for which the whole beacon is free. Only when every client had its turn,
those with allowMultiplePayloads have another one, again in this order, until nothing fits.
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
        """In the order of registration."""
        return iter(self._clients.values())

    def get(self, protocol_id: int) -> Client | None:
        """The client that is registered under an identifier."""
        return self._clients.get(protocol_id)

    def insert(self, client: Client) -> None:
        """Take a client that is not in the list."""
        self._clients[client.protocol_id] = client
        self._order.append(client)

    def remove(self, protocol_id: int) -> None:
        """Forget a client and its payloads."""
        ##= DATA-13
        ##= BP-DRG-04
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
                ##= BP-TX-04
                ##= BP-FMT-02
                taken = size(payload)
                ##= BP-TX-06
                if taken > room:
                    # Its other payloads wait behind this one; there will be no more room in this beacon.
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
