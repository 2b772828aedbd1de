"""A live viewer costs the flight nothing; a slow one only loses its own frames."""

import threading
from urllib.parse import parse_qs, urlsplit

import pytest

from follow.cli.layers import with_view
from follow.cli.program import main
from follow.recording import view
from follow.recording.recorder import RecordConfig, Recorder
from follow.recording.viewer import check_view
from tests.follow.test_record_flight import silent, tick


@pytest.mark.parametrize(
    ("words", "full"),
    [
        (("sim", "--view"), ["sim", "--view", "here"]),
        (("sim", "--view", "walker"), ["sim", "--view", "here", "walker"]),
        (("sim", "--view", "web", "walker"), ["sim", "--view", "web", "walker"]),
        (("run", "--view", "--link", "x"), ["run", "--view", "here", "--link", "x"]),
        (("run", "--view", "rerun+http://1.2.3.4:9876/proxy"), ["run", "--view", "rerun+http://1.2.3.4:9876/proxy"]),
        ((), []),
    ],
)
def test_a_view_without_an_address_is_local(words, full):
    assert with_view(words) == full


@pytest.mark.parametrize(
    "name", ["http://ground:9876/proxy", "rerun+http://ground/proxy", "rerun+http://g:99999/proxy"]
)
def test_a_view_that_is_not_one_is_refused_before_anything_starts(capfd, tmp_path, name):
    assert main(["sim", "walker", "--view", name, "--out", str(tmp_path / "out")]) == 2
    err = capfd.readouterr().err
    assert "--view must be here, web or rerun+http://HOST:PORT/proxy" in err
    assert not (tmp_path / "out").exists()


def test_a_local_view_needs_a_display(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    with pytest.raises(OSError, match="needs a display here: give --view web, or --view rerun"):
        check_view("here")
    check_view("web")
    check_view("rerun+http://ground:9876/proxy")


def test_the_page_of_a_view_takes_its_stream_from_the_same_computer_wherever_the_browser_is():
    page = urlsplit(view.page_address("rerun+http://127.0.0.1:9876/proxy", "10.0.0.7"))
    (stream,) = parse_qs(page.query)["url"]
    assert (page.hostname, urlsplit(stream).hostname, urlsplit(stream).port) == ("10.0.0.7", "10.0.0.7", 9876)
    assert stream.startswith("rerun+http://")


class StuckViewer:
    """A viewer that takes nothing until `goes_on` is set."""

    def __init__(self) -> None:
        self.goes_on = threading.Event()
        self.images_seen = 0

    def tick(self, _scene) -> None:
        assert self.goes_on.wait(60)

    def images(self, _scene) -> None:
        self.images_seen += 1

    def settings(self, _toml) -> None: ...

    def message(self, _t_s, _text) -> None: ...

    def close(self) -> None: ...


def test_a_stuck_viewer_costs_its_own_frames_and_nothing_of_the_flight(tmp_path, monkeypatch):
    viewer = StuckViewer()
    monkeypatch.setattr(view, "to_viewer", lambda *_more: viewer)
    recorder = Recorder(tmp_path, RecordConfig(), silent, waits=True, view="web")
    for n in range(60):
        recorder.tick(tick(n))  # with a loop that waits for the recording, but never for the viewer
    viewer.goes_on.set()
    summary = recorder.close()
    assert "recording_dropped" not in summary
    assert viewer.images_seen < 10
    assert len((tmp_path / "ticks.csv").read_text().splitlines()) == 61


def test_a_viewer_that_is_gone_is_one_line(tmp_path, monkeypatch):
    def gone(*_more):
        raise OSError("the view is no longer written: gone; the flight goes on")

    monkeypatch.setattr(view, "to_viewer", gone)
    lines: list[str] = []
    with Recorder(tmp_path, RecordConfig(pictures=False), lines.append, waits=True, view="web") as recorder:
        for n in range(30):
            recorder.tick(tick(n))
    assert lines == ["the view is no longer written: gone; the flight goes on"]
    assert recorder.failure == ""
