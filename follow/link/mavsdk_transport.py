"""A transport over MAVSDK, which maintains the connection and our heartbeat; messages pass through MavlinkDirect.

MAVSDK's Offboard plugin is never used: its thread resends the last setpoint even if this program hangs, which keeps the
autopilot's failsafe from acting.  A message sent through MavlinkDirect is sent once.
"""

import json
import logging
import math
from collections.abc import Callable
from queue import Empty, SimpleQueue

from mavsdk import Configuration, LogLevel, Mavsdk, log_subscribe
from mavsdk.exceptions import MavsdkError
from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkDirectError, MavlinkMessage
from pymavlink.dialects.v20 import common as dialect

from follow.link import LinkError
from follow.link.identity import Source
from follow.link.packets import Message, Packets
from follow.link.transports import Reach, reach_of

log = logging.getLogger(__name__)

LEVELS = {LogLevel.DEBUG: logging.DEBUG, LogLevel.INFO: logging.INFO, LogLevel.WARN: logging.WARNING}
LOOK_AT = "address, port, baud rate, cable and power"
KINDS: dict[str, Callable[..., Message]] = {kind.msgname: kind for kind in dialect.mavlink_map.values()}
FIELDS = {kind.msgname: kind.fieldnames for kind in dialect.mavlink_map.values()}


class MavsdkTransport:
    """A connection in MAVSDK's own notation: `udpin://HOST:PORT`, `udpout://...`, `tcpout://...`, `serial://DEVICE:BAUD`.

    Blocks up to `timeout_s` for an autopilot's heartbeat.  Raises LinkError without one, or if MAVSDK refuses the URL.
    """

    datagrams = True

    def __init__(self, url: str, system_id: int | None = None, timeout_s: float = 10.0):
        log_subscribe(_log)  # by default it writes to standard output, which is for results
        self._arrived: SimpleQueue[bytes] = SimpleQueue()
        self._codecs: dict[tuple[int, int], Packets] = {}
        self._reader = Packets(0, 0)
        self._url = url
        self._mavsdk = self._start(url, system_id or 1)
        system = self._mavsdk.first_autopilot(timeout_s)
        if system is None:
            self._mavsdk.destroy()
            raise LinkError(f"MAVSDK heard no autopilot on {url} within {timeout_s:g} s: look at {LOOK_AT}")
        if system_id is None and system.get_system_id() != 1:  # our system id must equal the vehicle's
            own_id = system.get_system_id()
            self._mavsdk.destroy()
            self._mavsdk = self._start(url, own_id)
            system = self._mavsdk.first_autopilot(timeout_s)
            if system is None:
                self._mavsdk.destroy()
                raise LinkError(f"MAVSDK lost system {own_id} on {url}")
        self._direct = MavlinkDirect(system)
        self._subscription = self._direct.subscribe_message("", self._hear)

    def read(self, timeout_s: float) -> tuple[bytes, Source]:
        """The next message that MAVSDK received, as a packet with a new sequence number."""
        try:
            return self._arrived.get(timeout=timeout_s), None
        except Empty:
            return b"", None

    def write(self, packet: bytes) -> bool:
        """Pass one packet's message to MAVSDK, once.  Heartbeats are skipped: MAVSDK sends its own."""
        (message,) = self._reader.read_datagram(packet)
        if isinstance(message, dialect.MAVLink_heartbeat_message):
            return True
        try:
            self._direct.send_message(_to_mavsdk(message))
        except MavlinkDirectError:
            return False
        return True

    def answer_to(self, source: Source) -> None:
        """Do nothing: MAVSDK keeps the vehicle's address."""

    def reach(self) -> Reach:
        """Decided by the host in the URL: MAVSDK does not give the vehicle's address."""
        if self._url.startswith("serial"):
            return Reach.SERIAL
        host, _, _port = self._url.rpartition("://")[2].rpartition(":")
        return reach_of(host)

    def trouble(self) -> str:
        """Always "": MAVSDK keeps to itself why nothing comes."""
        return ""

    def close(self) -> None:
        """End MAVSDK and its threads."""
        self._direct.unsubscribe_message(self._subscription)
        self._mavsdk.destroy()

    def _start(self, url: str, system_id: int) -> Mavsdk:
        own = Configuration.create_manual(system_id, dialect.MAV_COMP_ID_ONBOARD_COMPUTER, True)
        mavsdk = Mavsdk(own)
        try:
            mavsdk.add_any_connection_with_handle(url)
        except MavsdkError as error:
            mavsdk.destroy()
            raise LinkError(f"MAVSDK cannot open {url}: {error}") from None
        return mavsdk

    def _hear(self, heard: MavlinkMessage, _user: None) -> None:
        """Runs in MAVSDK's thread: turn its fields back into a packet, so that all transports share one code path."""
        kind = KINDS.get(heard.message_name)
        if kind is None:
            return
        fields = json.loads(heard.fields_json)
        source = heard.system_id, heard.component_id
        codec = self._codecs.setdefault(source, Packets(*source))
        message = kind(*(_from_json(fields.get(name)) for name in FIELDS[heard.message_name]))
        self._arrived.put(codec.write(message))


def open_mavsdk(uri: str, system_id: int | None = None) -> MavsdkTransport:
    """Open `mavsdk+URL`."""
    return MavsdkTransport(uri.removeprefix("mavsdk+"), system_id)


def _from_json(value: object) -> object:
    """MAVSDK writes non-finite numbers as null."""
    if value is None:
        return math.nan
    return value.encode() if isinstance(value, str) else value


def _to_mavsdk(message: Message) -> MavlinkMessage:
    fields = message.to_dict()
    del fields["mavpackettype"]
    return MavlinkMessage(
        message_name=message.get_type(),
        system_id=message.get_srcSystem(),
        component_id=message.get_srcComponent(),
        target_system_id=fields.get("target_system", 0),
        target_component_id=fields.get("target_component", 0),
        fields_json=json.dumps(fields),
    )


def _log(level: LogLevel, text: str, _file: str | None, _line: int) -> bool:
    log.log(LEVELS.get(level, logging.ERROR), "MAVSDK: %s", text)
    return True
