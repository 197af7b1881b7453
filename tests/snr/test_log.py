"""Logs: what a file becomes, in any order of columns and rows; and each kind of bad input with its message."""

from __future__ import annotations

import math
import runpy
from pathlib import Path

import pytest
import torch

from uwirl.snr.log import COMPLETE, read_log
from uwirl.snr.log_file import LogError

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


@pytest.mark.parametrize("order", ["by message", "by sensor", "reversed", "shuffled"])
@pytest.mark.parametrize("sensors", [1, 3, 10, 16])
def test_a_selection_is_even_over_messages_and_sensors(log, sensors: int, order: str):
    """Each tenth of the log's time and each sensor has its share, with any period in the order of rows."""
    S, share = 1600 // sensors, 10
    # The first reading is lost: a complete log would stay whole.
    rows = [f"{t},0,-1,{10 + k},20,-5,{k if t or k else ''},{t},{k}" for t in range(S) for k in range(sensors)]
    if order == "by sensor":
        rows = [rows[t * sensors + k] for k in range(sensors) for t in range(S)]
    elif order == "shuffled":
        rows = [rows[k] for k in torch.randperm(len(rows), generator=torch.Generator().manual_seed(1)).tolist()]
    found = log(*(rows[::-1] if order == "reversed" else rows), header=f"{HEADER},time_s,sensor")
    thinned = found.thinned(len(rows) // share)
    assert thinned.heard == len(rows) // share
    tenth = (thinned.transmitters[thinned.message, 0] * 10 / S).long()
    for part, count in (tenth.bincount(minlength=10), 10), (thinned.sensor.bincount(minlength=sensors), sensors):
        assert (part - thinned.heard / count).abs().max() <= 3
    assert torch.equal(found.thinned(len(rows)).line, found.line[~found.snr.isnan()])


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
        ("0,0,-1,1e9,0,-5,3", "line 6, column sensor_x_m: 1e9 m is beyond 100,000,000 m; check units and columns"),
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


def test_two_pings_in_one_second_are_two(log):
    rows = [f"{row},3" for row in ROWS]
    readings = log(*rows, rows[1].replace("10.5", "11.5"), header=f"{HEADER},time_s").readings
    assert readings.transmitters[:, 0].tolist() == [0.0, 5.0, 0.0]
    assert readings.snr[0, :, 1].tolist() == [10.5, 8.0, 11.5]


def test_copies_are_told(log):
    rows = [f"{k},0,-1,10,0,-5,{k / 10},{k}" for k in range(12)]
    timed = f"{HEADER},time_s"
    assert log(*rows, header=timed).doubts == ()
    pings = [row.replace(f"{k / 10},{k}", f"{k / 10 + 0.1},{k}") for k, row in enumerate(rows)]
    assert log(*rows, *pings, header=timed).doubts == ()
    (doubt,) = log(*rows, *rows, header=timed).doubts
    assert doubt.startswith("12 rows are copies of another, SNR included; leave one of each")


def test_blank_time(log):
    message = complain(log, f"{ROWS[0]},", header=f"{HEADER},time_s")
    assert message.startswith("line 2, column time_s: is blank")
    assert message.endswith("leave the column out if times are not known")


def test_a_receiver_may_drift(log):
    """The name says which sensor it is, each row where it is; a position far off is told."""
    rows = [f"0,0,-1,{10 + 0.4 * k},0,-5,{20 - k},{'ship' if k < 9 else 'buoy'}" for k in range(12)]
    found = log(*rows, header=f"{HEADER},sensor")
    assert (found.names.count("ship"), found.names.count("buoy"), found.doubts) == (9, 3, ())
    assert found.readings.receivers[:3, 0].tolist() == pytest.approx([10.0, 10.4, 10.8])
    # The same receiver does not hear one message twice.
    assert found.readings.snr.shape == (1, 9, 12)
    rows[4] = rows[4].replace("11.6", "116")
    (doubt,) = log(*rows, header=f"{HEADER},sensor").doubts
    assert doubt.startswith("sensor 'ship' moves 105 m from line 5 to line 6: correct its position, or")


def test_a_sensor_faster_than_a_ship_is_told(log):
    rows = [f"0,0,-1,{10 + 15 * k},0,-5,20,{k},ship" for k in range(4)]
    timed = f"{HEADER},time_s,sensor"
    assert log(*rows, header=timed).doubts == ()
    (doubt,) = log(*rows, "0,0,-1,500,0,-5,20,4,ship", header=timed).doubts
    assert doubt.startswith("sensor 'ship' moves 445 m from line 5 to line 6")


@pytest.mark.parametrize("separator", [";", "\t", ","])
def test_separators_and_decimal_commas(log, separator: str):
    """As a spreadsheet of another country writes them: commas in numbers are quoted only if they separate, too."""

    def written(row: str) -> str:
        cells = [cell.replace(".", ",") for cell in row.split(",")]
        return separator.join(f'"{cell}"' if separator in cell else cell for cell in cells)

    found, plain = log(*map(written, ROWS), header=HEADER.replace(",", separator)), log(*ROWS)
    assert torch.equal(found.readings.snr.nan_to_num(-1.0), plain.readings.snr.nan_to_num(-1.0))


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (
            ["0;0;-1;10;0;-5;20,5", "0;0;-1;10;0;-5;20.5"],
            ": has both decimal commas (line 2) and decimal points (line 3); write all numbers in one way",
        ),
        (["0,0,-1,10,0,-5,20"], "line 2: is separated by commas, the header by semicolons; use one of them"),
        (["0;0;-1;10;0;-5;1.000,5"], "line 2, column snr_dB: '1.000,5' is no number; write one such as -12.5"),
        (["0;0;-1;10;0;-5;1,000,5"], "line 2, column snr_dB: '1,000,5' is no number; write one such as -12.5"),
    ],
)
def test_mixed_separators(log, rows: list[str], message: str):
    assert complain(log, *rows, header=HEADER.replace(",", ";")) == message


def test_decimal_commas_between_commas(log):
    message = complain(log, "0,0,-1,10,0,-5,20,5")
    assert (
        message == "line 2: has 8 cells, the header 7; numbers with decimal commas need columns separated by semicolons"
    )


def test_nul_bytes_between_rows_are_skipped_and_told(log):
    found = log(ROWS[0], "\0\0" + ROWS[1], "\0\0\0", ROWS[3] + "\0")
    assert found.readings.snr[0].nan_to_num(-1.0).tolist() == [[20.0, 10.5], [-1.0, 8.0]]
    (doubt,) = found.doubts
    assert doubt.startswith("NUL bytes were skipped on line 3, 4, 5: did the logger lose power?")


def test_nul_bytes_within_a_row(log):
    message = complain(log, ROWS[0], "0,0,-1,10,0,\0\05,5,-1,30,0,-5,8")
    assert message.startswith("line 3: has NUL bytes within the row, where something was lost")


def test_only_differences_of_positions_matter(log):
    """UTM: the same site 4,000 km north gives the same distances and the same sensors."""
    local = log(*(f"{k},0.25,-1,{10 + 0.5 * k},{k},-5,{k}" for k in range(9)))
    grid = log(*(f"{500000 + k},4000000.25,-1,{500010 + 0.5 * k},{4000000 + k},-5,{k}" for k in range(9)))
    assert grid.names[1] == "(500010.5, 4000001, -5)"
    torch.testing.assert_close(grid.readings.distance, local.readings.distance, rtol=0.0, atol=1e-8)


def test_no_text(tmp_path):
    path = tmp_path / "log.csv"
    path.write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(LogError, match="is no text in UTF-8"):
        read_log(path)
