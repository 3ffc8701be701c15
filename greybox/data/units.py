"""Units of logs and tables, converted to SI.

A unit is a product of powers of the names below, as in ``deg/s/s``, ``slug*ft^2``, ``m s⁻²`` and
``N·m``. Libraries of units read g as gram, kt as kilotonne and C as coulomb; in flight tests these
are the acceleration of gravity, knots and degrees Celsius. Hence this table. Its factors are exact,
or else those of B. N. Taylor and A. Thompson, Guide for the Use of the International System of
Units, NIST Special Publication 811 (2008), appendix B.
"""

import math
import re
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

from greybox.files.arrays import Array

FOOT = 0.3048  # m, exact, SP 811 B.8, as the next four
MILE = 5280 * FOOT  # m
NAUTICAL_MILE = 1852.0  # m
POUND = 0.45359237  # kg
GRAVITY = 9.80665  # m/s², standard acceleration of free fall
POUND_FORCE = POUND * GRAVITY  # N
SLUG = POUND_FORCE / FOOT  # kg, which a pound of force accelerates by 1 ft/s²
INCH_OF_MERCURY = 3386.389  # Pa, conventional
CELSIUS = 273.15  # K, exact


class _Unit(NamedTuple):
    factor: float
    si: str  # a product of powers, as above
    zero: float = 0.0  # of its scale, in SI


def _same(names: str, *unit: float | str) -> dict[str, _Unit]:
    """Return one unit under several names."""
    return dict.fromkeys(names.split(), _Unit(*unit))  # type: ignore[arg-type]


# Those that take prefixes.
PREFIXED = {
    **_same("m meter meters metre metres", 1.0, "m"),
    **_same("s sec second seconds", 1.0, "s"),
    **_same("rad radian radians", 1.0, "rad"),
    **_same("deg degree degrees ° º degheading deglatitude deglongitude", math.pi / 180, "rad"),
    **_same("degC °C ºC degc", 1.0, "K", CELSIUS),
    **_same("gram grams", 1e-3, "kg"),
    **_same("K", 1.0, "K"),
    **_same("N", 1.0, "N"),
    **_same("Nm", 1.0, "N m"),
    **_same("Pa", 1.0, "Pa"),
    **_same("bar", 1e5, "Pa"),
    **_same("J", 1.0, "J"),
    **_same("W Watt watt", 1.0, "W"),
    **_same("Wh", 3600.0, "J"),
    **_same("A amp", 1.0, "A"),
    **_same("Ah", 3600.0, "A s"),
    **_same("V volt", 1.0, "V"),
    **_same("Ohm ohm Ω", 1.0, "Ω"),
    **_same("T", 1.0, "T"),
    **_same("gauss Gauss", 1e-4, "T"),
    **_same("Hz", 1.0, "Hz"),
    **_same("l L liter litre", 1e-3, "m3"),
    **_same("%", 0.01, "1"),
    **_same("G", GRAVITY, "m/s2"),
}
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

NAMED = {
    **PREFIXED,
    **_same("kg", 1.0, "kg"),
    **_same("ns", 1e-9, "s"),
    **_same("min minute minutes", 60.0, "s"),
    **_same("h hr hrs hour hours", 3600.0, "s"),
    **_same("ft foot feet", FOOT, "m"),
    **_same("in inch inches", FOOT / 12, "m"),
    **_same("yd", 3 * FOOT, "m"),
    **_same("mi mile miles", MILE, "m"),
    **_same("NM nm nmi", NAUTICAL_MILE, "m"),
    **_same("fps", FOOT, "m/s"),
    **_same("fpm", FOOT / 60, "m/s"),
    **_same("mph", MILE / 3600, "m/s"),
    **_same("kph kmh", 1 / 3.6, "m/s"),
    **_same("kt kts kn knot knots KIAS KCAS KEAS KTAS", NAUTICAL_MILE / 3600, "m/s"),
    **_same("g", GRAVITY, "m/s2"),
    **_same("lbm", POUND, "kg"),
    **_same("slug slugs", SLUG, "kg"),
    **_same("lbf", POUND_FORCE, "N"),
    **_same("kgf", GRAVITY, "N"),
    **_same("psf", POUND_FORCE / FOOT**2, "Pa"),
    **_same("psi", POUND_FORCE / (FOOT / 12) ** 2, "Pa"),
    **_same("mb", 100.0, "Pa"),
    **_same("atm", 101325.0, "Pa"),
    **_same("inHg", INCH_OF_MERCURY, "Pa"),
    **_same("hp", 550 * POUND_FORCE * FOOT, "W"),
    **_same("degF °F ºF", 5 / 9, "K", 459.67 * 5 / 9),
    **_same("degR °R", 5 / 9, "K"),
    **_same("degK °K", 1.0, "K"),
    **_same("C", 1.0, "K", CELSIUS),
    **_same("rpm", math.pi / 30, "rad/s"),
    **_same("rps", 2 * math.pi, "rad/s"),
    **_same("rev revs revolution revolutions", 2 * math.pi, "rad"),
    **_same("degE5", 1e-5 * math.pi / 180, "rad"),
    **_same("degE7", 1e-7 * math.pi / 180, "rad"),
    **_same("ppm", 1e-6, "1"),
    **_same("1 - none unitless dimensionless", 1.0, "1"),
}
NAMED |= {"deg C": NAMED["degC"], "deg F": NAMED["degF"], "r/min": NAMED["rpm"]}

# Units that are also written in capitals, as in RPM or KTS; shorter ones are other units then, as
# M, S and MS may be.
CAPITALS = {
    name.lower(): unit
    for name, unit in NAMED.items()
    if len(name) > 2 or name in ("ft", "kt", "in")
}

# Not Hz: that of a rotation is 2π rad/s, and 1/s one.
IN_BASE_UNITS = {
    "N": "kg m s-2",
    "Pa": "kg m-1 s-2",
    "J": "kg m2 s-2",
    "W": "kg m2 s-3",
    "V": "kg m2 s-3 A-1",
    "Ω": "kg m2 s-3 A-2",
    "T": "kg s-2 A-1",
}

DOUBTFUL = {
    "g": "gram",
    "G": "gauss",
    "mG": "milligauss",
    "C": "coulomb",
}  # and what else they may be; not in products
POUNDS = ("lb", "lbs", "pound", "pounds")

SUPERSCRIPTS = "⁰¹²³⁴⁵⁶⁷⁸⁹⁻"
PLAIN = "0123456789-"
TOKEN = re.compile(
    r"\s*(?:(?P<name>(?:[^\W\d]|[°%])+|1(?!\d))(?:(?:\^|\*\*)?(?P<power>[+-]?\d+)|(?:\^|\*\*)\((?P<inner>[+-]?\d+)\))?"
    r"|(?P<mark>[/·*.×()]|-(?=[^\W\d])))\s*"
)
LEADING = re.compile(r"([+-]?\d+\.?\d*(?:[eE][+-]?\d+)?)\s+(?=\D)")  # as in "1e-07 deg"


@dataclass(frozen=True)
class Conversion:
    """How numbers in some unit become SI: ``factor * value + zero`` in the unit `si`; a `remark` names a doubt."""

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


@lru_cache(maxsize=1024)
def to_si(unit: str) -> Conversion:
    """Return how numbers in `unit` become SI; without a unit they remain what they are.

    Raises
    ------
    ValueError
        If the unit is not known or may mean two things, in words to which the name of the signal
        can be added.
    """
    text = unit.strip()
    if not text:
        return Conversion(1.0, 0.0, "")
    named = _named(text)
    if named is not None:
        conversion = Conversion(named.factor, named.zero, _written(_powers(named.si)))
        if text not in DOUBTFUL:
            return conversion
        scale = f"{named.factor:g} {conversion.si}" if not named.zero else "degrees Celsius"
        return replace(conversion, remark=f"{text} was taken for {scale}, not for {DOUBTFUL[text]}")

    leading = LEADING.match(text)
    factor = float(leading[1]) if leading else 1.0
    powers: dict[str, int] = {}
    for name, power in _powers(text[leading.end() :] if leading else text).items():
        if name.lower() in POUNDS:
            raise ValueError(f"{name} may be a pound of mass or of force, write lbm or lbf")
        named = None if name in DOUBTFUL else _named(name)
        if named is None:
            raise ValueError(f"the unit {unit!r} is not known")
        factor *= named.factor**power
        for si, exponent in _powers(named.si).items():
            powers[si] = powers.get(si, 0) + exponent * power
    if not powers:
        raise ValueError(f"the unit {unit!r} is not known")
    return Conversion(factor, 0.0, _written(powers))


def are_of_one_kind(a: Conversion, b: Conversion) -> bool:
    """Return whether numbers in two units measure the same kind of quantity; radians are pure numbers."""
    kinds = []
    for conversion in (a, b):
        powers: dict[str, int] = {}
        for name, power in _powers(conversion.si).items():
            for base, exponent in _powers(IN_BASE_UNITS.get(name, name)).items():
                powers[base] = powers.get(base, 0) + power * exponent
        kinds.append(
            {name: power for name, power in powers.items() if power and name not in ("rad", "1")}
        )
    return kinds[0] == kinds[1]


def _named(name: str) -> _Unit | None:
    """Return a unit that has a name, or a name and a prefix."""
    if name in NAMED:
        return NAMED[name]
    base = PREFIXED.get(name[1:])
    if base is not None and name[0] in PREFIXES:
        return base._replace(factor=PREFIXES[name[0]] * base.factor)
    return CAPITALS.get(name.lower())


def _powers(text: str) -> dict[str, int]:
    """Return the names in a product with their exponents; none where it is no product."""
    plain = text.translate(str.maketrans(SUPERSCRIPTS, PLAIN))
    powers: dict[str, int] = {}
    side = 1  # of the division that the next name is on
    group = 0  # that of the parentheses around it, if any
    at = 0
    while at < len(plain):
        token = TOKEN.match(plain, at)
        if token is None:
            return {}
        at = token.end()
        if token["name"]:
            power = int(token["power"] or token["inner"] or 1)
            powers[token["name"]] = powers.get(token["name"], 0) + (group or 1) * side * power
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


def _written(powers: dict[str, int]) -> str:
    """Return a product of powers as a person writes it: kg·m², m/s², 1/s, kg/(m·s); 1 for a pure number."""
    above = [_power(name, power) for name, power in powers.items() if power > 0 and name != "1"]
    below = [_power(name, -power) for name, power in powers.items() if power < 0 and name != "1"]
    numerator = "·".join(above) or "1"
    if not below:
        return numerator
    denominator = "·".join(below)
    return f"{numerator}/({denominator})" if len(below) > 1 else f"{numerator}/{denominator}"


def _power(name: str, exponent: int) -> str:
    return (
        name
        if exponent == 1
        else name + str(exponent).translate(str.maketrans(PLAIN, SUPERSCRIPTS))
    )
