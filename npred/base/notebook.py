"""The text that a notebook shows of plants, predictors, controllers, loops and results, escaped."""

import html


def preformatted(text: str) -> str:
    """The text as HTML, its lines as they are."""
    return f'<pre style="white-space: pre-wrap">{html.escape(text)}</pre>'


class InNotebook:
    """An object that a notebook shows as `print` does."""

    def _repr_html_(self) -> str:
        return preformatted(str(self))
