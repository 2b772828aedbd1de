"""The page: one window commands, the others watch, STOP works from all, no act in a window can harm a flight."""

import json
import os
import socket
from contextlib import ExitStack, suppress

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as dialect
from websockets.exceptions import ConnectionClosed

from follow.link.telemetry import LinkObservations
from follow.messages import Mode, Order
from follow.operator.consoles import DRAWN_S, ConsoleCommand
from follow.operator.page import server, windows
from follow.operator.page.desk import ACTS, FRAMES
from follow.operator.page.exchange import WAITING_ACTS, WAITING_STOPS, Act, Doing, Exchange, read_act
from follow.operator.page.server import CONNECTIONS
from follow.operator.page.windows import BURST, WINDOWS, jpeg_of
from follow.selection import Detection, Detections, KeptStandoff
from racf.box import Box
from tests.support.page_rig import ROUND_S, PageRig


@pytest.fixture
def rig(tmp_path):
    with PageRig(tmp_path / "now") as page:
        yield page


def test_a_window_shows_the_state_and_the_image_of_a_numbered_frame(rig):
    with rig.window() as window:
        window.until(lambda w: len(w.images) >= 3)
        header, jpeg = window.images[-1]
        image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
        assert image.shape == (360, 640, 3)
        assert abs(int(image[100, 100, 0]) - header["frame"] % 256) <= 2, "the number is that of the image beside it"
        assert window.status["state"] == "SELECT A TARGET"
        rig.mode = Mode.SEARCH
        window.until(lambda w: w.status["state"] == "SEARCHING")
        assert window.status["tone"] == "bad"


def test_a_selection_names_the_frame_that_it_was_drawn_on(rig):
    with rig.window() as window:
        window.until(lambda w: len(w.images) >= 4)
        frame = window.images[1][0]["frame"]
        window.send(do="select", frame=frame, box=[0.4, 0.3, 0.1, 0.2])
        assert window.replied() == [True, "target selected"]
        (chosen,) = rig.chosen
        assert (chosen.left, chosen.top, chosen.width, chosen.height) == pytest.approx((0.4, 0.3, 0.1, 0.2))
        assert (chosen.frame_t_s, chosen.by) == (100.0 + 0.05 * frame, "page 1")
        window.until(lambda w: w.status["state"] == "TRACKING")
        assert window.status["would_fly"]


def test_what_a_detector_found_is_shown_in_shares_of_the_image_with_its_age_until_it_is_too_old(rig):
    with rig.window() as window:
        window.until(lambda w: w.images and rig.n > 8)
        assert window.images[-1][0]["found"] is None
        rig.found = Detections(100.0 + ROUND_S * (rig.n - 6), rig.n - 6, (Detection(Box(64, 90, 32, 36), 0.8),))
        window.until(lambda w: w.images[-1][0]["found"] is not None)
        header = window.images[-1][0]
        found = header["found"]
        assert found["boxes"] == [[0.1, 0.25, 0.05, 0.1]]
        assert found["frame"] == rig.found.index
        assert found["age_s"] == pytest.approx(ROUND_S * (header["frame"] - found["frame"]), abs=0.01)
        window.send(do="select", frame=found["frame"], box=found["boxes"][0])
        assert window.replied() == [True, "target selected"]
        assert rig.chosen[-1].frame_t_s == pytest.approx(rig.found.t_s), "it is drawn on the frame that was looked at"
        rig.found = None
        window.until(lambda w: w.images[-1][0]["found"] is None)


def test_a_selection_of_a_frame_that_was_never_shown_or_long_ago_is_refused(rig):
    for _ in range(FRAMES + 5):
        rig.round()
    with rig.window() as window:
        for frame in (1, 10**6):
            window.send(do="select", frame=frame, box=[0.4, 0.3, 0.1, 0.2])
            done, words = window.replied()
            assert not done
            assert "too old" in words
    assert rig.chosen == []


def test_follow_flies_an_old_target_after_confirm_only(rig):
    with rig.window() as window:
        window.until(lambda w: w.images)
        window.send(do="select", frame=window.images[-1][0]["frame"], box=[0.4, 0.3, 0.1, 0.2])
        assert window.replied()[0]
        for _ in range(round(DRAWN_S / 0.05) + 2):
            rig.round()
        window.order("follow")
        done, words = window.replied()
        assert not done
        assert "CONFIRM" in words
        assert rig.ordered() == []
        window.until(lambda w: "20 m away" in w.status["proposal"])
        window.order("confirm")
        assert window.replied()[0]
        assert rig.ordered() == [Order.FOLLOW]


def test_a_second_window_watches_and_its_stop_works(rig):
    rig.has_target, rig.mode = True, Mode.FOLLOW
    with rig.window() as first, rig.window("fedcba9876543210") as second:
        first.order("nearer")
        assert first.replied()[0]
        second.order("nearer")
        done, words = second.replied()
        assert not done
        assert words == "nearer: page 1 commands: hand over there first"
        second.until(lambda w: w.status["commander"] == "page 1")
        second.order("stop")
        assert second.replied()[0]
        assert rig.ordered() == [Order.OBSERVE]
        first.send(do="hand-over")
        assert first.replied()[0]
        second.order("nearer")
        assert second.replied()[0]


def test_a_window_that_reconnects_keeps_the_command_and_one_that_is_gone_loses_it(rig):
    rig.has_target, rig.mode = True, Mode.FOLLOW
    with rig.window() as first:
        first.order("nearer")
        assert first.replied()[0]
    with rig.window() as again, rig.window("fedcba9876543210") as second:
        again.until(lambda w: w.status.get("commander") == w.name == "page 1")
        second.order("farther")
        assert not second.replied()[0]
    with rig.window("fedcba9876543210") as second:
        second.until(lambda w: w.status.get("commander") == "")
        second.order("farther")
        assert second.replied()[0]


def test_a_window_that_reconnects_gets_no_old_reply_again(rig):
    with rig.window() as first:
        first.order("stop")
        assert first.replied() == [True, "stop: stopped"]
    with rig.window() as again:
        again.order("confirm")
        assert again.replied() == [False, "confirm: select a target first"], "the newest, and nothing older"


def test_idle_connections_do_not_block_others(rig):
    """Whoever reaches the address can open them, without a token; each costs a file of the process that flies."""
    before = len(os.listdir("/proc/self/fd"))
    with rig.window() as window, ExitStack() as stack:
        window.until(lambda w: w.images)
        for _ in range(3 * CONNECTIONS):
            stack.enter_context(socket.create_connection(("127.0.0.1", rig.port)))
        window.until(lambda w: len(w.images) >= 5)
        ours = 3 * CONNECTIONS  # this process has both ends
        assert len(os.listdir("/proc/self/fd")) - before - ours < CONNECTIONS
        window.order("stop")
        assert window.replied()[0]
        elsewhere = ("127.0.0.2", 0)  # another address, as another phone has
        phone = stack.enter_context(socket.create_connection(("127.0.0.1", rig.port), 5.0, elsewhere))
        phone.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert phone.recv(15) == b"HTTP/1.1 200 OK"


@pytest.mark.parametrize("begun", [b"", b"GET / HTTP/1.1\r\nHost: "])
def test_a_connection_that_makes_no_request_is_closed(rig, monkeypatch, begun):
    monkeypatch.setattr(server, "REQUEST_S", 0.2)
    with rig.window() as window, socket.create_connection(("127.0.0.1", rig.port), 10.0) as silent:
        silent.sendall(begun)
        with suppress(ConnectionResetError):
            assert silent.recv(1) == b""
        window.until(lambda w: len(w.images) >= 3)


def test_clearing_the_target_stops(rig):
    rig.has_target, rig.mode = True, Mode.FOLLOW
    with rig.window() as window:
        window.send(do="clear")
        assert window.replied()[0]
    assert rig.ordered() == [Order.OBSERVE]
    assert not rig.has_target


def test_a_flood_of_clicks_is_bounded_and_a_stop_after_it_comes_through(rig):
    with rig.window() as window:
        window.until(lambda w: w.images)
        message = json.dumps({"do": "select", "frame": window.images[-1][0]["frame"], "box": [0.4, 0.3, 0.1, 0.2]})
        for _ in range(400):
            window.socket.send(message)
        window.order("stop")
        window.until(lambda w: any("stop" in words for _done, words in w.replies))
    assert len(rig.chosen) <= 10
    assert sum(not done for done, _words in window.replies) <= BURST


def test_a_round_takes_few_acts_but_every_stop():
    exchange = Exchange()
    for _ in range(1000):
        exchange.act(Act("page 2", Doing.CLEAR))
    for n in range(1000):
        exchange.act(Act("page 1", Doing.SELECT, n))
    taken = exchange.taken(ACTS)
    assert [act.is_stop for act in taken[:WAITING_STOPS]] == [True] * WAITING_STOPS
    assert len(taken) <= WAITING_STOPS + ACTS
    taken = exchange.taken(ACTS)
    assert [act.frame for act in taken] == list(range(1000 - WAITING_ACTS, 1000 - WAITING_ACTS + ACTS))


def closing_code(window) -> int:
    """With what a window was closed; 0 if it stays open."""
    for _ in range(100):
        try:
            window.rig.round()
            window.take(0.02)
        except ConnectionClosed as closed:
            return closed.rcvd.code
    return 0


def test_of_two_windows_with_one_id_the_later_one_keeps_it(rig):
    with rig.window() as first, rig.window() as second:
        second.until(lambda w: w.images)
        assert second.name == "page 1"
        assert closing_code(first) == 4001


def test_acts_before_a_stop_have_no_effect_after_it(rig):
    rig.has_target = True
    rig.round()
    rig.consoles.drawn_t_s = rig.consoles.t_s
    for order in (ConsoleCommand.FOLLOW,) * (3 * ACTS):
        rig.exchange.act(Act("page 1", Doing.ORDER, order=order))
    rig.exchange.act(Act("page 2", Doing.ORDER, order=ConsoleCommand.STOP))
    for _ in range(5):
        rig.round()
    assert rig.ordered() == [Order.OBSERVE]
    rig.exchange.act(Act("page 1", Doing.ORDER, order=ConsoleCommand.FOLLOW))
    rig.round()
    assert rig.ordered() == [Order.FOLLOW], "an order after it is a new one"


def test_a_tap_that_finds_nothing_gets_that_reply(rig):
    with rig.window() as window:
        window.until(lambda w: w.images)
        rig.consoles.is_looking = lambda: True
        window.send(do="select", frame=window.images[-1][0]["frame"], box=[0.4, 0.3, 0.0, 0.0])
        window.until(lambda _w: rig.chosen)
        rig.consoles.decided("nothing stands out there")
        assert window.replied() == [False, "not selected: nothing stands out there"]


def test_ten_watchers_see_and_a_slow_one_costs_nobody_but_itself_its_images(rig):
    with ExitStack() as stack:
        windows = [stack.enter_context(rig.window(f"{n:016x}")) for n in range(10)]
        windows[0].acks = False
        others = windows[1:]
        windows[0].until(lambda w: all(len(other.images) >= 8 for other in others), others)
        assert len(windows[0].images) <= 1 + len(others[0].images) // 4, "without an answer no next image"
        for window in others:
            frames = [header["frame"] for header, _jpeg in window.images]
            assert frames == sorted(set(frames))
            assert rig.n - frames[-1] <= 40, "the newest, not the next"
        assert windows[0].status["state"] == "SELECT A TARGET", "its status comes all the same"


def test_a_window_that_reads_nothing_delays_no_other(rig):
    with rig.window("00000000000000aa"), rig.window() as window:
        window.until(lambda w: len(w.images) >= 20)


def test_more_windows_than_can_be_served_are_refused(rig):
    with ExitStack() as stack:
        for n in range(WINDOWS):
            stack.enter_context(rig.window(f"{n:016x}")).until(lambda w: w.status)
        with pytest.raises(ConnectionClosed, match="too many windows"):
            read_until_closed(rig)


def read_until_closed(rig, *messages):
    with rig.window("ffffffffffffffff") as window:
        for message in messages:
            window.socket.send(message)
        while window.take(5.0):
            pass


def test_a_server_that_ends_does_not_change_the_flight(rig):
    rig.has_target, rig.mode = True, Mode.FOLLOW
    with rig.window() as window:
        window.order("farther")
        assert window.replied()[0]
        wanted = rig.consoles.wanted
        rig.server.close()
        assert not rig.server.is_alive
        for _ in range(50):
            rig.round()
    assert rig.consoles.wanted == wanted
    assert rig.ordered() == []
    assert rig.consoles.mode is Mode.FOLLOW


def test_an_error_inside_the_page_is_told_once_and_harms_nothing_else(rig, monkeypatch):
    def broken(text, _by):
        raise KeyError(text)

    monkeypatch.setattr(windows, "read_act", broken)
    for _ in range(2):
        with pytest.raises(ConnectionClosed):
            read_until_closed(rig, "x")
    monkeypatch.undo()
    with rig.window() as window:
        window.until(lambda w: w.images)
    (line,) = (line for line in rig.lines if "could not serve" in line)
    assert "KeyError" in line


def test_the_stand_off_that_is_kept_is_shown_where_it_differs_from_the_chosen_one(rig):
    with rig.window() as window:
        window.until(lambda w: w.status.get("standoff_m") == 12.0 and w.status.get("kept") == "")
        rig.consoles.kept = lambda: KeptStandoff(17.6, "the target is far below")
        window.until(lambda w: w.status["kept"] == "keeps 18 m: the target is far below")
        rig.consoles.kept = lambda: KeptStandoff(12.3)
        window.until(lambda w: w.status["kept"] == "")


def test_the_charge_is_that_of_the_autopilot_if_it_knows():
    heard = LinkObservations()
    for left, shown in ((-1, None), (101, None), (78, 78), (0, 0)):
        heard.status = dialect.MAVLink_sys_status_message(*[0] * 6, left, *[0] * 6)
        assert heard.charge_percent() == shown
    assert LinkObservations().charge_percent() is None


def test_the_state_shows_a_dry_run(tmp_path):
    with PageRig(tmp_path / "now", suffix="(DRY RUN)") as rig, rig.window() as window:
        rig.has_target, rig.mode = True, Mode.FOLLOW
        window.until(lambda w: w.status.get("state") == "FOLLOWING (DRY RUN)")


def test_before_the_flight_a_window_shows_messages_and_can_order_nothing(tmp_path):
    with PageRig(tmp_path / "now") as rig:
        rig.exchange.is_flying = False
        rig.report("waiting for a vehicle")
        with rig.window() as window:
            while not window.lines:
                assert window.take(5.0)
            assert window.lines == ["waiting for a vehicle"]
            window.order("follow")
            while not window.replies:
                assert window.take(5.0)
            assert window.replies == [[False, "not flying: nothing can be ordered yet"]]
    assert rig.ordered() == []


NUMBERS = ("null", "-1", "true", "1e3", "4294967296")
NO_TAPS = ("[0.5,0.5,-0.1,-0.1]", "[-1,-1,0.5,0.5]", "[1.5,1.5,0.1,0.1]")
BOXES = ("[]", "[NaN,0,0,0]", '["0",0,0,0]', "[1e9,0,0,0]", *NO_TAPS)
NO_ACTS = (
    *("", "{", "[]", "7", '{"do": "fly"}', '{"do": "order"}', '{"do": "order", "order": "rtl"}', "[" * 1500),
    *(f'{{"do": "select", "frame": {n}, "box": [0, 0, 0, 0]}}' for n in NUMBERS),
    *(f'{{"do": "select", "frame": 1, "box": {box}}}' for box in BOXES),
)


@pytest.mark.parametrize("text", NO_ACTS)
def test_a_message_that_is_no_act_gets_a_reply_and_has_no_effect(rig, text):
    with pytest.raises(ValueError, match=r"message|one of|number of a frame|box is|of a box|the box"):
        read_act(text, "page 1")
    with rig.window() as window:
        window.socket.send(text)
        assert not window.replied()[0]
    assert rig.chosen == []
    assert not any("could not serve" in line for line in rig.lines)


@given(*[st.floats(-1.0, 2.0)] * 2, *[st.floats(0.0, 2.0)] * 2)
def test_a_box_is_clipped_to_the_image_and_never_becomes_a_tap(left, top, width, height):
    try:
        act = read_act(json.dumps({"do": "select", "frame": 1, "box": [left, top, width, height]}), "page 1")
    except ValueError:
        sides = min(left + width, 1.0) - max(left, 0.0), min(top + height, 1.0) - max(top, 0.0)
        assert max(sides) <= 0.0
        return
    x, y, w, h = act.box
    assert (w == h == 0.0) == (width == height == 0.0)
    assert 0.0 <= x <= x + w <= 1.0 + 1e-9
    assert 0.0 <= y <= y + h <= 1.0 + 1e-9


def test_an_image_is_no_wider_than_a_phone_shows():
    wide = cv2.imdecode(np.frombuffer(jpeg_of(np.zeros((1080, 1920, 3), np.uint8)), np.uint8), cv2.IMREAD_COLOR)
    assert wide.shape == (540, 960, 3)
    assert cv2.imdecode(np.frombuffer(jpeg_of(np.zeros((48, 64), np.uint8)), np.uint8), 0).shape == (48, 64)
