"""The autopilot's own STATUSTEXTs, as lines for the operator and in the recording.

A text longer than 50 letters arrives in chunks with one id and is reported whole.  A repeated text is reported again
after REPEAT_S at the earliest.
"""

from dataclasses import dataclass, field

from pymavlink.dialects.v20 import common as dialect

from follow.link.packets import Message
from follow.messages import NEVER, Notify

REPEAT_S = 10.0  # ArduPilot repeats its PreArm reasons every 30 s, a failsafe's text every second
CHUNK_LETTERS = 50  # a shorter chunk is the last
MOST_LETTERS = 250  # PX4's longest text
AUTOPILOT = dialect.MAV_COMP_ID_AUTOPILOT1


@dataclass(slots=True)
class AutopilotTexts:
    """`hear` takes the messages of the vehicle's link."""

    report: Notify
    last_t_s: dict[str, float] = field(default_factory=dict[str, float])
    chunks: dict[int, str] = field(default_factory=dict[int, str])

    def hear(self, message: Message, t_s: float) -> None:
        """Report a text of the autopilot once it is whole."""
        if not isinstance(message, dialect.MAVLink_statustext_message) or message.get_srcComponent() != AUTOPILOT:
            return
        text = message.text
        if message.id:
            begun = self.chunks.pop(message.id, "") if message.chunk_seq else ""
            text = (begun + text)[:MOST_LETTERS]
            if len(message.text) >= CHUNK_LETTERS and len(text) < MOST_LETTERS:
                self.chunks = {message.id: text}  # one text at a time
                return
        text = " ".join("".join(letter if letter.isprintable() else " " for letter in text).split())
        if text and t_s - self.last_t_s.get(text, NEVER) >= REPEAT_S:
            self.last_t_s = {known: at for known, at in self.last_t_s.items() if t_s - at < REPEAT_S} | {text: t_s}
            self.report(f"the autopilot says: {text}")
