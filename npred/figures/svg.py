"""A panel as inline SVG for a page: colours as CSS variables, text as text, unique identifiers, a description."""

import io
import re
from xml.etree import ElementTree

from npred.figures.figure import Panel, canvas, draw
from npred.figures.notation import SUBSCRIPT, plain
from npred.figures.style import ROLES, SCREEN, medium

SVG = "http://www.w3.org/2000/svg"
LINK = "{http://www.w3.org/1999/xlink}href"
COLOURS = {light: role for role, (light, _) in ROLES.items()}
SHARED = re.compile(r"url\(#([^)]+)\)")


def inline(panel: Panel, prefix: str) -> str:
    """The panel as an <svg> element; `prefix` makes its identifiers unique on the page."""
    buffer = io.StringIO()
    with medium(SCREEN):
        figure = canvas(SCREEN.width, SCREEN.height)
        draw(panel, axis := figure.subplots())
        axis.set_title("")  # the page says it, in its type
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    ElementTree.register_namespace("", SVG)
    root = ElementTree.fromstring(buffer.getvalue())
    _lower(root)
    _tidy(root, prefix)
    _describe(root, panel, prefix)
    return ElementTree.tostring(root, encoding="unicode")


def _lower(root: ElementTree.Element) -> None:
    """The subscripts of texts as spans below the line; what follows one comes back up."""
    for element in [text for text in root.iter(f"{{{SVG}}}text") if SUBSCRIPT.search(text.text or "")]:
        first, *parts = SUBSCRIPT.split(element.text or "")
        element.text = first
        for below, after in zip(parts[::2], parts[1::2], strict=True):
            ElementTree.SubElement(element, f"{{{SVG}}}tspan", {"font-size": "72%", "dy": ".35em"}).text = below
            if after:
                ElementTree.SubElement(element, f"{{{SVG}}}tspan", {"dy": "-.252em"}).text = after


def _tidy(root: ElementTree.Element, prefix: str) -> None:
    for parent in list(root.iter()):
        for child in [c for c in parent if c.tag.endswith("}metadata")]:
            parent.remove(child)
    used = _used(root)
    for element in root.iter():
        if (name := element.attrib.pop("id", None)) in used:
            element.set("id", f"{prefix}-{name}")
        if LINK in element.attrib:  # as href, which HTML reads too
            element.set("href", f"#{prefix}-{element.attrib.pop(LINK)[1:]}")
        for key, value in element.attrib.items():
            element.set(key, _attribute(key, value, prefix))


def _used(root: ElementTree.Element) -> set[str]:
    links = {element.attrib[LINK][1:] for element in root.iter() if LINK in element.attrib}
    return links | {
        name for element in root.iter() for value in element.attrib.values() for name in SHARED.findall(value)
    }


def _attribute(key: str, value: str, prefix: str) -> str:
    """Shorter numbers, themed colours, no font but the page's."""
    value = SHARED.sub(rf"url(#{prefix}-\1)", value)
    if key == "style":
        value = re.sub(r"'DejaVu Sans'[^;]*", "inherit", value)
        return re.sub("|".join(COLOURS), lambda match: f"var(--{COLOURS[match[0]]})", value)
    if key in ("d", "points", "transform", "x", "y"):
        return re.sub(r"-?\d+\.\d+", lambda match: f"{float(match.group()):.2f}".rstrip("0").rstrip("."), value)
    return value


def _describe(root: ElementTree.Element, panel: Panel, prefix: str) -> None:
    """A title and a description, as screen readers find them."""
    for name in ("width", "height"):
        root.attrib.pop(name, None)
    root.attrib |= {"role": "img", "aria-labelledby": f"{prefix}-title {prefix}-desc"}
    for index, (name, text) in enumerate({"title": panel.title, "desc": panel.alt}.items()):
        element = ElementTree.Element(f"{{{SVG}}}{name}", {"id": f"{prefix}-{name}"})
        element.text = plain(text)
        root.insert(index, element)
