"""MAVLink packets: bytes to messages and back, no I/O.

pymavlink's parser trusts a length byte: after a garbage byte 0xFD it waits for, and swallows, up to 280 bytes, and it
takes a packet of unknown type on trust.  Here a packet counts only when its checksum fits; otherwise the search goes
on one byte further, so that noise costs no good message that follows it.
"""

import struct

from pymavlink.dialects.v20 import common as dialect

from follow.link.signing import Signing

Message = dialect.MAVLink_message

MAGIC_V1, MAGIC_V2 = dialect.PROTOCOL_MARKER_V1, dialect.PROTOCOL_MARKER_V2
SIGNED = dialect.MAVLINK_IFLAG_SIGNED
HEADER_V1, HEADER_V2, CHECKSUM, SIGNATURE = 6, 10, 2, 13  # bytes


class SignedMAVLink(dialect.MAVLink):
    """pymavlink's codec, in which a forged packet cannot silence the true sender.

    pymavlink 2.4.50 stores a packet's signing time before it checks the signature, so one forged packet with a late
    time makes every later true one look like a replay.
    """

    def check_signature(self, msgbuf: bytearray, srcSystem: int, srcComponent: int) -> bool:  # noqa: N803 (pymavlink's)
        """Whether the packet is signed with our key and newer than the last one of its stream."""
        times = dict(self.signing.stream_timestamps)
        good = super().check_signature(msgbuf, srcSystem, srcComponent)
        if not good:
            self.signing.stream_timestamps = times
        return good


class Packets:
    """One end of a link.  `unreadable` counts bytes that were no packet, `refused` packets with no good signature."""

    def __init__(self, system_id: int, component_id: int, signing: Signing | None = None):
        self._mav = SignedMAVLink(None, srcSystem=system_id, srcComponent=component_id)
        self._signing = signing
        self._waiting = bytearray()
        self.unreadable = 0
        self.refused = 0
        if signing is not None:
            signing.install(self._mav)

    @property
    def address(self) -> tuple[int, int]:
        """Our own (system id, component id)."""
        return self._mav.srcSystem, self._mav.srcComponent

    @address.setter
    def address(self, address: tuple[int, int]) -> None:
        self._mav.srcSystem, self._mav.srcComponent = address

    def read(self, data: bytes) -> list[Message]:
        """Take in bytes from a stream, cut anywhere; returns the messages that they complete."""
        buffer = self._waiting
        buffer += data
        messages: list[Message] = []
        start = 0
        while start < len(buffer):
            if buffer[start] not in (MAGIC_V1, MAGIC_V2):
                start += 1
                self.unreadable += 1
                continue
            length = packet_length(buffer, start)
            if length is None or start + length > len(buffer):
                break
            message = self._decode(buffer[start : start + length]) if length else None
            if message is None:
                start += 1
                self.unreadable += 1
            else:
                start += length
                if message.get_type() != "BAD_DATA":
                    messages.append(message)
        del buffer[:start]
        return messages

    def read_datagram(self, data: bytes) -> list[Message]:
        """Take in one datagram: whole packets, of which an unfinished one will never be continued."""
        messages = self.read(data)
        while self._waiting:  # what looked like a packet's beginning may hide whole packets behind it
            del self._waiting[:1]
            self.unreadable += 1
            messages += self.read(b"")
        return messages

    def write(self, message: Message) -> bytes:
        """The packet that carries `message`, numbered and, with a key, signed."""
        if self._signing is not None:
            self._signing.stamp(self._mav)
        packet = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return packet

    def _decode(self, packet: bytearray) -> Message | None:
        """The message, BAD_DATA for a whole packet that is refused, None for what is no packet at all."""
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
    """Bytes of the packet whose marker is at `start`; None while its header is incomplete, 0 for no such packet.

    Flags and type are looked at first: noise full of markers would else cost a checksum for each of them.
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


def as_bytewise_int(value: float) -> int:
    """PX4 sends an integer parameter's four bytes in the place of a float's."""
    return int(struct.unpack("<i", struct.pack("<f", value))[0])


def from_bytewise_int(value: int) -> float:
    """The float whose four bytes are those of `value`."""
    return float(struct.unpack("<f", struct.pack("<i", value))[0])
