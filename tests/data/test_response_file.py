"""Frequency responses in files: what is written is read back, what is damaged is refused in a sentence."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from measured_responses import EXTRAS, RESPONSE, assert_same, measured
from numpy.testing import assert_allclose

import greybox as gb


@pytest.mark.parametrize(
    "extras", [{}, {"variance": EXTRAS["variance"]}, EXTRAS], ids=lambda e: "+".join(e) or "none"
)
def test_what_is_written_is_read_exactly(tmp_path, extras):
    path = tmp_path / "pitch.csv"
    response = measured(response=np.array(RESPONSE) / 3, **extras)
    gb.data.write_response(response, path)
    back = gb.read_response(path, input="u", output="theta")
    assert_same(back, response)
    assert back.checksum == response.checksum
    assert (back.name, back.source) == ("pitch", "pitch.csv")
    assert [p.name for p in tmp_path.iterdir()] == ["pitch.csv"]


def test_one_response_of_a_matrix_keeps_its_common_errors(tmp_path):
    path = tmp_path / "matrix.csv"
    one, other = measured(**EXTRAS), measured(omega=[1.0, 3.0, 9.0], output="phi")
    gb.data.write_responses([one, other], path)
    assert_same(gb.read_response(path, input="u", output="theta"), one)
    assert_same(gb.read_response(path, input="u", output="phi"), other)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(numbers=st.tuples(*[st.floats(1e-74, 1e74)] * 3))
def test_any_number_survives_the_file(tmp_path_factory, numbers):
    path = tmp_path_factory.mktemp("numbers") / "one.csv"
    omega, alpha, beta = numbers
    response = gb.FrequencyResponse([omega], [complex(alpha, -beta)])
    gb.data.write_response(response, path)
    assert_same(gb.read_response(path), response)


def test_writing_twice_keeps_the_last(tmp_path):
    path = tmp_path / "pitch.csv"
    gb.data.write_response(measured(**EXTRAS), path)
    gb.data.write_response(measured(), path)
    assert_same(gb.read_response(path), measured())


def file(tmp_path, text, encoding="utf-8"):
    path = tmp_path / "data.csv"
    path.write_bytes(text.encode(encoding))
    return path


TABLE = """omega_rad_s, note , roll_alpha, roll_beta, yaw_alpha, yaw_beta, yaw_variance
1.0, first,  1.5, -2, 0.25, 0.5, 0.01
2.0,, , , 1e-3, 2, 0.02

4.0, last, 3, 4, , ,
"""


def test_a_table_of_several_responses_is_read_by_prefix(tmp_path):
    path = file(tmp_path, TABLE)
    roll = gb.read_response(path, "roll_", input="u", output="phi", name="roll")
    assert_same(roll, gb.FrequencyResponse([1, 4], [1.5 - 2j, 3 + 4j]))
    assert (roll.input, roll.output, roll.name) == ("u", "phi", "roll")
    yaw = gb.read_response(path, prefix="yaw_")
    assert_same(yaw, gb.FrequencyResponse([1, 2], [0.25 + 0.5j, 0.001 + 2j], variance=[0.01, 0.02]))


def test_a_byte_order_mark_and_the_order_of_columns_do_not_matter(tmp_path):
    text = "beta,omega_rad_s,alpha\r\n2,1,3\r\n"
    assert_same(
        gb.read_response(file(tmp_path, text, "utf-8-sig")), gb.FrequencyResponse([1], [3 + 2j])
    )


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", r"data\.csv is empty"),
        ("# only a remark\n", r"data\.csv is empty"),
        ("omega,alpha,beta\n1,2,3\n", r"has no column 'omega_rad_s'; it has omega, alpha, beta"),
        ("omega_rad_s,alpha\n1,2\n", r"has no column 'beta'"),
        ("omega_rad_s,alpha,beta\n", r"data\.csv: the frequency response is empty"),
        (
            "omega_rad_s,alpha,beta,alpha_common1\n1,2,3,4\n",
            r"data\.csv: there is no column 'beta_common1': give both",
        ),
        (
            "omega_rad_s,alpha,beta\n1,2,x\n",
            r"data\.csv, line 2: beta is 'x', which is not a number",
        ),
        ("omega_rad_s,alpha,beta\n1,2,3\n2,,3\n", r"line 3: alpha is '', which is not a number"),
        ("omega_rad_s,alpha,beta\n,2,3\n", r"line 2: omega_rad_s is '', which is not a number"),
        ("omega_rad_s,alpha,beta\n1,2\n", r"line 2, has 2 cells where the header has 3"),
        ("omega_rad_s,alpha,beta\n1,2,3\n1,2,3\n", r"data\.csv: omega = 1 rad/s is repeated"),
        ("omega_rad_s,alpha,beta\n1,nan,3\n", r"line 2: alpha is 'nan', which is not a number"),
        ("omega_rad_s,alpha,beta,alpha\n1,2,3,4\n", r"data\.csv has several columns 'alpha'"),
    ],
)
def test_bad_files_are_refused_in_a_sentence(tmp_path, text, sentence):
    with pytest.raises(ValueError, match=sentence):
        gb.read_response(file(tmp_path, text))


def test_a_missing_prefix_names_its_column(tmp_path):
    with pytest.raises(
        ValueError, match=r"has no column 'pitch_alpha'; it has omega_rad_s, note, roll_alpha"
    ):
        gb.read_response(file(tmp_path, TABLE), "pitch_")


def test_a_file_that_is_no_text_is_refused(tmp_path):
    path = tmp_path / "data.csv"
    path.write_bytes(b"\x00\x81binary\xff")
    with pytest.raises(ValueError, match=r"data\.csv is not a CSV text file"):
        gb.read_response(path)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nothing\.csv"):
        gb.read_response(tmp_path / "nothing.csv")


def test_a_name_that_is_not_of_a_table_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"ends in \.csv"):
        gb.data.write_response(measured(), tmp_path / "pitch.h5")


def test_what_a_response_says_about_itself_survives_the_file(tmp_path):
    path = tmp_path / "pitch.csv"
    about = {
        "dropped": "3 of 10 points: of a low coherence, at 1 to 2 rad/s",
        "instrument": "SIDD.Targ",
    }
    written = replace(measured(), units={"u": "1", "theta": "rad"}, about=about)
    gb.data.write_response(written, path)
    back = gb.read_response(path)
    assert (back.input, back.output) == (written.input, written.output)
    assert (back.units, back.about) == (written.units, written.about)
    assert gb.read_response(path, output="y").output == "y"
    assert back.times_s("q").units == {"u": "1", "q": "rad/s"}
    assert back.times_s("q").over_s("theta").units == {"u": "1", "theta": "rad"}


def test_a_table_with_a_row_for_each_point_of_several_responses_is_a_matrix(tmp_path):
    text = """output,input,f,mag_db,phase_deg
p,lat,1,20,-90
q,lat,2,0,180
p,lat,3,-20,0
q,lon,1,6,10
"""
    columns = {"frequency": "f:Hz", "magnitude": "mag_db:dB", "phase": "phase_deg:deg"}
    path = file(tmp_path, text)
    p, q, other = gb.data.read_responses(path, columns=columns)
    assert [each.name for each in (p, q, other)] == ["p/lat", "q/lat", "q/lon"]
    assert (p.output, p.input, other.input) == ("p", "lat", "lon")
    assert_allclose(p.omega, 2 * np.pi * np.array([1, 3]))
    assert_allclose(p.response, [-10j, 0.1], atol=1e-12)
    assert_allclose(q.response, [-1], atol=1e-12)
    assert_same(gb.read_response(path, input="lon", output="q", columns=columns), other)
    with pytest.raises(ValueError, match="name the pair of every row"):
        gb.data.read_responses(file(tmp_path, "output,omega_rad_s,alpha,beta\np,1,2,3\n"))


def test_units_below_the_header_and_a_coherence_in_percent_are_read(tmp_path):
    rectangular = tmp_path / "rectangular.csv"
    rectangular.write_text("omega_rad_s;alpha;beta\nrad/s;1/s;1/s\n1;0,5;-0,5\n2;0,2;-0,4\n")
    polar = tmp_path / "polar.csv"
    polar.write_text("f;mag;ph;coh\nHz;dB;deg;%\n0,5;20;-90;97\n1,5;0;-180;98\n")
    assert_allclose(gb.read_response(rectangular).response, [0.5 - 0.5j, 0.2 - 0.4j])
    columns = {"frequency": "f", "magnitude": "mag", "phase": "ph", "coherence": "coh"}
    response = gb.read_response(polar, columns=columns)
    assert_allclose(response.omega, [np.pi, 3 * np.pi])
    assert_allclose(response.response, [-10j, -1], atol=1e-12)
    assert_allclose(response.coherence, [0.97, 0.98])


def test_columns_may_be_named_by_their_roles(tmp_path):
    path = tmp_path / "bode.csv"
    path.write_text("Frequency [Hz],Magnitude [dB],Phase [deg]\n1,20,-90\n2,0,180\n")
    response = gb.read_response(path)
    np.testing.assert_allclose(response.omega, [2 * np.pi, 4 * np.pi])
    np.testing.assert_allclose(response.response, [-10j, -1], atol=1e-12)
    path.write_text("frequency,magnitude,phase\n1,20,-90\n")
    with pytest.raises(ValueError, match="'frequency' without a unit"):
        gb.read_response(path)
    path.write_text("Phi (°);coherence;f (kHz);Gain (dB)\n-90;0.9;0.001;20\n180;0.8;0.002;0\n")
    named = gb.read_response(path)
    np.testing.assert_allclose(named.response, response.response, atol=1e-12)
    np.testing.assert_allclose(named.omega, response.omega)
    np.testing.assert_allclose(named.coherence, [0.9, 0.8])
    path.write_text("f [Hz],in [dB],out [dB],phase [deg]\n1,20,0,-90\n")
    with pytest.raises(ValueError, match="it has f, in, out, phase"):
        gb.read_response(path)


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("cell", ["inf", "-inf", "nan"])
def test_numbers_beyond_arithmetic_are_refused_without_a_warning(tmp_path, cell):
    path = tmp_path / "a.csv"
    lines = [f"1,2,{cell},.5,1", "2,3,1,.5,1", "3,1,1,.9,1", ""]
    path.write_text("\n".join(["omega_rad_s,alpha,beta,alpha_common1,beta_common1", *lines]))
    with pytest.raises(ValueError, match=r"a\.csv"):
        gb.read_response(path)
    path.write_text(path.read_text().replace(f",{cell},.5,1", f",1,.5,{cell}"))
    with pytest.raises(ValueError, match=r"common|variance"):
        gb.read_response(path)


def test_a_point_at_0_hertz_is_left_out_and_said(tmp_path):
    path = tmp_path / "bode.csv"
    path.write_text("f [Hz],Gain [dB],ph [deg]\n0,-200,0\n1,0,-45\n2,-6,-90\n")
    response = gb.read_response(path)
    np.testing.assert_allclose(response.omega, [2 * np.pi, 4 * np.pi])
    assert response.about["left out"] == "the point at 0 Hz"
    path.write_text("f [Hz],Gain [dB],ph [deg]\n1,0,-45\n0,-200,0\n2,-6,-90\n")
    with pytest.raises(ValueError, match="omega is 0 at index 1"):
        gb.read_response(path)
