"""The cost of recording for a tick: median and p99 with and without it, alternating in one run.

    python -m benchmarks.recording_cost [--seconds 60] [--encoder jpeg]

Tracks a drawn walker at 30 frames/s as a camera would give it.  For three seconds each round is recorded, for the next
three none is, and so on, so that other load affects both.  A tick is tracker, estimate, servo and gate, and
the recorder's part in the loop; the recorder's threads compete with it for the cores.
"""

import argparse
import itertools
import math
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType

import numpy as np
from typing_extensions import Self

from benchmarks.recording_size import RATE_HZ, SIZES, Clip, scene
from follow.control.servo import Servo
from follow.control.target import Target
from follow.geometry import Intrinsics
from follow.loop import follow
from follow.messages import Frame, Setpoint, VehicleState
from follow.recording.recorder import RecordConfig, Recorder
from follow.recording.video_encoder import Encoder
from follow.safety.gate import Safety
from racf import Racf

BLOCK_S = 3.0
DRAIN_S = 0.7  # after a recorded block the threads write what is still queued


class PacedClip:
    """Camera and link in one: a clip there and back at 30 frames/s, seen from a vehicle that hovers."""

    def __init__(self, clip: Clip, seconds: float) -> None:
        self._shown = list(clip)
        self._count = round(seconds * RATE_HZ)
        self.first = self._shown[0]
        self.box = self.first[1]

    def frames(self) -> Iterator[Frame]:
        """Yield each frame when it is due."""
        began_s = time.monotonic()
        there_and_back = itertools.cycle([*self._shown, *reversed(self._shown)])
        for n, (image, box) in enumerate(itertools.islice(there_and_back, self._count)):
            self.box = box
            time.sleep(max(began_s + n / RATE_HZ - time.monotonic(), 0.0))
            yield Frame(image, time.monotonic(), n)

    def state(self) -> VehicleState:
        """Fresh telemetry."""
        t_s = time.monotonic()
        return VehicleState(t_s, attitude_t_s=t_s, position_t_s=t_s, heartbeat_t_s=t_s)

    def send(self, setpoint: Setpoint | None) -> None:
        """Nobody obeys."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


def ticks_ms(clip: PacedClip, size: tuple[int, int], encoder: Encoder) -> dict[bool, list[float]]:
    """Times of the ticks by whether they were recorded, ms."""
    tracker, down_rad = Racf(), math.radians(30.0)
    tracker.init(*clip.first)
    target, servo = Target(Intrinsics.from_fov(*size, math.radians(80.0)), down_rad), Servo(down_rad)
    took: dict[bool, list[float]] = {True: [], False: []}
    with (
        tempfile.TemporaryDirectory() as folder,
        Recorder(Path(folder), RecordConfig(encoder=encoder), print, waits=False) as recorder,
    ):
        for tick in follow(clip, clip, tracker, target, servo, Safety()):
            assert tick.frame is not None
            block, within_s = divmod(tick.frame.index / RATE_HZ, BLOCK_S)
            recorded, before_s = block % 2 == 0, time.perf_counter()
            if recorded:
                recorder.tick(tick, clip.box)
            if recorded or within_s > DRAIN_S:
                took[recorded].append(sum(tick.stage_ms.values()) + 1e3 * (time.perf_counter() - before_s))
    return took


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--encoder", type=Encoder, default=Encoder.AUTO)
    options = parser.parse_args()
    print("| size | ticks | median without, ms | with | ratio | p99 without, ms | with | ratio |")
    print("|---|---|---|---|---|---|---|---|")
    for size in SIZES:
        took = ticks_ms(PacedClip(scene("walker", size, 10.0), options.seconds), size, options.encoder)
        cells = [f"{size[0]}x{size[1]}", f"{len(took[False])} and {len(took[True])}"]
        for quantile in (50, 99):
            without, with_ = (float(np.percentile(took[recorded], quantile)) for recorded in (False, True))
            cells += [f"{without:.1f}", f"{with_:.1f}", f"{with_ / without:.2f}"]
        print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
