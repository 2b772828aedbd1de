"""A requested flight mode: when to send its command, and when the request is over."""

from dataclasses import dataclass

from follow.messages import NEVER, Autopilot, VehicleState

REPEAT_S = 0.7  # a command without a reply is repeated after this, as the command protocol does
TIMES = 3
GRACE_S = 3.0  # wait this long for an acknowledged mode; PX4's heartbeat shows it up to 1 s late
STREAM_BEFORE_S = {Autopilot.PX4: 1.2, Autopilot.ARDUPILOT: 0.0}  # PX4: more than 1 s of setpoints at more than 2 Hz


@dataclass(slots=True)
class ModeRequest:
    """A mode requested from a vehicle that is in one of `from_modes`.

    Only a heartbeat newer than `cause_t_s` can confirm it or show another mode.  `cause_t_s` is the last heartbeat
    before control was requested, or the time of the reason for Hold, and after each command the last heartbeat before
    it.  `since_t_s` is when the timeout began, None while a request for control waits for the stream of setpoints.
    """

    mode: str
    from_modes: tuple[str, ...]
    cause_t_s: float
    times: int = 0
    next_t_s: float = NEVER
    since_t_s: float | None = None

    def may_send(self, now: VehicleState, t_s: float, control: str, streaming_s: float | None, answered: bool) -> bool:
        """Whether the command is due: for `control` while setpoints stream, else while the mode is still ours."""
        if t_s < self.next_t_s or self.times == TIMES or (self.times and answered) or now.autopilot is None:
            return False
        if self.mode == control:
            return streaming_s is not None and streaming_s >= STREAM_BEFORE_S[now.autopilot]
        ours = control if control in self.from_modes else self.from_modes[0]
        return now.heartbeat_t_s > self.cause_t_s and now.mode == ours

    def sent(self, heartbeat_t_s: float, t_s: float) -> None:
        """Note that the command was sent at `t_s`, when the newest heartbeat was of `heartbeat_t_s`."""
        self.cause_t_s = heartbeat_t_s
        self.times += 1
        self.next_t_s = t_s + REPEAT_S
        self.since_t_s = t_s if self.times == 1 else self.since_t_s

    def overdue(self, t_s: float) -> bool:
        """Whether the request has timed out at `t_s`, counted from the reason for Hold or from the first command."""
        since_t_s = self.since_t_s
        return since_t_s is not None and t_s >= since_t_s + GRACE_S and t_s >= self.next_t_s
