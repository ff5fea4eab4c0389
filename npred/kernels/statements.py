"""Lines of a program as statements of C, and the frame of a function that is called."""

import re

from npred.formulas.tape import OPS

TEXTS = {name: op.text.replace("math.", "") for name, op in OPS.items()} | {
    "pow": "pow({0}, {1})", "abs": "fabs({0})", "sign": "sign_of({0})", "where": "{0} != 0 ? {1} : {2}",
    "maximum": "larger({0}, {1})", "minimum": "smaller({0}, {1})", "sin": "sine({0})", "cos": "cosine({0})",
    "floor": "floor({0})", "mod": "modulus({0}, {1})", "interp": "interpolated({0}, {1:c})",
    "logical_and": "({0} != 0) & ({1} != 0)", "logical_or": "({0} != 0) | ({1} != 0)", "logical_not": "{0} == 0",
}  # fmt: skip
NUMBERS = {"(np.inf)": "INFINITY", "(-np.inf)": "-INFINITY", "(np.nan)": "NAN", "True": "1", "False": "0"}
_CONDITION = re.compile(r"\S+ (?:<=?|==) \S+|\(.+\) [&|] \(.+\)")
_TABLE = re.compile(r"(interpolated\(.+), (\{.+\})\)")
_NUMBER = re.compile("|".join(re.escape(text) for text in NUMBERS))
LOOP = "LANES for (int l = 0; l < count; l++) {"
# `count` is one or GROUP, both compiled apart
CALLED = """static INLINED void plant_{name}_of(const int count, double (*q)[GROUP], double (*y)[GROUP])
{{
    {lines}
}}
static APART void plant_{name}_one(double (*q)[GROUP], double (*y)[GROUP])
{{
    plant_{name}_of(1, q, y);
}}
#if GROUP > 1
static APART void plant_{name}_group(double (*q)[GROUP], double (*y)[GROUP])
{{
    plant_{name}_of(GROUP, q, y);
}}
#endif
"""


def statement(line: str) -> str:
    """The C of a line: variables are constants there."""
    left, _, right = line.partition(" = ")
    right = _NUMBER.sub(lambda number: NUMBERS[number[0]], right)
    if not re.fullmatch(r"v\d+", left):
        return f"{left} = {right};"
    if table := _TABLE.fullmatch(right):
        call, numbers = table.groups()
        return f"static const double {left}_rows[] = {numbers}; const double {left} = {call}, {left}_rows);"
    kind = "int" if _CONDITION.fullmatch(right) else "double"
    return f"const {kind} {left} = {right};"
