"""Mutated, cut, shuffled and random bytes through everything that reads packets, for a set time.

    python -m tools.fuzz.packets --seconds 60

Prints what was read and fails on the first exception, on a read that takes too long, and when a good packet is not
understood any more.
"""

import argparse
import random
import time

from pymavlink.dialects.v20 import common as dialect

from follow.link.client import MavlinkClient
from follow.messages import Autopilot
from sim.autopilot.system import AutopilotSystem
from sim.dynamics import Vehicle, VehicleTruth

LONGEST_READ_S = 0.5  # a hang; the loop's deadline is 50 ms, but this runs on loaded machines
CHUNK = 2000  # bytes read at once


def spoiled(data: bytes, chance: random.Random) -> bytes:
    """One of the ways in which a link spoils bytes."""
    kind = chance.randrange(5)
    if kind == 0:
        return chance.randbytes(chance.randrange(CHUNK))
    changed = bytearray(data)
    if kind == 1:
        for _ in range(chance.randrange(1, 30)):
            changed[chance.randrange(len(changed))] = chance.randrange(256)
    elif kind == 2:
        at = chance.randrange(len(changed))
        del changed[at : at + chance.randrange(40)]
    elif kind == 3:
        at = chance.randrange(len(changed))
        changed[at:at] = b"\xfd" * chance.randrange(400)
    else:
        pieces = [bytes(changed[n : n + 13]) for n in range(0, len(changed), 13)]
        chance.shuffle(pieces)
        changed = bytearray(b"".join(pieces))
    return bytes(changed)


def main() -> None:
    """Run until the time is over."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    chance = random.Random(options.seed)
    system = AutopilotSystem(Autopilot.PX4, Vehicle(Autopilot.PX4, VehicleTruth(down_m=-10.0)))
    clients = {way: MavlinkClient() for way in (True, False)}
    fresh = dialect.MAVLink(None, 1, 1)
    good = fresh.heartbeat_encode(2, 12, 1, 0, 4).pack(fresh)
    end_s, t_s, count, taken, slowest_s = time.monotonic() + options.seconds, 0.0, 0, 0, 0.0
    while time.monotonic() < end_s:
        t_s += 0.2
        system.step(t_s)
        data = spoiled(b"".join(system.take()), chance)
        count += len(data)
        for datagram, client in clients.items():
            began_s = time.perf_counter()
            taken += len(client.receive(data, t_s, datagram))
            client.step(t_s)
            client.take()
            slowest_s = max(slowest_s, time.perf_counter() - began_s)
            assert slowest_s < LONGEST_READ_S, f"{slowest_s:.2f} s for {len(data)} bytes"
        for client in clients.values():
            for _ in range(30):  # a stream needs up to one longest packet to find its step again
                client.receive(good, t_s)
            assert client.state(t_s).heartbeat_t_s == t_s, "a good packet is not understood any more"
    print(f"{count} bytes twice, {taken} messages read, slowest read {1e3 * slowest_s:.1f} ms")


if __name__ == "__main__":
    main()
