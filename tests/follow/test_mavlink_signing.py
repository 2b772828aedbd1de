"""Signing: what is refused, what is counted, and a time that never runs back.  The autopilot's side is pymavlink's."""

import os
import threading
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common as dialect

from follow.link.packets import Packets
from follow.link.signing import EPOCH_S, UNITS_PER_S, Signing, read_key
from follow.messages import HOVER, Autopilot
from tests.support.autopilot_pair import Pair

KEY = bytes(range(32))


def key_file(folder: Path, content: bytes = KEY, mode: int = 0o600) -> Path:
    path = folder / "signing.key"
    path.write_bytes(content)
    path.chmod(mode)
    return path


def test_two_sides_with_the_same_key_understand_each_other(tmp_path):
    pair = Pair(Autopilot.PX4, key=KEY, signing=Signing(key_file(tmp_path)))
    pair.fly()
    assert pair.client.packets.refused == 0


@pytest.mark.parametrize("key", [None, bytes(32)])
def test_unsigned_and_wrongly_signed_packets_are_dropped_and_counted(tmp_path, key):
    pair = Pair(Autopilot.PX4, key=key, signing=Signing(key_file(tmp_path)))
    pair.run(2.0)
    assert pair.client.vehicle_id is None
    assert pair.client.packets.refused > 10


def test_an_autopilot_with_a_key_does_not_obey_a_client_without(tmp_path):
    pair = Pair(Autopilot.ARDUPILOT, key=KEY)
    pair.run(2.0)  # the client reads signed packets without checking them
    pair.client.take_control()
    pair.setpoint = HOVER
    pair.run(2.0)
    assert pair.system.flight.mode != "GUIDED"


def test_a_replayed_packet_is_refused(tmp_path):
    theirs = Packets(1, 1, Signing(key_file(tmp_path)))
    packet = theirs.write(dialect.MAVLink_heartbeat_message(2, 12, 1, 0, 4, 3))
    ours = Packets(1, 191, Signing(tmp_path / "signing.key"))
    assert len(ours.read(packet)) == 1
    assert ours.read(packet) == []
    assert ours.refused == 1


def test_a_forged_packet_does_not_silence_the_true_sender(tmp_path):
    key = key_file(tmp_path)
    theirs, ours = Packets(1, 1, Signing(key)), Packets(1, 191, Signing(key))
    message = dialect.MAVLink_heartbeat_message(2, 12, 1, 0, 4, 3)
    assert ours.read(theirs.write(message))
    forger = dialect.MAVLink(None, 1, 1)
    forger.signing.secret_key = bytes(32)
    forger.signing.sign_outgoing = True
    forger.signing.timestamp = (1 << 48) - 2  # the latest time there is
    assert ours.read(message.pack(forger)) == []
    assert ours.read(theirs.write(message))


@pytest.mark.parametrize("mode", [0o644, 0o640, 0o604, 0o660, 0o601])
def test_a_key_that_others_may_read_is_refused(tmp_path, mode):
    with pytest.raises(ValueError, match="chmod 600"):
        read_key(key_file(tmp_path, mode=mode))


def test_a_key_that_is_not_there_says_how_to_make_one(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"there is no signing key .*urandom > .*chmod 600") as error:
        read_key(tmp_path / "none.key")
    assert "Errno" not in str(error.value)


def test_a_key_is_32_bytes_or_64_hexadecimal_digits(tmp_path):
    assert read_key(key_file(tmp_path)) == KEY
    assert read_key(key_file(tmp_path, KEY.hex().encode() + b"\n")) == KEY
    for wrong in (b"", b"short", b"zz" * 32, KEY + b"!"):
        with pytest.raises(ValueError, match="32 bytes or 64"):
            read_key(key_file(tmp_path, wrong))


def signed_at(packets: Packets) -> int:
    packet = packets.write(dialect.MAVLink_heartbeat_message(2, 12, 1, 0, 4, 3))
    return int.from_bytes(packet[-12:-6], "little")


def test_the_time_goes_on_after_a_restart_and_after_the_clock_was_set_back(tmp_path, monkeypatch):
    key = key_file(tmp_path)
    monkeypatch.setattr("time.time", lambda: 1.8e9)
    before = [signed_at(packets) for packets in [Packets(1, 191, Signing(key))] for _ in range(3)]
    assert before == sorted(set(before))
    monkeypatch.setattr("time.time", lambda: 1.5e9)  # a machine without a clock battery
    assert signed_at(Packets(1, 191, Signing(key))) > before[-1]


def test_the_stored_time_survives_a_half_written_file(tmp_path):
    key = key_file(tmp_path)
    (tmp_path / "signing.key.time").write_text("12x")
    assert signed_at(Packets(1, 191, Signing(key))) > 0
    assert not os.path.exists(tmp_path / "signing.key.time.new")


def test_a_time_that_cannot_be_kept_stops_the_start_and_not_the_flight(tmp_path, monkeypatch, caplog):
    key = key_file(tmp_path)
    packets = Packets(1, 191, Signing(key))

    def full(*_paths: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full)
    late = 2.0e9
    monkeypatch.setattr("time.time", lambda: late)
    assert signed_at(packets) > 0
    (saver,) = [thread for thread in threading.enumerate() if thread.name == "signing time"] or [None]
    if saver is not None:
        saver.join(60)
    assert "No space left" in caplog.text
    with pytest.raises(OSError, match="No space left"):
        Signing(key)


def test_many_restarts_leave_the_time_within_the_minute_that_a_vehicle_allows(tmp_path, monkeypatch):
    key = key_file(tmp_path)
    now = 1.8e9
    monkeypatch.setattr("time.time", lambda: now)
    stamps = [signed_at(Packets(1, 191, Signing(key))) for _ in range(50)]
    assert stamps == sorted(set(stamps))
    assert stamps[-1] < (now - EPOCH_S + 30.0) * UNITS_PER_S
