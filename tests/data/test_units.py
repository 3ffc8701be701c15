"""Units against the constants of scipy, which follow CODATA and NIST, and against conversions done by hand."""

import math

import numpy as np
import pytest
from scipy import constants as c

from greybox.data.units import are_of_one_kind, misspelled, to_si

KNOWN = [
    ("ft", c.foot, "m"),
    ("ft/s", c.foot, "m/s"),
    ("ft/s²", c.foot, "m/s²"),
    ("ft/s/s", c.foot, "m/s²"),
    ("ft s^-2", c.foot, "m/s²"),
    ("in", c.inch, "m"),
    ("nmi", c.nautical_mile, "m"),
    ("kt", c.knot, "m/s"),
    ("KTS", c.knot, "m/s"),
    ("mph", c.mph, "m/s"),
    ("g", c.g, "m/s²"),
    ("mG", 1e-3 * c.g, "m/s²"),
    ("lbm", c.pound, "kg"),
    ("lbf", c.pound_force, "N"),
    ("slug", c.slug, "kg"),
    ("slug*ft^2", c.slug * c.foot**2, "kg·m²"),
    ("slug-ft²", c.slug * c.foot**2, "kg·m²"),
    ("slug/ft**3", c.slug / c.foot**3, "kg/m³"),
    ("psf", c.pound_force / c.foot**2, "Pa"),
    ("lbf/ft²", c.pound_force / c.foot**2, "N/m²"),
    ("psi", c.psi, "Pa"),
    ("hPa", 100, "Pa"),
    ("hp", c.hp, "W"),
    ("Newtons", 1, "N"),
    ("Volts", 1, "V"),
    ("amps", 1, "A"),
    ("rpm", 2 * math.pi / 60, "rad/s"),
    ("RPM", 2 * math.pi / 60, "rad/s"),
    ("rev/min", 2 * math.pi / 60, "rad/s"),
    ("%", 0.01, "1"),
    ("pct", 0.01, "1"),
    ("%/s", 0.01, "1/s"),
    ("deg/s/s", c.degree, "rad/s²"),
    ("cdeg/s", 0.01 * c.degree, "rad/s"),
    ("1e-07 deg", 1e-7 * c.degree, "rad"),
    ("cm/s²", 0.01, "m/s²"),
    ("km/h", c.kmh, "m/s"),
    ("mAh", 3.6, "A·s"),
    ("N.m", 1, "N·m"),
    ("kg m²/s", 1, "kg·m²/s"),
    ("Pa/(m s)", 1, "Pa/(m·s)"),
    ("1/min", 1 / 60, "1/s"),
    ("Wh", c.hour, "J"),
    ("Ah", c.hour, "A·s"),
    ("gauss", 1e-4, "T"),
    ("l", c.liter, "m³"),
    ("yd", c.yard, "m"),
    ("mi", c.mile, "m"),
    ("fpm", c.foot / c.minute, "m/s"),
    ("kph", c.kmh, "m/s"),
    ("kgf", c.kgf, "N"),
    ("mb", 100, "Pa"),
    ("bar", c.bar, "Pa"),
    ("atm", c.atm, "Pa"),
    ("MPa", c.mega, "Pa"),
    ("dm", c.deci, "m"),
    ("µs", c.micro, "s"),
    ("ns", c.nano, "s"),
    ("hours", c.hour, "s"),
    ("rps", 2 * math.pi, "rad/s"),
    ("revs", 2 * math.pi, "rad"),
    ("degE7", 1e-7 * c.degree, "rad"),
    ("degE5", 1e-5 * c.degree, "rad"),
    ("ppm", 1e-6, "1"),
    ("grams", c.gram, "kg"),
    ("mA", c.milli, "A"),
    ("kV", c.kilo, "V"),
    ("mW", c.milli, "W"),
    ("kJ", c.kilo, "J"),
    ("mNm", c.milli, "N·m"),
    ("kN", c.kilo, "N"),
    ("kPa", c.kilo, "Pa"),
    ("kHz", c.kilo, "Hz"),
    ("kOhm", c.kilo, "Ω"),
    ("mT", c.milli, "T"),
    ("mgauss", 1e-7, "T"),
    ("mK", c.milli, "K"),
    ("us", c.micro, "s"),
    ("μs", c.micro, "s"),
    ("mrad", c.milli, "rad"),
    ("hl", 0.1, "m³"),
    ("seconds", 1, "s"),
    ("hPa/min", 100 / 60, "Pa/s"),
    ("inHg", 3386.389, "Pa"),  # SP 811 B.8: conventional, the inch of mercury
    ("fps", c.foot, "m/s"),
    ("degF/min", 5 / 9 / 60, "K/s"),
    ("degR/s", 5 / 9, "K/s"),
    ("degK/s", 1, "K/s"),
    ("degC/km", 1e-3, "K/m"),
    ("lbf·s²/ft", c.slug, "N·s²/m"),
    ("ft·lbf", c.foot * c.pound_force, "m·N"),
    ("N/(m/s)", 1, "N·s/m"),
    ("rad/(s·deg)", 180 / math.pi, "1/s"),
    ("m^(-2)", 1, "1/m²"),
    ("m**-2", 1, "1/m²"),
    ("m⁻²", 1, "1/m²"),
    ("ft^3", c.foot**3, "m³"),
    ("2.5 ft/s", 2.5 * c.foot, "m/s"),
    ("-1e2 m", -100, "m"),
    ("1/ft²", c.foot**-2, "1/m²"),
    ("kg/(m·s)/s", 1, "kg/(m·s²)"),
    ("-", 1, "1"),
]


@pytest.mark.parametrize(("unit", "factor", "si"), KNOWN, ids=[unit for unit, *_ in KNOWN])
def test_factors(unit, factor, si):
    conversion = to_si(unit)
    assert conversion.factor == pytest.approx(factor, rel=1e-9)
    assert (conversion.zero, conversion.si) == (0, si)
    assert conversion.changes == (factor != 1)
    assert conversion.apply(np.array([2.0, -3.0])) == pytest.approx(factor * np.array([2.0, -3.0]))
    assert to_si(si) == to_si(to_si(si).si)
    assert not to_si(si).changes


@pytest.mark.parametrize(
    ("unit", "scale"),
    [
        ("°C", "Celsius"),
        ("degC", "Celsius"),
        ("deg F", "Fahrenheit"),
        ("°R", "Rankine"),
        ("K", "K"),
    ],
)
def test_temperatures(unit, scale):
    values = np.array([-40.0, 0.0, 15.0, 100.0])
    expected = c.convert_temperature(values, scale, "K")
    np.testing.assert_allclose(to_si(unit).apply(values), expected, rtol=1e-12)
    assert to_si(unit).si == "K"


def test_a_difference_of_temperatures_has_no_zero():
    assert (to_si("degF/s").factor, to_si("degF/s").zero) == (pytest.approx(5 / 9), 0)


@pytest.mark.parametrize("unit", ["lb", "LBS", "lb/ft²", "lb*s"])
def test_pounds_may_be_two_things(unit):
    with pytest.raises(ValueError, match="may be a pound of mass or of force: write lbm or lbf"):
        to_si(unit)


@pytest.mark.parametrize(
    "unit",
    [
        *"pwm satellites g/s 10/s m/ (m m) m^x MS S KN ((m)) m/(s (m)s) km2/ kkm hft".split(),
        "a b c",
    ],
)
def test_what_is_not_known_is_not_guessed(unit):
    with pytest.raises(ValueError, match="is not known"):
        to_si(unit)


@pytest.mark.parametrize(
    ("unit", "meant"),
    [
        ("m/s^s", "m/s^2"),
        ("rads/s", "rad/s"),
        ("radps", "rad/s"),
        ("m/ss", "m/s"),
        ("mters", "meters"),
        ("kgm2", "kg*m^2"),
        ("rot/min", "r/min"),
    ],
)
def test_a_misspelled_unit_comes_with_the_nearest_one(unit, meant):
    assert f"write {meant!r}" in misspelled(unit)
    with pytest.raises(ValueError, match="if that is meant"):
        to_si(unit)


@pytest.mark.parametrize(
    "unit", "LSB counts pwm PWM px mol mol/l counts/s cd dB norm USD units".split()
)
def test_a_unit_of_the_users_own_is_no_misspelled_one(unit):
    assert not misspelled(unit)


def test_what_may_be_something_else_says_so():
    assert to_si("g").remark == "g was taken for 9.80665 m/s², not for gram"
    assert to_si("C").remark == "C was taken for degrees Celsius, not for coulomb"
    assert not to_si("m").remark


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ("N", "kg*m/s^2", True),
        ("N m", "J", True),
        ("N/m2", "Pa", True),
        ("W", "J/s", True),
        ("V", "W/A", True),
        ("ohm", "V/A", True),
        ("T", "N/(A m)", True),
        ("rad/s", "1/s", True),
        ("rad/s", "Hz", False),
        ("N", "kg*m/s", False),
        ("V", "A", False),
        ("deg", "1", True),
        ("m/s2", "G", True),
    ],
)
def test_units_of_one_kind(one, other, same):
    assert are_of_one_kind(to_si(one), to_si(other)) is same
    assert are_of_one_kind(to_si(other), to_si(one)) is same


def test_capitals_are_units_of_three_letters_feet_knots_and_inches():
    for unit in ("ft", "kt", "in", "rpm", "psi", "kts"):
        assert to_si(unit.upper()) == to_si(unit)
