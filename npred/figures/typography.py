"""Text with mathematics in it, for every medium: `_{…}` is a subscript, D̂ and P̂ have hats, ⁻³ is a raised number."""

import html
import re

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
    text = SUBSCRIPT.sub(_upright, text)
    text = RAISED.sub(lambda part: f"$^{{{part[0].translate(PLAIN)}}}$", text)
    return text.replace("D̂", r"$\hat{D}$").replace("P̂", r"$\hat{P}$")


def _upright(part: re.Match[str]) -> str:
    return r"$_{\mathrm{" + part[1].replace(" ", r"\ ") + "}}$"


def raised(text: str) -> str:
    """s^-1 as s⁻¹."""
    return POWER.sub(lambda part: part[1].translate(SUPERSCRIPTS), text)
