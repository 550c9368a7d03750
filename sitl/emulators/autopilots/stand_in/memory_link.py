"""A MAVLink link that hands messages over as objects, where nothing reads bytes: between parties of one flight in virtual time.

Access, peers, sequence numbers and counters are those of any link. Values are not rounded to their types on the wire.
"""

from collections import Counter
from collections.abc import Callable

from drivers.endpoint import Address
from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import Message
from drivers.mavlink.links import Link, LinkOptions, Links
from estimator.contracts.time import Clock

PEER: Address = ("127.0.0.1", 14550)
"""Address of the other party, as a link that listens knows it."""


class MemoryLink(Link):
    """One end of such a link; it is always open."""

    def __init__(self, number: int, options: LinkOptions, links: Links, clock: Clock) -> None:
        super().__init__(number, options, links, clock)
        self.carry: Callable[[Message], None] = lambda message: None
        """Takes each message to the other end."""
        self.down = None
        self._spoken: Counter[int] = Counter()
        links.opened[number] += 1
        self._other = PEER if options.endpoint.scheme == "udpin" else None
        if self._other is None:
            self.admit(None, clock.now())

    def forward(self, message: Message) -> None:
        self.carry(message)

    def receive(self, message: Message) -> None:
        """Take a message that has come from the other end."""
        now = self._clock.now()
        if (peer := self._peers.get(self._other)) is not None:
            peer.received_at = now
        self._hand_on(message, now, self._other)

    def _transmit(self, codec: Codec, address: Address | None, message: Message, component: int | None) -> bool:
        system, own = self._links.identity
        header = message.get_header()
        header.srcSystem, header.srcComponent = system, own if component is None else component
        header.seq = self._spoken[header.srcComponent] % 256
        self._spoken[header.srcComponent] += 1
        self._links.note_sent(message)
        self.carry(message)
        return True
