"""Text with mathematics in it, and the notation of a plant's states and inputs: x₁ for x1, θ for theta; and the unit.

`_{…}` is a subscript, D̂ and P̂ have hats, ⁻³ is a raised number.
"""

import html
import re
from unicodedata import lookup

from npred.plants.base import Plant

SPELT = "alpha|beta|gamma|delta|epsilon|zeta|eta|theta|iota|kappa|mu|nu|xi|pi|rho|sigma|tau|phi|chi|psi|omega"
LETTER = re.compile(f"(?i:{SPELT})")
NAME = re.compile(rf"((?i:{SPELT})|[A-Za-z])(?:_?(\d+)|_(?!dot)([A-Za-z][A-Za-z0-9]*))?")  # x, x1, x_1, T_out, theta1
D_HAT, HORIZON = "D̂", "D(X, t)"

WORDS = {
    1.0: "s sec secs second seconds sek", 1e-3: "ms msec millis millisecond milliseconds",
    1e-6: "us µs μs usec micros microsecond microseconds", 1e-9: "ns nsec nanosecond nanoseconds",
    60.0: "min mins minute minutes", 3600.0: "h hr hrs hour hours", 86400.0: "d day days",
}  # fmt: skip
UNITS = {word: seconds for seconds, words in WORDS.items() for word in words.split()}  # of time, in s


def symbol(plant: Plant, name: str) -> str:
    """A state, an input or D_hat without its unit: the label that the plant declares, else its name in letters.

    Where the plant declares its delay, D_hat is that delay now.
    """
    if name == "D_hat":
        return HORIZON if plant.declares_delay else D_HAT
    return raised(plant.labels.get(name) or spelt(name))


def quantity(plant: Plant, name: str) -> str:
    """The same with its unit in brackets: θ (rad)."""
    unit = plant.time_unit if name == "D_hat" else plant.units.get(name, "")
    return with_unit(symbol(plant, name), unit)


def timed(plant: Plant, text: str) -> str:
    """A time or a delay with the plant's unit of time: t (s)."""
    return with_unit(text, plant.time_unit)


def common_unit(plant: Plant, names: tuple[str, ...], otherwise: str = "") -> str:
    """The unit that all of these have, where a norm of them has one."""
    units = {plant.units.get(name, "") for name in names}
    return raised(units.pop()) or otherwise if len(units) == 1 else otherwise


def with_unit(text: str, unit: str) -> str:
    """The text and, in brackets, the unit, where there is one."""
    return f"{text} ({raised(unit)})" if unit else text


def spelt(name: str) -> str:
    """A declared name in the letters that it spells: x1 as x_{1}, theta_in as θ_{in}; any other as it is."""
    parts = NAME.fullmatch(name)
    if not parts:
        return name
    letter, number, word = parts.groups()
    below = number or (word and _greek(word))
    return _greek(letter) + (f"_{{{below}}}" if below else "")


def _greek(word: str) -> str:
    """theta as θ, Theta as Θ, any other word as it is."""
    return lookup(f"GREEK {'SMALL' if word.islower() else 'CAPITAL'} LETTER {word}") if LETTER.fullmatch(word) else word


SUBSCRIPT = re.compile(r"_\{((?:[^\W_]|[ ,.+*/-])+)\}")  # what every medium can set as it is
POWER = re.compile(r"\^\{?([-−]?\d+)\}?")
SUPERSCRIPTS = str.maketrans("-−0123456789", "⁻⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
LOWERED = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
PLAIN = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
RAISED = re.compile("[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+")


def plain(text: str) -> str:
    """For terminals, CSV and screen readers: x₁, ε_κ."""
    return SUBSCRIPT.sub(lambda part: part[1].translate(LOWERED) if part[1].isdecimal() else f"_{part[1]}", text)


def markup(text: str) -> str:
    """As HTML, escaped."""
    return SUBSCRIPT.sub(r"<sub>\1</sub>", html.escape(text))


def mathematics(text: str) -> str:
    """For matplotlib's mathematics: hats, subscripts and raised digits, for fonts that lack the letters."""
    text = SUBSCRIPT.sub(lambda part: r"$_{\mathrm{" + part[1].replace(" ", r"\ ") + "}}$", text)
    text = RAISED.sub(lambda part: f"$^{{{part[0].translate(PLAIN)}}}$", text)
    return text.replace("D̂", r"$\hat{D}$").replace("P̂", r"$\hat{P}$")


def raised(text: str) -> str:
    """s^-1 as s⁻¹."""
    return POWER.sub(lambda part: part[1].translate(SUPERSCRIPTS), text)
