"""Memory while a long flight is recorded, and whether its file opens and can be read from the middle.

    python -m benchmarks.long_recording [--minutes 30]

Records ten seconds of a drawn scene again and again, as fast as the recorder takes it, and prints the process's memory
each simulated minute.  Exits 1 if it grows by more than 50 MB after the second minute, or if the file does not open.
"""

import argparse
import itertools
import sys
import tempfile
import time
from pathlib import Path

import av

from benchmarks.recording_size import RATE_HZ, scene
from examples.read_a_recording import packets
from follow.messages import Decision, Estimate, Frame, Mode, Setpoint, Tick, VehicleState
from follow.recording.recorder import RecordConfig, Recorder
from racf.track import Track

MOST_GROWTH_MB = 50.0


def memory_mb() -> float:
    """The resident memory of this process (Linux)."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=30.0)
    options = parser.parse_args()
    clip = list(scene("walker", (640, 360), 10.0))
    there_and_back = [
        *clip,
        *reversed(clip),
    ]  # without a jump between repetitions, which would cost the encoder a key frame
    used: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        began_s = time.monotonic()
        with Recorder(Path(folder), RecordConfig(), print, waits=True) as recorder:
            count = round(options.minutes * 60 * RATE_HZ)
            for n, (image, box) in enumerate(itertools.islice(itertools.cycle(there_and_back), count)):
                t_s = n / RATE_HZ
                track = Track(box, box.scaled(3.0), 20.0, 50.0, 0.9)
                estimate = Estimate(t_s, 0.1, 0.5, 12.0, 1.0, seen_t_s=t_s)
                sent = Setpoint(1.0, 0.1, 0.0, 0.1)
                decision = Decision(sent, Mode.FOLLOW)
                recorder.tick(Tick(Frame(image, t_s, n), track, VehicleState(t_s), estimate, sent, decision), box)
                if n % round(60 * RATE_HZ) == 0:
                    used.append(memory_mb())
                    print(
                        f"{t_s / 60:4.0f} min  {used[-1]:7.1f} MB  after {time.monotonic() - began_s:.0f} s", flush=True
                    )
        size = (Path(folder) / "flight.rrd").stat().st_size / 1e6
        found = list(packets(Path(folder)))
        middle = next(n for n in range(len(found) // 2, len(found)) if is_key(found[n][2]))
        decoder = av.CodecContext.create("h264", "r")
        seen = sum(len(decoder.decode(av.Packet(data))) for _, _, data in found[middle : middle + 60])
        rows = len((Path(folder) / "ticks.csv").read_text().splitlines()) - 1
    growth = max(used[2:], default=0.0) - used[min(2, len(used) - 1)]
    print(f"{size:.0f} MB, {len(found)} frames, {rows} rows; {seen} frames decoded from {found[middle][0]:.0f} s on")
    print(f"memory grew by {growth:.1f} MB after the second minute")
    return 0 if growth <= MOST_GROWTH_MB and len(found) == rows == count and seen >= 58 else 1


def is_key(data: bytes) -> bool:
    """Whether an H.264 packet of Annex B can be decoded by itself: a NAL unit of type 5."""
    starts = (n for n in range(len(data) - 4) if data[n : n + 3] == b"\x00\x00\x01")
    return any(data[n + 3] & 31 == 5 for n in itertools.islice(starts, 6))


if __name__ == "__main__":
    sys.exit(main())
