"""What names of columns say of quantity, unit and role."""

import pytest

from afdsvc.errors import BadInput
from afdsvc.files.tables.formats import head
from afdsvc.files.tables.mapping import Heading, heading


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("speed_rpm", ("speed", "rpm", "y")),
        ("voltage_V", ("voltage", "V", "u")),
        ("Motor Torque [Nm]", ("motor_torque", "N*m", "u")),
        ("position (mm)", ("position", "mm", "y")),
        ("u_force", ("force", "", "u")),
        ("u_force_N", ("force", "N", "u")),
        ("y_position", ("position", "", "y")),
        ("aux_temperature", ("temperature", "", "aux")),
        ("t_ms", ("t", "ms", "t")),
        ("timestamp", ("timestamp", "", "t")),
        ("PLANT1.SPEED_RPM", ("plant1_speed", "rpm", "y")),
        ("flow_PV", ("flow_pv", "", "aux")),
        ("data_1", ("data_1", "", "aux")),
        ("y", ("y", "", "y")),
        ("Counter", ("counter", "", "aux")),
        ("voltage_v", ("voltage", "V", "u")),
        ("motor_current_ma", ("motor_current", "mA", "u")),
        ("torque_nm", ("torque", "N*m", "u")),
        ("position_nm", ("position", "nm", "y")),
        ("pressure_kpa", ("pressure", "kPa", "y")),
        ("pressure_mpa", ("pressure", "MPa", "y")),
        ("oil_temp_c", ("oil_temp", "degC", "aux")),
        ("speed_rad_s", ("speed", "rad/s", "y")),
        ("torque_percent", ("torque", "percent", "u")),
        ("Drehzahl [U/min]", ("drehzahl", "rpm", "aux")),
        ("bearing_left", ("bearing_left", "", "aux")),
    ],
)
def test_names_say_what_they_are(name, expected):
    found = heading(name)
    assert (found.label, found.unit, found.role) == expected


def test_what_is_said_on_the_command_line_wins():
    assert heading("Counter", outputs=["Counter"]) == Heading("Counter", "counter", "", "y")


def test_a_first_line_that_is_no_text_is_refused(tmp_path):
    (tmp_path / "a.csv").write_bytes(b"\xfe\xff\n")
    with pytest.raises(BadInput, match=r"a\.csv: is not a readable \.csv; expected text in UTF-8"):
        head(tmp_path / "a.csv")
