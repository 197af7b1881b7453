"""Logs: what a file becomes, in any order of columns and rows; and each kind of bad input with its message."""

from __future__ import annotations

import math
import runpy
from pathlib import Path

import pytest
import torch

from uwirl.snr.log import COMPLETE, LogError, read_log

EXAMPLES = Path(__file__).parents[2] / "examples"
HEADER = "vehicle_x_m,vehicle_y_m,vehicle_z_m,sensor_x_m,sensor_y_m,sensor_z_m,snr_dB"
ROWS = ["0,0,-1,10,0,-5,20", "0,0,-1,30,0,-5,10.5", "5,5,-1,10,0,-5,", "5,5,-1,30,0,-5,8"]


@pytest.fixture
def log(tmp_path):
    def write(*rows: str, header: str = HEADER, encoding: str = "utf-8"):
        path = tmp_path / "log.csv"
        path.write_text("\n".join([header, *rows]) + "\n", encoding=encoding)
        return read_log(path)

    return write


def complain(log, *rows: str, **how) -> str:
    with pytest.raises(LogError) as error:
        log(*rows, **how)
    return str(error.value).split("log.csv")[1].removeprefix(", ")


def test_readings_by_hand(log):
    found = log(*ROWS)
    readings = found.readings
    assert readings.transmitters.tolist() == [[0.0, 0.0, -1.0], [5.0, 5.0, -1.0]]
    assert readings.receivers.tolist() == [[10.0, 0.0, -5.0], [30.0, 0.0, -5.0]]
    assert readings.snr[0, 0].tolist() == [20.0, 10.5]
    assert math.isnan(readings.snr[0, 1, 0])
    assert readings.snr[0, 1, 1] == 8.0
    assert (found.heard, found.names) == (3, ("(10, 0, -5)", "(30, 0, -5)"))


def test_order_of_columns_blanks_and_byte_order_mark_do_not_matter(log):
    header = ",".join([*HEADER.split(",")[::-1], "salinity"])
    rows = [", ".join([*row.split(",")[::-1], "35"]) for row in ROWS]
    found, plain = log("", *rows, " ,,", header=header, encoding="utf-8-sig"), log(*ROWS)
    assert torch.equal(found.readings.snr.nan_to_num(-1.0), plain.readings.snr.nan_to_num(-1.0))
    assert found.unused == ("salinity",)
    assert found.line.tolist() == [3, 4, 5, 6]


def test_repeated_rows_without_time_are_further_messages(log):
    readings = log(*ROWS, ROWS[0].replace("20", "21")).readings
    assert readings.snr[0, :, 0].nan_to_num(-1.0).tolist() == [20.0, -1.0, 21.0]
    assert torch.equal(readings.transmitters[0], readings.transmitters[2])


def test_messages_are_in_the_order_of_time(log):
    found = log(*(f"{row},{time}" for row, time in zip(ROWS, (7, 7, 3, 3), strict=True)), header=f"{HEADER},time_s")
    assert found.readings.transmitters[:, 0].tolist() == [5.0, 0.0]
    assert found.readings.snr[0, 1].tolist() == [20.0, 10.5]
    one_place = [f"0,0,0,{x},0,-5,{x},{time}" for time in (1, 2, 3) for x in (10, 20)]
    assert log(*one_place, header=f"{HEADER},time_s").readings.snr.tolist() == [[[10.0, 20.0]] * 3]


def test_silent_messages_and_sensors_count_for_nothing(log):
    thinned = log(*ROWS[:2], ROWS[2], "0,0,-1,50,0,-5,").thinned(10)
    assert thinned.readings.snr.tolist() == [[[20.0, 10.5]]]


def test_scattered_readings_are_thinned_evenly(log):
    found = log(*(f"{k},0,-1,{k},{10 + k % 7},-5,{k % 50}" for k in range(200)))
    thinned = found.thinned(21)
    assert thinned.heard == 21
    assert thinned.line.diff().min() >= 9
    assert thinned.line[[0, -1]].tolist() == [2, 201]
    assert torch.equal(found.thinned(200).line, found.line)


def test_complete_logs_stay_whole(log):
    found = log(*(f"{s},0,-1,{j},20,-5,{s - j}" for s in range(8) for j in range(6)))
    assert found.thinned(10).heard == 48 <= COMPLETE
    assert found.thinned(7).heard == 7


def test_table_puts_values_where_they_belong(log):
    found = log(*ROWS)
    assert found.table(found.line, 0).tolist() == [[2, 3], [4, 5]]


def test_sample_log_is_made_byte_for_byte():
    made = runpy.run_path(str(EXAMPLES / "make_readings.py"))["text"]()
    assert made.encode() == (EXAMPLES / "readings.csv").read_bytes()


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("0,0,-1,10,0,-5,loud", "line 6, column snr_dB: 'loud' is no number; write one such as -12.5"),
        ("0,0,-1,1_0,0,-5,3", "line 6, column sensor_x_m: '1_0' is no number; write one such as -12.5"),
        ("0,0,-1,10,0,-5,nan", "line 6, column snr_dB: 'nan' is not finite; leave it blank where nothing was heard"),
        ("0,inf,-1,10,0,-5,3", "line 6, column vehicle_y_m: 'inf' is not finite; correct it"),
        ("0,0,-1,1e7,0,-5,3", "line 6, column sensor_x_m: 1e7 m is beyond 1,000,000 m; check units and columns"),
        ("0,0,-1,10,0,-5,-501", "line 6, column snr_dB: -501 dB is beyond 500 dB; check units and columns"),
        ("0,0,,10,0,-5,3", "line 6, column vehicle_z_m: is blank; only snr_dB may be, where nothing was heard"),
        (
            "0,0,-1,0,0,-1,3",
            "line 6: the sensor lies on the vehicle, where the SNR is infinite; correct a position",
        ),
        ("0,0,-1,10,0,-5", "line 6: has 6 cells, the header 7"),
    ],
)
def test_bad_row(log, row: str, message: str):
    assert complain(log, *ROWS, row) == message


def test_missing_columns_name_what_is_there(log):
    message = complain(log, header=HEADER.replace("snr_dB", "snr"))
    assert message.startswith("line 1: the header lacks snr_dB; it must name vehicle_x_m, vehicle_y_m")
    assert message.endswith("sensor_z_m, snr")


def test_column_twice(log):
    assert complain(log, header=f"{HEADER},snr_dB") == "line 1, column snr_dB: stands twice in the header"


def test_nothing_in_it(log):
    assert complain(log) == ": holds no rows below its header"
    assert complain(log, ROWS[2]) == ": holds no reading: every snr_dB is blank"
    assert complain(log, header="").startswith("line 1: the header lacks vehicle_x_m")


def test_duplicate_names_both_lines(log):
    rows = [f"{row},3" for row in ROWS]
    message = complain(log, *rows, rows[1], header=f"{HEADER},time_s")
    assert message == "line 6: the same message at the same sensor as line 3; keep one of them, or correct time_s"


def test_blank_time(log):
    message = complain(log, f"{ROWS[0]},", header=f"{HEADER},time_s")
    assert message.startswith("line 2, column time_s: is blank")
    assert message.endswith("leave the column out if times are not known")


def test_sensor_at_two_positions(log):
    message = complain(log, f"{ROWS[0]},a", f"{ROWS[1]},a", header=f"{HEADER},sensor")
    assert message == (
        "line 3, column sensor: 'a' is at (30.0, 0.0, -5.0), but on line 2 at (10.0, 0.0, -5.0); "
        "give a sensor that was moved another name"
    )


def test_no_text(tmp_path):
    path = tmp_path / "log.csv"
    path.write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(LogError, match="is no text in UTF-8"):
        read_log(path)
