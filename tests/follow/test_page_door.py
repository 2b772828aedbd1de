"""Access to the page: token, Origin, Host; no request path leads out of the recordings."""

import ipaddress
import json
import re
import socket
import urllib.error
import urllib.request
from dataclasses import replace
from urllib.parse import urlsplit

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from follow.cli.program import main
from follow.messages import Mode
from follow.operator.page import door
from follow.operator.page.door import PageAddress, parse_page_address, read_token
from follow.operator.page.exchange import Exchange
from follow.operator.page.server import HTML, PageServer, listening
from sim.scenarios import SCENARIOS
from tests.support.page_rig import PageRig

TOKEN = "a-token-of-many-letters"


@pytest.fixture
def rig(tmp_path):
    with PageRig(tmp_path / "now") as page:
        yield page


def get(rig, path="/", **headers):
    request = urllib.request.Request(f"http://{rig.host}{path}", headers=headers)
    with urllib.request.build_opener(NoRedirect).open(request, timeout=5.0) as response:
        return response.status, dict(response.headers), response.read()


class NoRedirect(urllib.request.HTTPRedirectHandler):
    def redirect_request(self, *_args):
        return None


def refused(rig, path="/", **headers):
    with pytest.raises(urllib.error.HTTPError) as error:
        get(rig, path, **headers)
    with error.value as response:
        return response.code, response.read().decode()


def cookie_of(rig):
    with pytest.raises(urllib.error.HTTPError) as error:
        get(rig, f"/?token={TOKEN}")
    with error.value as response:
        assert response.code == 303
        assert response.headers["location"] == "/", "the token leaves the address bar"
        cookie = response.headers["set-cookie"]
    assert {"HttpOnly", "SameSite=Strict"} <= set(cookie.split("; "))
    assert TOKEN not in cookie
    return cookie.split(";")[0]


def test_another_site_cannot_open_a_window_or_write(rig):
    for origin in ("http://evil.example", f"https://{rig.host}", "null", None):
        with pytest.raises(InvalidStatus) as error, rig.window(origin=origin):
            pass
        assert error.value.response.status_code == 403
    request = urllib.request.Request(
        f"http://{rig.host}/recordings/x/report", method="POST", headers={"Origin": "http://evil.example"}
    )
    with pytest.raises(urllib.error.HTTPError, match="403") as error:
        urllib.request.urlopen(request, timeout=5.0)
    error.value.close()


def test_a_request_for_another_host_name_is_refused(rig):
    for host in ("evil.example", f"evil.example:{rig.port}", "127.0.0.1.evil.example", "", "[", "192.168.1.7"):
        code, words = refused(rig, "/", Host=host)
        assert code == 403
        assert "address" in words
    assert "<script>" not in refused(rig, "/", Host="<script>alert(1)</script>")[1], "what was sent is shown as text"
    with (
        pytest.raises(InvalidStatus),
        connect(f"ws://evil.example:{rig.port}/window", sock=socket_to(rig), origin=f"http://evil.example:{rig.port}"),
    ):
        pass
    assert get(rig, "/", Host=f"localhost:{rig.port}")[0] == 200


def socket_to(rig):
    return socket.create_connection(("127.0.0.1", rig.port))


def test_the_page_frames_nothing_loads_nothing_and_is_framed_by_nobody(rig):
    status, headers, html = get(rig)
    assert status == 200
    assert "frame-ancestors 'none'" in headers["content-security-policy"]
    assert "default-src 'none'" in headers["content-security-policy"]
    assert html == HTML.read_bytes()
    assert not re.findall(
        rb"""(?:src|href)\s*=\s*["']?(?!data:)[a-z/]|@import|https?://|url\(|innerHTML|eval\(""", html
    )


def test_a_token_lets_in_once_in_the_address_then_as_a_cookie(tmp_path):
    with PageRig(tmp_path / "now", TOKEN) as rig:
        assert refused(rig)[0] == 403
        assert "whole address with ?token=" in refused(rig)[1]
        code, words = refused(rig, "/?token=wrong")
        assert code == 403
        assert "this token is wrong" in words
        assert "width=device-width" in words, "a phone shows it in letters that can be read"
        assert refused(rig, "/recordings")[0] == 403
        with pytest.raises(InvalidStatus) as error, rig.window():
            pass
        assert error.value.response.status_code == 403
        with pytest.raises(InvalidStatus), rig.window(cookie="0" * 64):
            pass
        name, value = cookie_of(rig).split("=")
        assert get(rig, "/", Cookie=f"{name}={value}")[0] == 200
        assert refused(rig, "/", Cookie=f"{name}={value[:-1]}")[0] == 403
        with rig.window(cookie=value) as window:
            window.until(lambda w: w.images)


def test_an_address_other_than_loopback_always_needs_a_token(tmp_path):
    for host in ("0.0.0.0", "192.168.1.7", "::", "drone.local"):
        with pytest.raises(ValueError, match="needs a token"):
            PageRig(tmp_path / "now", "", host)


def test_an_address_that_is_taken_is_refused_in_words(rig, tmp_path):
    with pytest.raises(OSError, match="give another port"):
        PageServer(PageAddress("127.0.0.1", rig.port), "", Exchange(), tmp_path, rig.report)


def test_an_address_of_another_machine_is_named_as_such():
    with pytest.raises(OSError, match=r"192\.0\.2\.77 is not an address of this machine: give 0\.0\.0\.0") as refused:
        listening(PageAddress("192.0.2.77", 8080))
    assert "another port" not in str(refused.value)


def test_a_phone_gets_addresses_of_this_machine_and_no_name(monkeypatch):
    known = {"lo": ("127.0.0.1",), "docker0": ("172.17.0.1",), "eth0": ("10.0.0.7",), "wlan0": ("192.168.4.1",)}
    monkeypatch.setattr(door.socket, "if_nameindex", lambda: list(enumerate(known, 1)))
    monkeypatch.setattr(door, "ipv4_of", known.__getitem__)
    kinds = {"eth0/device", "wlan0/device", "wlan0/wireless"}
    monkeypatch.setattr(door.Path, "exists", lambda path: "/".join(path.parts[-2:]) in kinds)
    urls = parse_page_address("0.0.0.0:8080").urls("x")
    assert urls == tuple(f"http://{host}:8080/?token=x" for host in ("192.168.4.1", "10.0.0.7", "172.17.0.1"))


def test_every_address_that_is_printed_is_one_at_which_the_page_can_be_opened(tmp_path):
    with PageRig(tmp_path / "now", TOKEN, "0.0.0.0") as rig:
        for url in rig.server.address.urls(TOKEN):
            assert ipaddress.ip_address(urlsplit(url).hostname), "no name: a phone at the field cannot look it up"
            request = urllib.request.Request(url)
            opener = urllib.request.build_opener(urllib.request.ProxyHandler({}), urllib.request.HTTPCookieProcessor())
            assert opener.open(request, timeout=5.0).read() == HTML.read_bytes()


def test_an_address_is_parsed():
    assert parse_page_address("127.0.0.1:8080") == PageAddress("127.0.0.1", 8080)
    assert parse_page_address("[::1]:8080").urls("x") == ("http://[::1]:8080/?token=x",)
    for text in ("8080", "127.0.0.1", ":8080", "127.0.0.1:0", "127.0.0.1:65536", "127.0.0.1:٨", ""):
        with pytest.raises(ValueError, match="HOST:PORT"):
            parse_page_address(text)


def test_a_token_is_long_plain_and_its_owners_only(tmp_path):
    path = tmp_path / "token"
    path.write_text(TOKEN + "\n")
    path.chmod(0o600)
    assert read_token(path) == TOKEN
    for bad in ("short", "spaces are not allowed here", ""):
        path.write_text(bad)
        with pytest.raises(ValueError, match="at least 16"):
            read_token(path)
    path.chmod(0o644)
    with pytest.raises(ValueError, match="chmod 600"):
        read_token(path)
    with pytest.raises(FileNotFoundError, match=r"there is no page's token .*token_urlsafe\(18\).*chmod 600"):
        read_token(tmp_path / "none")


# Recordings


@pytest.fixture
def flights(tmp_path):
    out = tmp_path / "flights" / "now"
    for folder in (out, out / "earlier-1", tmp_path / "flights" / "before", tmp_path / "flights" / "empty", tmp_path):
        folder.mkdir(parents=True, exist_ok=True)
        if folder.name != "empty":
            (folder / "ticks.csv").write_text(f"rows of {folder.name}")
    (out.parent / "before" / "secret.txt").write_text("secret")
    (out.parent / "before" / "flight.rrd").symlink_to(tmp_path / "ticks.csv")
    (out.parent / "linked").symlink_to(tmp_path)
    for odd in ("\udcff", "two\nlines"):  # a byte that is no UTF-8, a line feed
        (out.parent / odd).mkdir()
        (out.parent / odd / "ticks.csv").write_text("rows of an odd name")
    with PageRig(out) as page:
        yield page


def test_recordings_are_listed_without_the_one_that_is_written_now(flights):
    listed = json.loads(get(flights, "/recordings")[2])
    assert {flight["name"] for flight in listed} == {"before", "now/earlier-1"}
    assert {name for flight in listed for name in flight["files"]} == {"ticks.csv"}
    _, headers, body = get(flights, "/recordings/now/earlier-1/ticks.csv")
    assert body == b"rows of earlier-1"
    assert "attachment" in headers["content-disposition"]


OUTSIDE = (
    *("before/secret.txt", "before/flight.rrd", "linked/ticks.csv", "now/ticks.csv", "../ticks.csv", "..%2fticks.csv"),
    *("before/..%2f..%2fticks.csv", "%2e%2e/ticks.csv", "before/%2e%2e/%2e%2e/ticks.csv", "./ticks.csv", "/ticks.csv"),
    *(
        "before%00/ticks.csv",
        "empty/ticks.csv",
        "before/ticks.csv/",
        "%2fetc/passwd",
        "now/earlier-1/..%2f../ticks.csv",
    ),
)


@pytest.mark.parametrize("path", OUTSIDE)
def test_no_request_path_leads_out_of_the_listing(flights, path):
    assert refused(flights, f"/recordings/{path}")[0] == 404


def test_no_report_is_written_while_it_flies(flights):
    flights.mode = Mode.FOLLOW
    flights.round()
    request = urllib.request.Request(
        f"http://{flights.host}/recordings/before/report", method="POST", headers={"Origin": f"http://{flights.host}"}
    )
    with pytest.raises(urllib.error.HTTPError) as error:
        urllib.request.urlopen(request, timeout=5.0)
    with error.value as response:
        assert response.code == 409
        assert b"not while it flies" in response.read()


def test_a_report_is_written_by_another_process_and_read_without_scripts(tmp_path, monkeypatch, capfd):
    monkeypatch.setitem(SCENARIOS, "walker", replace(SCENARIOS["walker"], duration_s=1.0))
    assert main(["sim", "walker", "--out", str(tmp_path / "before"), "--record.no-pictures"]) == 0
    with PageRig(tmp_path / "now") as rig:
        rig.round()
        origin = {"Origin": f"http://{rig.host}"}
        request = urllib.request.Request(f"http://{rig.host}/recordings/before/report", method="POST", headers=origin)
        with urllib.request.urlopen(request, timeout=120.0) as response:
            assert response.status == 200
        _, headers, page = get(rig, "/recordings/before/report.html")
    assert b"Flight before" in page
    assert headers["content-security-policy"].startswith("default-src 'none'; style-src")
    assert "attachment" not in headers.get("content-disposition", "")
    assert (tmp_path / "before" / "report.html").read_bytes() == page
