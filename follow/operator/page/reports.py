"""Reports of recorded flights, written by another process, because plotting would hold this interpreter's lock."""

import asyncio
import sys

from follow.operator.page.exchange import Exchange
from follow.operator.page.recordings import FlightShelf

REPORT_S = 120.0  # a half-hour flight takes some 20 s on one core of a small board


class Reports:
    """Writes one report at a time, and none while setpoints are sent."""

    def __init__(self, flights: FlightShelf, exchange: Exchange) -> None:
        self._flights, self._exchange = flights, exchange
        self._is_writing = False

    async def write(self, name: str) -> str:
        """Write the report of a listed flight; returns why it was not written, or ""."""
        flight = self._flights.flight(name)
        if flight is None:
            return "no such recording"
        if self._exchange.shown.status.get("streams"):
            return "not while it flies: a report takes the processor for some seconds"
        if self._is_writing:
            return "another report is being written"
        self._is_writing = True
        try:
            words = ("nice", "-n", "19", sys.executable, "-m", "follow.cli", "report", str(flight.folder))
            pipe, null = asyncio.subprocess.PIPE, asyncio.subprocess.DEVNULL
            process = await asyncio.create_subprocess_exec(*words, stdin=null, stdout=null, stderr=pipe)
            try:
                _, said = await asyncio.wait_for(process.communicate(), REPORT_S)
            except asyncio.TimeoutError:
                process.kill()
                await process.wait()
                return f"the report took longer than {REPORT_S:g} s"
            lines = said.decode(errors="replace").strip().splitlines()
            return (lines[-1] if lines else "the report failed") if process.returncode else ""
        except OSError as error:
            return f"the report cannot be written: {error.strerror}"
        finally:
            self._is_writing = False
