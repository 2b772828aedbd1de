"""flight.tlog is read by pymavlink's own log reader, message for message."""

import logging

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import common as dialect

from follow.link.tlog import Tlog


def test_a_log_reads_back_with_its_times(tmp_path):
    mav = dialect.MAVLink(None, 1, 1)
    log = Tlog(tmp_path / "flight.tlog")
    for n in range(50):
        log.write(mav.attitude_encode(n, 0.01 * n, 0, 0, 0, 0, 0).pack(mav), 1.7e9 + 0.02 * n)
    log.close()
    reader = mavutil.mavlink_connection(str(log.path))
    read = []
    while (message := reader.recv_match(type="ATTITUDE")) is not None:
        read.append((message.time_boot_ms, message._timestamp))
    reader.close()
    assert [n for n, _ in read] == list(range(50))
    assert [t for _, t in read] == pytest.approx([1.7e9 + 0.02 * n for n in range(50)], abs=1e-5)
    assert log.lost == 0


def test_a_full_disk_ends_the_log_says_so_once_and_counts_what_is_missing(tmp_path, caplog):
    (tmp_path / "flight.tlog").symlink_to("/dev/full")
    log = Tlog(tmp_path / "flight.tlog")
    with caplog.at_level(logging.WARNING):
        for _ in range(5):
            log.write(b"packet", 0.0)
        log.close()
    assert [record.getMessage().count(" is full: ") for record in caplog.records] == [1]
    assert log.lost == 5
