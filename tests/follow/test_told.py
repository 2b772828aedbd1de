"""The texts for the pilot at the ground station, and the autopilot's own texts for the operator."""

import itertools
import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as dialect

from follow.link.packets import Packets
from follow.messages import Cause, Decision, Mode, Reason
from follow.operator.autopilot_texts import REPEAT_S, AutopilotTexts
from follow.operator.told import LOOSE, PREFIX, TEXT_EVERY_S, PilotTexts, sentence
from racf.box import Box
from racf.track import Track
from tests.follow.test_consoles import GROUND, PAGE, Desk, Ears, tick

LETTERS = 50
READ = [
    (Mode.READY, Reason(Cause.READY), "ready, FOLLOW can be ordered"),
    (Mode.OBSERVE, Reason(Cause.NOT_READY, "target not seen"), "not ready: target not seen"),
    (Mode.OBSERVE, Reason(Cause.ORDER_REFUSED, "GPS lost"), "refused: GPS lost"),
    (
        Mode.OBSERVE,
        Reason(Cause.ORDER_WAITS, f"{GROUND}; waits 3 s for: target not seen"),
        "waits: 3 s for: target not seen",
    ),
    (Mode.ENGAGE, Reason(Cause.FOLLOW_ORDERED, "the page"), "taking over"),
    (Mode.FOLLOW, Reason(Cause.BEGAN), "following"),
    (Mode.COAST, Reason(Cause.NOT_SEEN, seconds=0.7), "target lost, slowing"),
    (Mode.SEARCH, Reason(Cause.NOT_SEEN, seconds=3.0), "searching"),
    (Mode.HOLD, Reason(Cause.NOT_SEEN, seconds=20.0), "given up, hovers"),
    (Mode.FOLLOW, Reason(Cause.OUT_OF_REACH, "faster than limits.speed_m_s"), "target out of reach"),
    (Mode.BRAKE, Reason(Cause.STALE, "frame is 0.6 s old"), "braking: frame is 0.6 s old"),
    (Mode.BRAKE, Reason(Cause.STALE, "attitude is 0.6 s old"), "braking: attitude is 0.6 s old"),
    (Mode.BRAKE, Reason(Cause.BATTERY, "critical"), "battery critical, stops"),
    (Mode.BRAKE, Reason(Cause.REMOTE_LOST), "remote control lost, stops"),
    (Mode.ENDED, Reason(Cause.STICK), "your stick moved, you fly"),
    (Mode.ENDED, Reason(Cause.MODE_LEFT, "POSCTL"), "ended, mode is POSCTL"),
    (Mode.ENDED, Reason(Cause.REFUSED, "the autopilot refused OFFBOARD (DENIED)"), "refused OFFBOARD (DENIED)"),
    (Mode.ENDED, Reason(Cause.OBSERVE_ORDERED, "the page"), "stopped by the page"),
]


def of(mode, reason, t_s=1.0):
    return replace(tick(t_s, mode), decision=Decision(None, mode, (), reason))


@pytest.mark.parametrize(("mode", "reason", "text"), READ)
def test_the_pilot_reads_what_happens_in_two_seconds(mode, reason, text):
    assert sentence(of(mode, reason)) == text
    assert len(PREFIX + text) <= LETTERS


@pytest.mark.parametrize("cause", Cause)
def test_the_text_of_every_cause_begins_with_the_essential(cause):
    for mode in Mode:
        text = sentence(of(mode, Reason(cause, "x", 1.0)))
        assert text
        assert "{" not in text


def test_acts_at_any_console_are_reported_to_the_pilot():
    ears, desk = Ears(), Desk()
    texts = PilotTexts(ears)
    desk.consoles.tell = texts.say
    desk.draw(GROUND)
    desk.at(30.0, Mode.READY)
    desk.order("follow", GROUND)
    desk.order("confirm", GROUND)
    for k in range(100):
        texts.send(30.0 + 0.05 * k)
    assert [text.removeprefix(PREFIX)[:24] for text, _ in ears.texts] == [
        "target selected", "follow: CONFIRM: chase a", "confirmed"]  # fmt: skip
    desk.order("orbit", PAGE)
    assert not texts.waiting, "what was refused at another console for its trims is that console's matter"


@given(
    st.lists(st.tuples(st.sampled_from(list(Mode)), st.sampled_from(list(Cause)), st.floats(0.01, 3.0)), max_size=80)
)
def test_never_more_than_one_text_a_second_whatever_happens(rounds):
    at, t_s = [], 0.0
    ears = Ears()
    texts = PilotTexts(ears)
    for mode, cause, later_s in rounds:
        t_s += later_s
        before = len(ears.texts)
        texts.see(of(mode, Reason(cause, "x", 1.0), t_s))
        at += [t_s] * (len(ears.texts) - before)
    assert all(b - a >= TEXT_EVERY_S for a, b in itertools.pairwise(at))


def test_the_pilot_is_told_that_the_tracker_started_again():
    ears, box = Ears(), Box(100.0, 100.0, 40.0, 60.0)
    texts = PilotTexts(ears)
    for k in range(60):
        track = Track(box, box, psr=20.0, apce=50.0, confidence=1.0, found=True, restarted=k == 5)
        texts.see(replace(of(Mode.FOLLOW, Reason(Cause.BEGAN), 0.1 * k), track=track))
    assert [text for text, _ in ears.texts].count(PREFIX + LOOSE) == 1
    assert len(PREFIX + LOOSE) <= LETTERS


class Autopilot:
    """Sends texts as PX4 and ArduPilot do: longer ones in chunks with one id."""

    def __init__(self, component=1):
        self.packets, self.reader = Packets(1, component), Packets(255, 190)
        self.lines = []
        self.texts = AutopilotTexts(self.lines.append)

    def say(self, text, t_s, number=0, lose=()):
        parts = [text[i : i + 50] for i in range(0, len(text) + 1, 50)] if number else [text[:50]]
        for k, part in enumerate(parts):
            message = dialect.MAVLink_statustext_message(4, part.encode(), number, k)
            if k not in lose:
                for heard in self.reader.read(self.packets.write(message)):
                    self.texts.hear(heard, t_s)


def test_the_autopilots_texts_are_reported_once():
    px4 = Autopilot()
    for k in range(100):
        px4.say("Failsafe activated", 0.1 * k)
    assert px4.lines == ["the autopilot says: Failsafe activated"]
    px4.say("Failsafe activated", REPEAT_S + 0.1)
    assert len(px4.lines) == 2


@pytest.mark.parametrize("length", [51, 99, 100, 101, 180, 249])
def test_a_long_text_is_reported_whole(length):
    text = ("Preflight Fail: heading estimate not stable " * 6)[:length].strip().ljust(length, "x")
    ardupilot = Autopilot()
    ardupilot.say(text, 1.0, number=7)
    assert ardupilot.lines == [f"the autopilot says: {text}"]


def test_a_text_with_a_lost_chunk_is_reported_up_to_the_gap():
    px4 = Autopilot()
    px4.say("a" * 50 + "b" * 20, 1.0, number=3, lose=(0,))
    assert px4.lines == ["the autopilot says: " + "b" * 20]


def test_texts_of_other_senders_are_not_the_autopilots():
    camera = Autopilot(component=100)
    camera.say("nothing stands out there: draw a box", 1.0)
    assert camera.lines == []


@given(st.binary(max_size=50), st.integers(0, 65535), st.integers(0, 255))
def test_no_text_breaks_it_and_each_line_is_one_line(data, number, chunk):
    px4 = Autopilot()
    message = dialect.MAVLink_statustext_message(4, data, number, chunk)
    for heard in px4.reader.read(px4.packets.write(message)):
        px4.texts.hear(heard, 1.0)
    assert all(line.isprintable() and len(line) < 300 for line in px4.lines)
    assert math.isfinite(len(px4.texts.chunks))
