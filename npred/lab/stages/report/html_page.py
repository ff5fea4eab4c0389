"""A page that needs nothing else: a template of the report filled in, its style and its script in it."""

from importlib.resources import files
from typing import Any

from npred.lab.report.figures.figure import inline
from npred.lab.report.figures.style import ROLES
from npred.plants.notation import markup


def filled(template: str, **values: Any) -> str:
    """The page of a template's text for these values; the same values give the same bytes."""
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    loader = PackageLoader("npred.lab.report")
    environment = Environment(loader=loader, autoescape=True, undefined=StrictUndefined)
    environment.trim_blocks = environment.lstrip_blocks = True
    environment.filters["typeset"] = lambda text: Markup(markup(text))  # markup escapes
    environment.globals["drawn"] = lambda panel, name: Markup(inline(panel, name))
    page = environment.from_string(template)
    return page.render(roles=ROLES, style=text("page.css"), script=text("page.js"), **values)


def text(name: str) -> str:
    """A file of npred's templates for pages."""
    return (files("npred.lab.report") / "templates" / name).read_text(encoding="utf-8")
