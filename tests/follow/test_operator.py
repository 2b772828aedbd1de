"""Who may order FOLLOW, and what cancels it."""

import errno
import pty
import signal
import socket
import termios
from dataclasses import dataclass, field, replace

import pytest

from follow.flight.finding import Finding, Health
from follow.flight.live_flight import unwaived
from follow.flight.service import Service
from follow.messages import (
    HOVER,
    STARTED,
    Cause,
    Decision,
    Estimate,
    Instruction,
    Mode,
    Order,
    Reason,
    Tick,
    VehicleState,
)
from follow.operator.authority import Keys, Operator, signals

CENTRED = (1500, 1500, 1000, 1500)  # a throttle rests at its lower end


@dataclass
class Ears:
    rc_channels: tuple[int, ...] = ()
    rc_t_s: float = 0.0
    steering: dict[tuple[int, int], float] = field(default_factory=dict)
    joysticks: dict[tuple[int, int], tuple[float, tuple[int, ...]]] = field(default_factory=dict)


@dataclass
class Desk:
    """An operator's side whose vehicle is in whatever mode the test says."""

    operator: Operator
    lines: list[str]
    t_s: float = 0.0
    vehicle_mode: str = "OFFBOARD"
    rc_healthy: bool | None = None
    reason: Reason = STARTED

    def be(self, mode: str) -> Order | None:
        """One round in a mode; the order given in it."""
        return self.round(mode).order

    def hold(self, mode: str, rounds: int = 5) -> list[Order]:
        """Rounds in a mode with the remote as it is; the orders given in them."""
        return [order for _ in range(rounds) if (order := self.be(mode)) is not None]

    def round(self, mode: str) -> Instruction:
        """One round in a mode; the instruction of it."""
        self.t_s += 0.1
        state = VehicleState(self.t_s, mode=self.vehicle_mode, rc_healthy=self.rc_healthy)
        nowhere = Estimate(self.t_s, 0.0, 0.0, 1.0, 1.0)
        self.operator.see(Tick(None, None, state, nowhere, HOVER, Decision(None, Mode(mode), reason=self.reason)))
        if isinstance(self.operator.heard, Ears):
            self.operator.heard.rc_t_s = self.t_s
        return self.operator()


def desk(**options) -> Desk:
    lines: list[str] = []
    return Desk(Operator(lines.append, **options), lines)


def test_nothing_is_ordered_without_the_operator():
    d = desk(heard=Ears(CENTRED))
    assert [d.be(mode) for mode in ("observe", "ready", "engage", "follow", "ended")] == [None] * 5


def test_follow_on_the_command_line_is_ordered_once_and_only_when_ready():
    d = desk(at_once=True)
    assert [d.be(mode) for mode in ("observe", "ready", "ready", "ended", "observe", "ready")] == [
        None,
        Order.FOLLOW,
        *(None,) * 4,
    ]


def test_a_red_check_or_another_sender_forbids_follow():
    d = desk(red=("GUID_TIMEOUT is red",))
    assert d.round("observe").forbids == "GUID_TIMEOUT is red"
    ears = Ears(CENTRED, steering={(255, 190): 0.0})
    d = desk(heard=ears)
    d.operator.order(Order.FOLLOW)
    assert "system 255 component 190" in d.round("ready").forbids


def test_a_switch_orders_by_its_change_and_not_by_where_it_stands():
    ears = Ears((*CENTRED, 1900))
    d = desk(heard=ears, channel=5)
    assert d.hold("ready") == []
    ears.rc_channels = (*CENTRED, 1500)
    assert d.hold("ready") == []
    ears.rc_channels = (*CENTRED, 1100)
    assert d.hold("ready") == [Order.OBSERVE]
    ears.rc_channels = (*CENTRED, 1900)
    assert d.hold("ready") == [Order.FOLLOW]
    assert d.hold("engage") == []


def test_one_wrong_sample_of_a_switch_is_not_an_order():
    ears = Ears((*CENTRED, 1100))
    d = desk(heard=ears, channel=5)
    assert d.hold("ready") == []
    for pwm in (1980, 1100, 1980, 1980, 1100):
        ears.rc_channels = (*CENTRED, pwm)
        assert d.be("ready") is None


@pytest.mark.parametrize("lost", ["unhealthy", "silent"])
def test_a_switch_that_returns_with_its_remote_is_not_an_order(lost):
    ears = Ears((*CENTRED, 1900))
    d = desk(heard=ears, channel=5)
    assert d.hold("ready") == []
    ears.rc_channels = (*CENTRED, 1100)  # the receiver's failsafe
    if lost == "silent":
        d.operator.heard = None
        d.hold("ready", 30)
        d.operator.heard = ears
        d.operator.remote.forget()
    else:
        d.rc_healthy = False
        assert d.hold("ready", 30) == []
    ears.rc_channels = (*CENTRED, 1900)
    d.rc_healthy = True
    assert d.hold("ready", 30) == []


def test_a_moved_stick_or_a_changed_mode_cancels_queued_orders():
    ears = Ears(CENTRED)
    d = desk(heard=ears)
    d.hold("follow")
    for _ in range(3):
        d.operator.order(Order.FOLLOW, "key f")
    ears.rc_channels = (1900, *CENTRED[1:])
    assert d.hold("follow", 2)[-1] is Order.OBSERVE
    assert d.hold("ended") == []
    for _ in range(3):
        d.operator.order(Order.FOLLOW, "key f")
    d.vehicle_mode = "RTL"
    assert d.hold("ended") == []


def test_a_moved_stick_cancels_a_queued_order():
    ears = Ears(CENTRED)
    d = desk(heard=ears)
    d.operator.order(Order.FOLLOW, "key f")
    d.reason = Reason(Cause.ORDER_WAITS, "key f")
    d.hold("observe")
    ears.rc_channels = (1900, *CENTRED[1:])
    assert Order.OBSERVE in d.hold("observe")


@pytest.mark.parametrize("stick", range(4))
def test_a_moved_stick_takes_control_back(stick):
    ears = Ears(CENTRED)
    d = desk(heard=ears)
    assert d.be("follow") is None
    sticks = list(CENTRED)
    sticks[stick] += 140
    ears.rc_channels = tuple(sticks)
    assert d.hold("follow") == []
    sticks[stick] += 40
    ears.rc_channels = tuple(sticks)
    assert d.be("follow") is None  # one sample may be wrong
    assert d.be("follow") is Order.OBSERVE


STATION = (255, 190)


def with_joystick(sticks: tuple[int, ...]) -> tuple[Desk, Ears]:
    """A desk that hears a ground station's sticks, and no remote control."""
    ears = Ears(joysticks={STATION: (0.0, sticks)})
    return desk(heard=ears), ears


def stick_rounds(d: Desk, ears: Ears, sticks: tuple[int, ...], mode: str, rounds: int = 5) -> list[Reason]:
    """Rounds with new samples of a ground station's sticks; the reasons of the orders given."""
    found = []
    for _ in range(rounds):
        ears.joysticks[STATION] = d.t_s, sticks
        instruction = d.round(mode)
        found += [instruction.reason] if instruction.order is Order.OBSERVE else []
    return found


@pytest.mark.parametrize("rest", [(1500, 1500, 1500, 1500), CENTRED, (1900, 1300, 1000, 1500)])
def test_a_ground_stations_stick_that_nobody_moves_forbids_nothing(rest):
    d, ears = with_joystick(rest)
    d.operator.order(Order.FOLLOW, "key f")
    assert d.round("ready").order is Order.FOLLOW
    assert stick_rounds(d, ears, rest, "follow", 30) == []
    assert d.round("follow").forbids == ""


@pytest.mark.parametrize("stick", range(4))
def test_a_ground_stations_stick_takes_control_back_like_the_pilots(stick):
    d, ears = with_joystick(CENTRED)
    assert stick_rounds(d, ears, CENTRED, "follow") == []
    moved = tuple(pwm + 200 * (i == stick) for i, pwm in enumerate(CENTRED))
    reason = stick_rounds(d, ears, moved, "follow")[0]
    assert str(reason) == "the pilot moved a stick of system 255 component 190"
    assert d.round("ready").forbids == ""


FAILSAFE = (1500, 1500, 988, 1500)


def test_a_receivers_failsafe_values_are_no_stick_movement():
    ears = Ears((1500, 1500, 1500, 1500))
    d = desk(heard=ears)
    assert d.hold("follow") == []
    ears.rc_channels = FAILSAFE
    given = [d.round("follow") for _ in range(5)]
    assert next(i.reason.cause for i in given if i.order is Order.OBSERVE) is Cause.STICK_JUMPED


@pytest.mark.parametrize("second", [(1500, 1500, 1040, 1500), (1500, 1500, 1320, 1500)])
def test_a_stick_moved_by_hand_is_a_takeover(second):
    ears = Ears((1500, 1500, 1500, 1500))
    d = desk(heard=ears)
    assert d.hold("follow") == []
    ears.rc_channels = (1500, 1500, 1000 if second[2] < 1100 else 1330, 1500)
    assert d.be("follow") is None
    ears.rc_channels = second
    assert d.round("follow").reason.cause is Cause.STICK


@pytest.mark.parametrize("mode", ["BRAKE", "HOLD", "GUIDED"])
def test_a_stick_after_the_end_counts_only_where_sticks_do_nothing(mode):
    ears = Ears(FAILSAFE)
    d = desk(heard=ears)
    d.vehicle_mode = mode
    assert d.hold("ended", 20) == []
    ears.rc_channels = (*CENTRED[:2], 1500, 1500)  # the pilot is back
    assert d.hold("ended", 3)[-1] is Order.OBSERVE
    d.vehicle_mode = "LOITER"
    assert d.hold("ended", 20) == []


def test_another_sender_while_following_takes_control_back():
    ears = Ears()
    d = desk(heard=ears)
    assert d.be("follow") is None
    ears.steering[1, 195] = d.t_s
    assert d.be("follow") is Order.OBSERVE
    assert d.round("follow").forbids == "system 1 component 195 also steers, by setpoints"


def test_signals_order_and_leave_and_the_second_leave_does_not_wait():
    d = desk()
    with signals(d.operator):
        signal.raise_signal(signal.SIGUSR1)
        assert d.be("ready") is Order.FOLLOW
        signal.raise_signal(signal.SIGTERM)
        assert d.operator.leaving == "SIGTERM"
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


def test_a_waiver_must_name_a_check_and_lets_only_that_one_pass():
    red = [Finding(name, Health.RED, "bad", "fix it") for name in ("disk", "signing")]
    lines: list[str] = []
    assert unwaived([*red, Finding("link", Health.OK, "fine")], ["disk"], lines.append) == ("signing is red",)
    assert len(lines) == 2
    assert lines[0].endswith("(waived)")
    with pytest.raises(ValueError, match="disc"):
        unwaived(red, ["disc"], lines.append)


def test_the_watchdog_is_fed_by_rounds_and_never_blocks(tmp_path):
    address = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(address)
        service = Service(address)
        service.ready()
        for t_s in (1.0, 1.1, 1.6, 1.7, 0.3):
            service.alive(t_s, "follow")
        said = [manager.recv(100) for _ in range(4)]
    service.alive(9.0, "follow")
    service.close()
    assert said[0] == b"READY=1"
    assert all(text.startswith(b"WATCHDOG=1") for text in said[1:])


def test_a_mode_is_reported_once_with_its_reason():
    d = desk()
    tick = Tick(
        None,
        None,
        VehicleState(1.0),
        Estimate(1.0, 0.0, 0.0, 1.0, 1.0),
        HOVER,
        Decision(None, Mode.BRAKE, (), Reason(Cause.STALE, "no frame")),
    )
    d.operator.see(tick)
    d.operator.see(replace(tick))
    assert d.lines == ["0.0 s: brake (no frame), vehicle in no known mode"]


def test_a_deflected_stick_is_detected_across_a_gap_of_the_remote_control():
    ears = Ears(CENTRED)
    d = desk(heard=ears)
    assert d.be("follow") is None
    ears.rc_channels = (0, 0, 0, 0)  # not received
    assert d.be("follow") is None
    ears.rc_channels = (1900, *CENTRED[1:])
    assert Order.OBSERVE in d.hold("follow")


def test_two_sighups_leave_once():
    d = desk()
    with signals(d.operator):
        signal.raise_signal(signal.SIGHUP)
        signal.raise_signal(signal.SIGHUP)
        assert d.operator.leaving == "SIGHUP"


def test_a_terminal_that_is_gone_is_no_error(monkeypatch):
    def gone(*_what: object) -> bytes:
        raise OSError(errno.EIO, "Input/output error")

    def hung_up(*_what: object) -> None:
        raise termios.error(errno.EIO, "Input/output error")

    ours, theirs = pty.openpty()
    with open(ours, "wb", buffering=0) as person, open(theirs) as terminal:
        monkeypatch.setattr("sys.stdin", terminal)
        d = desk()
        with Keys() as keys:
            person.write(b"f")
            monkeypatch.setattr("os.read", gone)
            monkeypatch.setattr("termios.tcsetattr", hung_up)
            keys.read_into(d.operator)
            keys.read_into(d.operator)
        assert not d.operator.waiting


def test_an_early_key_is_refused_in_words_and_not_echoed(monkeypatch):
    ours, theirs = pty.openpty()
    lines: list[str] = []
    with open(ours, "wb", buffering=0) as person, open(theirs) as terminal:
        monkeypatch.setattr("sys.stdin", terminal)
        with Keys() as keys:
            assert keys.are_there
            assert not termios.tcgetattr(theirs)[3] & termios.ECHO
            person.write(b"fxf ")
            keys.refuse_early(lines.append)
            keys.refuse_early(lines.append)
            assert lines == [
                "not ready yet: key f orders nothing",
                "not ready yet: the space bar orders nothing",
            ]
            person.write(b"q")
            with pytest.raises(KeyboardInterrupt):
                keys.refuse_early(lines.append)
        assert termios.tcgetattr(theirs)[3] & termios.ECHO


def test_a_key_without_a_letter_orders_nothing_and_another_is_answered(monkeypatch):
    """End is ESC [ F and F1 is ESC O P: in lower case they would order FOLLOW and OBSERVE."""
    ours, theirs = pty.openpty()
    with open(ours, "wb", buffering=0) as person, open(theirs) as terminal:
        monkeypatch.setattr("sys.stdin", terminal)
        d = desk()
        with Keys() as keys:
            person.write(b"\x1b[F\x1bOP\x1b[1;5D\x1b[3~\t")
            keys.read_into(d.operator)
            assert (d.operator.waiting, d.lines) == ([], [])
            person.write(b"xxf")
            keys.read_into(d.operator)
        assert [line.partition(";")[0] for line in d.lines] == ["key x orders nothing"]
        assert d.operator.waiting == [(Order.FOLLOW, "key f")]


def test_each_refused_order_is_answered():
    d = desk()
    d.reason = Reason(Cause.ORDER_REFUSED, "the vehicle is in BRAKE")
    d.hold("observe", 3)  # the first refusal
    for _ in range(2):
        d.operator.order(Order.FOLLOW, "key f")
        d.hold("observe", 3)
    assert [line.partition(": ")[2] for line in d.lines].count("FOLLOW refused: the vehicle is in BRAKE") == 2
    assert sum("FOLLOW refused" in line for line in d.lines) == 3, "in no other round"
