"""What pydantic found wrong, in the words of every other message: what was expected, what came, what to do."""

from typing import Any

TABLE = ("a table", "write keys and values")
EXPECTED = {  # by pydantic's name of the error; in braces the limit that it gives
    "missing": ("a value", "write it"),
    "extra_forbidden": ("no such key", "remove it"),
    **dict.fromkeys(("float_type", "float_parsing"), ("a number", "write one, without quotes")),
    **dict.fromkeys(("int_type", "int_parsing"), ("a whole number", "write one, without a point and quotes")),
    "int_from_float": ("a whole number", "round it"),
    **dict.fromkeys(("bool_type", "bool_parsing"), ("true or false", "write one of them, without quotes")),
    "string_type": ("a text", "put it in quotes"),
    "list_type": ("a list", "put it in brackets"),
    "tuple_type": ("a list", "put it in brackets"),
    **dict.fromkeys(("dict_type", "model_type", "model_attributes_type", "dataclass_type"), TABLE),
    "finite_number": ("a finite number", "write one"),
    "greater_than": ("a number above {gt:g}", "raise it"),
    "greater_than_equal": ("at least {ge}", "raise it"),
    "less_than": ("a number below {lt:g}", "lower it"),
    "less_than_equal": ("at most {le}", "lower it"),
    "too_short": ("at least {min_length} in the list", "write more"),
    "too_long": ("at most {max_length} in the list", "write fewer"),
    "string_too_short": ("a text of at least {min_length} letters", "write a longer one"),
    "string_too_long": ("a text of at most {max_length} letters", "write a shorter one"),
    "literal_error": ("{expected}", "choose one"),
}


def expected(error: Any) -> tuple[str, str]:
    """What an item of ValidationError.errors() expected, and what to do; what npred refuses says it itself."""
    if error["type"] not in EXPECTED:
        said, _, cure = error["msg"].removeprefix("Value error, ").removeprefix("expected ").partition("; ")
        return said.partition(", got ")[0], cure
    words, cure = EXPECTED[error["type"]]
    return words.format(**error.get("ctx", {})), cure
