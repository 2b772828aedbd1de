"""MAVLink packets: bytes to messages and back, no I/O.

pymavlink's parser trusts the length byte: after a garbage byte 0xFD it waits for, and discards, up to 280 bytes, and it
accepts packets of unknown type unchecked.  Here a packet counts only if its checksum is right; otherwise the search
continues one byte further, so that noise never costs the valid packet behind it.
"""

import math
import struct

from pymavlink.dialects.v20 import common as dialect

from follow.link.signing import Signing

Message = dialect.MAVLink_message

MAGIC_V1, MAGIC_V2 = dialect.PROTOCOL_MARKER_V1, dialect.PROTOCOL_MARKER_V2
SIGNED = dialect.MAVLINK_IFLAG_SIGNED
HEADER_V1, HEADER_V2, CHECKSUM, SIGNATURE = 6, 10, 2, 13  # bytes
FALSE_STARTS = 16  # tolerated in a datagram: each costs 10 microseconds, and 1400 bytes of 0xFE would be 1400 of them


class SignedMAVLink(dialect.MAVLink):
    """pymavlink's codec with one fix: a forged packet cannot block the true sender.

    pymavlink 2.4.50 stores a packet's signing timestamp before it checks the signature, so one forged packet with a
    late timestamp makes every genuine packet after it look like a replay.
    """

    def check_signature(self, msgbuf: bytearray, srcSystem: int, srcComponent: int) -> bool:  # noqa: N803 (pymavlink's)
        """Whether the packet is signed with our key and newer than the last one of its sender."""
        times = dict(self.signing.stream_timestamps)
        good = super().check_signature(msgbuf, srcSystem, srcComponent)
        if not good:
            self.signing.stream_timestamps = times
        return good


class Packets:
    """One end of a link.  `unreadable` counts bytes outside packets, `refused` packets not signed with the key."""

    def __init__(self, system_id: int, component_id: int, signing: Signing | None = None):
        self._mav = SignedMAVLink(None, srcSystem=system_id, srcComponent=component_id)
        self._signing = signing
        self._waiting = bytearray()
        self.unreadable = 0
        self.refused = 0
        self.unknown = 0  # packets of another dialect, which nothing here reads
        if signing is not None:
            signing.install(self._mav)

    @property
    def signing(self) -> Signing | None:
        """The key and its clock, None without signing."""
        return self._signing

    @property
    def address(self) -> tuple[int, int]:
        """Our own (system id, component id)."""
        return self._mav.srcSystem, self._mav.srcComponent

    @address.setter
    def address(self, address: tuple[int, int]) -> None:
        self._mav.srcSystem, self._mav.srcComponent = address

    def read(self, data: bytes) -> list[Message]:
        """Decode bytes from a stream, cut at any byte; returns the messages completed by them."""
        self._waiting += data
        return self._search()[0]

    def _search(self, most_false: float = math.inf) -> tuple[list[Message], int]:
        """The messages in the buffer, and the number of false starts; more than `most_false` end the search."""
        buffer = self._waiting
        messages: list[Message] = []
        start = false = 0
        while start < len(buffer) and false <= most_false:
            if buffer[start] not in (MAGIC_V1, MAGIC_V2):
                start += 1
                self.unreadable += 1
                continue
            length = packet_length(buffer, start)
            if length is None or start + length > len(buffer):
                break
            message = self._decode(buffer[start : start + length]) if length else None
            if message is None:
                foreign = length == 0 and is_foreign(buffer, start)
                self.unknown += foreign
                false += not foreign
                start += 1
                self.unreadable += 1
            else:
                start += length
                if message.get_type() != "BAD_DATA":
                    messages.append(message)
        del buffer[:start]
        return messages, false

    def read_datagram(self, data: bytes) -> list[Message]:
        """Decode one datagram: whole packets only; discards incomplete ones, and the rest after FALSE_STARTS.

        A network delivers datagrams unchanged, so one full of false starts was made to waste our time.
        """
        self._waiting += data
        messages, false = self._search(FALSE_STARTS)
        while self._waiting and false <= FALSE_STARTS:  # a false start marker may hide whole packets behind it
            del self._waiting[:1]
            self.unreadable += 1
            found, more = self._search(FALSE_STARTS - false)
            messages, false = messages + found, false + more + 1
        self.unreadable += len(self._waiting)
        self._waiting.clear()
        return messages

    def write(self, message: Message) -> bytes:
        """The packet for `message`, with its sequence number and, with a key, signed."""
        if self._signing is not None:
            self._signing.stamp(self._mav)
        packet = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return packet

    def _decode(self, packet: bytearray) -> Message | None:
        """The message; BAD_DATA for a valid packet that is refused; None for an invalid packet."""
        refused = self._mav.signing.reject_count
        try:
            message = self._mav.decode(packet)
        except dialect.MAVError:
            if self._mav.signing.reject_count == refused:
                return None
            self.refused += 1
            return dialect.MAVLink_bad_data(packet, "signature")
        return message


def packet_length(buffer: bytearray, start: int) -> int | None:
    """Length in bytes of the packet that starts at `start`; None if its header is incomplete, 0 for an invalid header.

    Flags and type are checked first, so that noise full of start markers does not cost a checksum each.
    """
    is_v2 = buffer[start] == MAGIC_V2
    if len(buffer) < start + (HEADER_V2 if is_v2 else HEADER_V1):
        return None
    payload = buffer[start + 1]
    if not is_v2:
        return payload + HEADER_V1 + CHECKSUM if buffer[start + 5] in dialect.mavlink_map else 0
    flags, number = buffer[start + 2], int.from_bytes(buffer[start + 7 : start + 10], "little")
    if flags & ~SIGNED or number not in dialect.mavlink_map:
        return 0
    return payload + HEADER_V2 + CHECKSUM + (SIGNATURE if flags & SIGNED else 0)


def is_foreign(buffer: bytearray, start: int) -> bool:
    """Whether a MAVLink 2 packet of unknown type seems to start here: the next packet, or the end, follows it."""
    if buffer[start] != MAGIC_V2 or len(buffer) < start + HEADER_V2 or buffer[start + 2] & ~SIGNED:
        return False
    signature = SIGNATURE if buffer[start + 2] & SIGNED else 0
    end = start + buffer[start + 1] + HEADER_V2 + CHECKSUM + signature
    return end == len(buffer) or (end < len(buffer) and buffer[end] == MAGIC_V2)


def as_bytewise_int(value: float) -> int:
    """The integer that PX4 sent as the four bytes of a float parameter."""
    return int(struct.unpack("<i", struct.pack("<f", value))[0])
