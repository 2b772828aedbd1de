"""The loop over stubs that record their calls."""

from dataclasses import dataclass, field

import numpy as np

from follow.loop import follow
from follow.messages import (
    HOVER,
    NEVER,
    NO_INSTRUCTION,
    Decision,
    Estimate,
    Frame,
    Instruction,
    Mode,
    Order,
    VehicleState,
)
from racf.box import Box
from racf.track import Track

PICTURE = np.zeros((4, 4, 3), np.uint8)
BOX = Box(1, 1, 2, 2)


@dataclass
class Pieces:
    """Camera, link, tracker, target, servo and gate in one; `said` keeps the order of the calls."""

    rounds: list[Frame | None]
    said: list[object] = field(default_factory=list)
    instructions: list[Instruction] = field(default_factory=list)
    motions: list[object] = field(default_factory=list)
    t_s: float = 0.0

    def frames(self):
        yield from self.rounds

    def state(self):
        self.t_s += 0.1
        return VehicleState(t_s=self.t_s)

    def send(self, setpoint):
        self.said.append(("send", setpoint))

    def predict(self, state, t_s, found=None):
        return BOX

    def order(self, order, reason=None):
        self.said.append(order)

    def allow(self, desired, estimate, state, frame_t_s, instruction=NO_INSTRUCTION, motion=None):
        self.said.append(("allow", frame_t_s))
        self.instructions.append(instruction)
        self.motions.append(motion)
        return Decision(desired, Mode.FOLLOW)


class Tracker:
    def update(self, image, prior=None):
        return Track(prior, prior, 1.0, 1.0, 1.0)


class Target:
    predict = Pieces.predict

    def update(self, track, state, t_s, motion=None):
        return Estimate(state.t_s, 0.0, 0.0, 1.0, 1.0, seen_t_s=t_s if track else NEVER)


class Servo:
    def update(self, estimate, state, wanted=None):
        return HOVER


def fly(rounds, operator=lambda: NO_INSTRUCTION):
    pieces = Pieces(rounds)
    ticks = list(follow(pieces, pieces, Tracker(), Target(), Servo(), pieces, operator))
    return ticks, pieces.said


def test_every_round_sends_what_the_gate_allowed_and_yields_one_tick():
    ticks, said = fly([Frame(PICTURE, 0.0, 0), None, Frame(PICTURE, 0.2, 1)])
    assert len(ticks) == 3
    assert [what for what in said if what[0] == "send"] == [("send", HOVER)] * 3


def test_a_round_without_an_image_still_passes_the_gate_with_the_old_images_time():
    ticks, said = fly([None, Frame(PICTURE, 0.1, 0), None])
    assert [t_s for what, t_s in said if what == "allow"] == [NEVER, 0.1, 0.1]
    assert [tick.track is None for tick in ticks] == [True, False, True]


def test_the_prior_reaches_the_tracker():
    ticks, _ = fly([Frame(PICTURE, 0.0, 0)])
    assert ticks[0].track is not None
    assert ticks[0].track.box == BOX


def test_the_gate_gets_the_operators_instruction_of_the_same_round():
    pieces = Pieces([None, None])
    instructions = [Instruction(Order.FOLLOW), Instruction(forbids="a red check")]
    given = iter(instructions)
    list(follow(pieces, pieces, Tracker(), Target(), Servo(), pieces, lambda: next(given)))
    assert pieces.instructions == instructions


def test_target_and_gate_are_given_the_images_motion_of_the_same_round():
    class Meter:
        def update(self, frame, track, state):
            return "moved" if frame is None else None

    pieces, given = Pieces([Frame(PICTURE, 0.0, 0), None]), []

    class Listening(Target):
        def update(self, track, state, t_s, motion=None):
            given.append(motion)
            return super().update(track, state, t_s, motion)

    list(follow(pieces, pieces, Tracker(), Listening(), Servo(), pieces, meter=Meter()))
    assert pieces.motions == given == [None, "moved"]
