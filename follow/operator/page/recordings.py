"""The recorded flights that the page offers.  A request chooses from a listing and never becomes a path itself."""

from dataclasses import dataclass
from pathlib import Path

from follow.recording.folder import FILES

MOST = 50  # newest flights that are listed


@dataclass(frozen=True, slots=True)
class ShelvedFlight:
    """One flight's folder: its name in the listing, and its files with their sizes in bytes."""

    name: str
    folder: Path
    files: dict[str, int]
    began_unix_s: float

    @property
    def as_json(self) -> dict[str, object]:
        """What the page lists."""
        return {"name": self.name, "files": self.files, "unix_s": round(self.began_unix_s)}


class FlightShelf:
    """The flights next to the present one's folder `out`, and those set aside inside it; not the present one."""

    def __init__(self, out: Path) -> None:
        self._out = out.resolve()

    def listed(self) -> list[ShelvedFlight]:
        """The newest flights first."""
        found: list[ShelvedFlight] = []
        for folder in (self._out.parent, self._out):
            try:
                children = sorted(folder.iterdir())
            except OSError:
                continue
            found += [flight for child in children if (flight := self._flight(child)) is not None]
        found.sort(key=lambda flight: -flight.began_unix_s)
        return found[:MOST]

    def _flight(self, folder: Path) -> ShelvedFlight | None:
        """The flight in a folder; None if it holds no flight, is the present one or is a symbolic link."""
        try:
            if folder.is_symlink() or not folder.is_dir() or folder == self._out:
                return None
            files = {
                name: path.stat().st_size
                for name in FILES
                if (path := folder / name).is_file() and not path.is_symlink()
            }
            if "ticks.csv" not in files:
                return None
            name = folder.relative_to(self._out.parent).as_posix()
            if not name.isprintable():  # invalid UTF-8 or a line feed cannot stand in JSON or in an address
                return None
            return ShelvedFlight(name, folder, files, (folder / "ticks.csv").stat().st_mtime)
        except OSError:
            return None

    def flight(self, name: str) -> ShelvedFlight | None:
        """The flight of that name in the listing."""
        return next((flight for flight in self.listed() if flight.name == name), None)

    def file(self, name: str, file: str) -> Path | None:
        """A file of a listed flight."""
        flight = self.flight(name)
        return flight.folder / file if flight is not None and file in flight.files else None
