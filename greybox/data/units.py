"""Units of logs and tables, converted to SI.

A unit is a product of powers of the names below, as in ``deg/s/s``, ``slug*ft^2``, ``m s⁻²``,
``N·m`` and ``degrees per second``. A unit that has two readings is refused with both, or converted
with a remark where one of them is usual in flight tests. Libraries of units read g as gram, kt as
kilotonne and C as coulomb; in flight tests these are the acceleration of gravity, knots and degrees
Celsius. Hence this table. Its factors are exact to the last digit, or come from appendix B of the
Guide for the Use of the International System of Units (Taylor and Thompson, NIST Special
Publication 811, 2008).
"""

import re
from collections import Counter
from dataclasses import dataclass, replace
from functools import lru_cache

from greybox.data.files.arrays import Array
from greybox.data.files.spelling import nearest


class AmbiguousUnitError(ValueError):
    """A unit that has two readings."""


@dataclass(frozen=True)
class Conversion:
    """Numbers in a unit become ``factor * value + zero`` in `si`; a `remark` names a doubt."""

    factor: float
    zero: float
    si: str
    remark: str = ""

    @property
    def changes(self) -> bool:
        """True when numbers change."""
        return self.factor != 1 or self.zero != 0

    def apply(self, values: Array) -> Array:
        """Return the values in SI."""
        return self.factor * values + self.zero if self.changes else values


def _units(table: str, zero: float = 0.0) -> dict[str, Conversion]:
    """Return units by name; every line of the table has the names of a unit and its value in SI."""
    units = {}
    for line in table.strip().splitlines():
        names, _, value = line.partition(" = ")
        factor, _, si = value.partition(" ")
        units |= dict.fromkeys(names.split(), Conversion(float(factor), zero, si))
    return units


CELSIUS, FAHRENHEIT = 273.15, 459.67 * 5 / 9  # K, zeros of these scales
# Those that take prefixes.
PREFIXED = _units("""
m meter meters metre metres = 1 m
s sec second seconds = 1 s
rad radian radians = 1 rad
deg degree degrees ° º degheading deglatitude deglongitude = 0.017453292519943295 rad
gram grams = 1e-3 kg
K kelvin = 1 K
N newton newtons = 1 N
Nm = 1 N·m
Nms = 1 N·m·s
Pa pascal = 1 Pa
bar = 1e5 Pa
J joule = 1 J
W Watt watt watts = 1 W
Wh = 3600 J
A amp amps ampere amperes = 1 A
Ah = 3600 A·s
V volt volts = 1 V
Ohm ohm ohms Ω = 1 Ω
T = 1 T
gauss Gauss = 1e-4 T
Hz = 1 Hz
l L liter litre = 1e-3 m³
% pct percent = 0.01 1
G = 9.80665 m/s²
""") | _units("degC °C ºC degc celsius = 1 K", CELSIUS)
PREFIXES = {
    "M": 1e6,
    "k": 1e3,
    "h": 1e2,
    "d": 1e-1,
    "c": 1e-2,
    "m": 1e-3,
    "u": 1e-6,
    "µ": 1e-6,
    "μ": 1e-6,
}
# Before words, as in milliseconds.
LONG_PREFIXES = {
    "mega": 1e6,
    "kilo": 1e3,
    "centi": 1e-2,
    "milli": 1e-3,
    "micro": 1e-6,
    "nano": 1e-9,
}

NAMED = (
    PREFIXED
    | _units("C = 1 K", CELSIUS)
    | _units("degF °F ºF = 0.5555555555555556 K", FAHRENHEIT)
    | _units("""
kg = 1 kg
ns nsec = 1e-9 s
nT = 1e-9 T
min minute minutes = 60 s
h hr hrs hour hours = 3600 s
day days = 86400 s
ft foot feet = 0.3048 m
in inch inches = 0.0254 m
yd = 0.9144 m
mi mile miles = 1609.344 m
nmi = 1852 m
fps = 0.3048 m/s
fpm = 0.00508 m/s
mph = 0.44704 m/s
kph kmh = 0.2777777777777778 m/s
kt kts kn knot knots KIAS KCAS KEAS KTAS = 0.5144444444444445 m/s
g = 9.80665 m/s²
lbm = 0.45359237 kg
slug slugs = 14.593902937206364 kg
lbf = 4.4482216152605 N
kgf = 9.80665 N
psf = 47.88025898033584 Pa
psi = 6894.757293168361 Pa
mb = 100 Pa
atm = 101325 Pa
inHg = 3386.389 Pa
hp = 745.6998715822702 W
degR °R = 0.5555555555555556 K
degK °K = 1 K
rpm = 0.10471975511965977 rad/s
dps = 0.017453292519943295 rad/s
mps = 1 m/s
rps = 6.283185307179586 rad/s
rev revs revolution revolutions = 6.283185307179586 rad
degE5 = 1.7453292519943295e-07 rad
degE7 = 1.7453292519943295e-09 rad
ppm = 1e-6 1
1 - none unitless dimensionless = 1 1
""")
)
NAMED |= {"deg C": NAMED["degC"], "deg F": NAMED["degF"], "r/min": NAMED["rpm"]}

# Units that may be written in capitals, such as RPM and KTS. Shorter names would then be other
# units, as M, S and MS may be.
CAPITALS = {
    name.lower(): unit
    for name, unit in NAMED.items()
    if len(name) > 2 or name in ("ft", "kt", "in")
}

# Products that a misspelled unit may mean, beside the names
USUAL = "m/s m/s^2 rad/s rad/s^2 deg/s deg/s^2 1/s N*m kg*m^2 kg/m^3".split()

# Not Hz, which is 2π rad/s for a rotation and 1/s otherwise.
IN_BASE_UNITS = {
    "N": "kg m s-2",
    "Pa": "kg m-1 s-2",
    "J": "kg m2 s-2",
    "W": "kg m2 s-3",
    "V": "kg m2 s-3 A-1",
    "Ω": "kg m2 s-3 A-2",
    "T": "kg s-2 A-1",
}

# Names with a second meaning, and how they are taken; in products they are refused.
DOUBTFUL = {
    "g": "9.80665 m/s², not for gram",
    "G": "9.80665 m/s², not for gauss",
    "mG": "0.00980665 m/s², not for milligauss",
    "C": "degrees Celsius, not for coulomb",
}

# Names of which neither meaning is usual, with what to write instead.
POUND = "may be a pound of mass or of force: write lbm or lbf"
TORQUE = "may be a torque or a length: write N*m, nmi or 1e-9 m"
AMBIGUOUS = dict.fromkeys(("lb", "lbs", "pound", "pounds"), POUND) | {"nm": TORQUE}

# What people count, or scale in their own way, in lower case; decibels are those of responses.
OWN = frozenset("# abs absolute count counts cts db hz khz lsb px pixel pwm".split())

SUPERSCRIPTS = "⁰¹²³⁴⁵⁶⁷⁸⁹⁻"
PLAIN = "0123456789-"
TOKEN = re.compile(
    r"\s*(?:(?P<name>(?:[^\W\d]|[°%])+|1(?!\d))"
    r"(?:(?:\^|\*\*)?(?P<power>[+-]?\d+)|(?:\^|\*\*)\((?P<inner>[+-]?\d+)\))?"
    r"|(?P<mark>[/·*.×()]|-(?=[^\W\d])))\s*"
)
PER = re.compile(r"\s+per\s+")
SQUARED = re.compile(r"\s+squared\b")
LEADING = re.compile(r"([+-]?\d+\.?\d*(?:[eE][+-]?\d+)?)\s+(?=\D)")  # as in "1e-07 deg"


@lru_cache(maxsize=1024)
def to_si(unit: str) -> Conversion:
    """Return the conversion of numbers in `unit` to SI; numbers without a unit do not change.

    Raises
    ------
    ValueError
        If the unit is unknown. The caller adds the name of the signal and a full stop.
    AmbiguousUnitError
        If it has two readings.
    """
    text = SQUARED.sub("^2", PER.sub("/", unit.strip()))
    if not text:
        return Conversion(1.0, 0.0, "")
    # A whole unit before a product: temperatures have a zero of their own, which a product loses.
    named = _named(text)
    if named is not None:
        remark = f"{text} was taken for {DOUBTFUL[text]}" if text in DOUBTFUL else ""
        return replace(named, remark=remark)

    # pymavlink writes multipliers before a unit, as in ``1e-07 deg``.
    leading = LEADING.match(text)
    factor = float(leading[1]) if leading else 1.0
    powers = Counter[str]()
    for name, power in _powers(text[leading.end() :] if leading else text).items():
        # A remark can state the assumption about one unit, not about a part of a product.
        named = None if name in DOUBTFUL else _named(name)
        if named is None:
            raise _unknown(unit)
        factor *= named.factor**power
        for si, exponent in _powers(named.si).items():
            powers[si] += exponent * power
    if not powers:
        raise _unknown(unit)

    return Conversion(factor, 0.0, _written(powers))


def _unknown(unit: str) -> ValueError:
    return ValueError(misspelled(unit) or f"the unit {unit!r} is not known")


@lru_cache(maxsize=1024)
def misspelled(unit: str) -> str:
    """Return what to write for an unknown unit that resembles a known one, without a full stop.

    It is empty for units of the user's own, such as LSB and counts.
    """
    # Two thirds of LSB, PWM and cd are those of known units, which are not meant, and so is 0.77 of
    # units, as of a stick, in unitless.
    near = nearest(unit.strip(), (*NAMED, *USUAL), 0.8)
    return f"the unit {unit!r} is not known: write {near!r} if that is meant" if near else ""


def known_unit(unit: str) -> Conversion | None:
    """Return the conversion of numbers in `unit` to SI; None for an empty or unknown unit."""
    try:
        return to_si(unit) if unit.strip() else None
    except ValueError:
        return None


def is_unit(text: str) -> bool:
    """Return whether a text is a unit: a known one, one with two readings, or one of counts."""
    try:
        return bool(to_si(text).si)
    except AmbiguousUnitError:
        return True
    except ValueError:
        return text.strip().lower() in OWN


def are_of_one_kind(a: Conversion, b: Conversion) -> bool:
    """Return whether two units measure the same kind of quantity; radians are pure numbers."""
    # Derived units may be written in several ways: N/kg and m/s² are one kind.
    quotient = Counter[str]()
    for si, sign in ((a.si, 1), (b.si, -1)):
        for name, power in _powers(si).items():
            for base, exponent in _powers(IN_BASE_UNITS.get(name, name)).items():
                quotient[base] += sign * power * exponent

    return not any(quotient[base] for base in quotient.keys() - {"rad", "1"})


def _named(name: str) -> Conversion | None:
    """Return a unit that has a name, or a name and a prefix; an ambiguous one is refused."""
    if name.lower() in AMBIGUOUS and name not in NAMED:
        raise AmbiguousUnitError(f"{name} {AMBIGUOUS[name.lower()]}")
    if name in NAMED:
        return NAMED[name]
    for prefix, factor in LONG_PREFIXES.items():
        word = name.lower().removeprefix(prefix)
        if word != name.lower() and len(word) > 2 and word in PREFIXED:
            return replace(PREFIXED[word], factor=factor * PREFIXED[word].factor)
    base = PREFIXED.get(name[1:])
    if base is None or name[0] not in PREFIXES:
        return CAPITALS.get(name.lower())
    # In a header of capitals, MV are millivolts.
    if name[0] == "M" and name.isupper():
        raise AmbiguousUnitError(
            f"{name} may be mega or milli: write 1e6 {name[1:]} or m{name[1:]}"
        )
    return replace(base, factor=PREFIXES[name[0]] * base.factor)


def _powers(text: str) -> dict[str, int]:
    """Return the names in a product with their exponents; empty if the text is not a product."""
    plain = text.translate(str.maketrans(SUPERSCRIPTS, PLAIN))
    powers = Counter[str]()
    # Signs of the exponents: -1 behind a slash. A slash before parentheses applies to all units in
    # them.
    side = 1
    group = 0
    at = 0
    while at < len(plain):
        token = TOKEN.match(plain, at)
        if token is None:
            return {}
        at = token.end()
        if token["name"]:
            power = int(token["power"] or token["inner"] or 1)
            _require_one_reading(token["name"], power)
            powers[token["name"]] += (group or 1) * side * power
            side = 1
        elif token["mark"] == "/":
            side = -1
        elif token["mark"] == "(" and not group:
            group, side = side, 1
        elif token["mark"] == ")" and group:
            group = 0
        elif token["mark"] in "()":
            return {}

    return powers if side > 0 and not group else {}


def _require_one_reading(name: str, power: int) -> None:
    """Raise AmbiguousUnitError for ms^-1, which is m/s or 1/ms, and for its like."""
    first, last = name[:-1], name[-1]
    if power > 0 or last not in ("s", "m") or first == last or not first:
        return
    if _named(first) and _named(name):
        exponent = f"^{-power}" if power < -1 else ""
        readings = f"{first}/{last}{exponent} or 1/{name}{exponent}"
        raise AmbiguousUnitError(f"{name}^{power} may be {readings}: write one of them")


def _written(powers: dict[str, int]) -> str:
    """Return a product of powers as people write it: kg·m², 1/s, kg/(m·s); 1 for a pure number."""
    superscripts = str.maketrans(PLAIN, SUPERSCRIPTS)
    above, below = (
        [
            name + (str(sign * power).translate(superscripts) if sign * power > 1 else "")
            for name, power in powers.items()
            if sign * power > 0 and name != "1"
        ]
        for sign in (1, -1)
    )
    numerator = "·".join(above) or "1"
    if not below:
        return numerator
    denominator = "·".join(below)
    return f"{numerator}/({denominator})" if len(below) > 1 else f"{numerator}/{denominator}"
