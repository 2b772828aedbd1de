"""Random desired setpoints, states and times through the gate: no limit is broken, every number sent is finite.

    python -m tools.fuzz.gate --rounds 1000000 --seed 0

Prints one line of figures; exits 1 at the first violation and names it.  The checks compare the gate's state before and
after a round by plain arithmetic and share no code with the gate.
"""

import argparse
import json
import math
import random
import sys
import time

from follow.messages import (
    NO_INSTRUCTION,
    Autopilot,
    BatteryLevel,
    Cause,
    Decision,
    Estimate,
    Instruction,
    Landed,
    Mode,
    Order,
    Reason,
    Setpoint,
    VehicleState,
)
from follow.safety.gate import Gate, Limits, decide

WILD = (math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, 0.0, -0.0, 1e9, -1e9)
LIMITS = Limits(half_view_rad=math.radians(35.0), latency_s=0.0)
SLACK = 1e-9


def number(rng: random.Random, scale: float, wild: float) -> float:
    """A normal number of standard deviation `scale`, or with probability `wild` an absurd one."""
    return rng.choice(WILD) if rng.random() < wild else rng.gauss(0.0, scale)


def flight(rng: random.Random, rounds: int):
    """Yield (desired, estimate, state, frame time, order) of one flight with invalid data now and then."""
    t_s, wild = rng.uniform(0, 1e4), rng.choice((0.0, 0.0, 0.01, 0.2))
    yaw, control = rng.uniform(-math.pi, math.pi), True
    north, east, down = rng.gauss(0, 200), rng.gauss(0, 200), -abs(rng.gauss(20, 30))
    for i in range(rounds):
        t_s += rng.choice((0.0, 1 / 60, 1 / 30, 1 / 10, 0.5)) if rng.random() < 0.99 else rng.gauss(0, 5)
        yaw += rng.gauss(0, 0.1)
        north, east, down = north + rng.gauss(0, 1), east + rng.gauss(0, 1), down + rng.gauss(0, 0.2)
        control = control if rng.random() < 0.999 else not control
        age = [abs(rng.gauss(0, 0.02)) if rng.random() < 0.98 else rng.uniform(-5, 5) for _ in range(5)]
        state = VehicleState(
            t_s=t_s if rng.random() >= wild / 10 else rng.choice(WILD),
            attitude_t_s=t_s - age[0],
            position_t_s=t_s - age[1],
            heartbeat_t_s=t_s - age[2],
            yaw_rad=yaw if rng.random() >= wild else rng.choice(WILD),
            pitch_rad=number(rng, 0.2, wild),
            north_m=north if rng.random() >= wild else rng.choice(WILD),
            east_m=east,
            down_m=down if rng.random() >= wild else rng.choice(WILD),
            north_m_s=number(rng, 5, wild),
            east_m_s=number(rng, 5, wild),
            down_m_s=number(rng, 2, wild),
            yaw_rate_rad_s=number(rng, 1, wild),
            home_t_s=t_s,
            home_down_m=number(rng, 5, wild),
            above_home_t_s=t_s - age[1],
            above_home_m=-down + number(rng, 1, wild),
            above_ground_t_s=t_s - age[1],
            above_ground_m=-down + number(rng, 3, wild),
            in_control=control,
            autopilot=Autopilot.PX4,
            mode="OFFBOARD" if control else rng.choice(("HOLD", "RTL", "LAND", "POSCTL")),
            landed=Landed.IN_AIR if rng.random() < 0.999 else rng.choice(list(Landed)),
            landed_t_s=t_s - abs(rng.gauss(0, 0.5)),
            battery=BatteryLevel.OK if rng.random() < 0.9995 else BatteryLevel.LOW,
            rc_healthy=rng.random() < 0.9995,
            armed=rng.random() < 0.9999,
        )
        near = abs(number(rng, 15, wild))
        estimate = Estimate(t_s, number(rng, 0.5, wild), number(rng, 0.5, wild), near, abs(number(rng, 2, wild)),
                            number(rng, 3, wild), number(rng, 3, wild), t_s - age[3])  # fmt: skip
        desired = Setpoint(*(number(rng, 10, wild) for _ in range(4)))
        order = Order.FOLLOW if i == 0 or rng.random() < 0.05 else None
        yield desired, estimate, state, t_s - age[4], order


def breach(before: Gate, gate: Gate, decision: Decision, state: VehicleState, begins: bool) -> str | None:
    """The limit that the round broke, or None."""
    sent = decision.setpoint
    if sent is None:
        return None
    if not sent.is_finite():
        return "a number that is not finite"
    if math.hypot(sent.forward_m_s, sent.right_m_s) > LIMITS.speed_m_s + SLACK:
        return "speed"
    if abs(sent.down_m_s) > LIMITS.climb_m_s + SLACK or abs(sent.yaw_rate_rad_s) > LIMITS.yaw_rate_rad_s + SLACK:
        return "climb or yaw rate"
    if not (state.armed and (state.in_control or gate.mode is Mode.ENGAGE)):
        return "sent without control"
    if begins:
        return None  # streaming has just begun: there is no previous setpoint
    dt = min(max(gate.t_s - before.t_s, 0.0), 0.1)
    if math.dist(before.horizontal.v, gate.horizontal.v) > LIMITS.accel_m_s2 * dt + SLACK:
        return "acceleration"
    if abs(before.down.v[0] - gate.down.v[0]) > LIMITS.climb_accel_m_s2 * dt + SLACK:
        return "climb acceleration"
    if abs(before.yaw.rate - gate.yaw.rate) > LIMITS.yaw_accel_rad_s2 * dt + SLACK:
        return "yaw acceleration"
    pairs = (before.horizontal.a, gate.horizontal.a), (before.down.a, gate.down.a)
    jerks = (math.dist(a, b) for a, b in pairs if a is not None and b is not None)
    return "jerk" if max(jerks, default=0.0) > LIMITS.jerk_m_s3 * dt + SLACK else None


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    rng, done, sent, began = random.Random(args.seed), 0, 0, time.perf_counter()
    modes: dict[str, int] = {}
    while done < args.rounds:
        gate = Gate()
        for desired, estimate, state, frame_t_s, order in flight(rng, 400):
            instruction = NO_INSTRUCTION
            if order:
                instruction = Instruction(order, Reason(Cause.FOLLOW_ORDERED, "the fuzzer"))
            before = gate
            gate, decision = decide(gate, desired, estimate, state, frame_t_s, LIMITS, instruction)
            begins = before.mode in (Mode.OBSERVE, Mode.READY, Mode.ENDED)
            begins |= decision.reason.cause is Cause.NOT_OBEYING and before.mode is not gate.mode
            if broken := breach(before, gate, decision, state, begins):
                print(f"round {done}: {broken}\n{before}\n{desired}\n{estimate}\n{state}\n{decision}", file=sys.stderr)
                return 1
            modes[decision.mode.value] = modes.get(decision.mode.value, 0) + 1
            sent += decision.setpoint is not None
            done += 1
    seconds = round(time.perf_counter() - began, 1)
    print(json.dumps({"rounds": done, "setpoints": sent, "breaches": 0, "seconds": seconds, "modes": modes}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
