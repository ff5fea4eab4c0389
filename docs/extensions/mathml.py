"""Formulas as MathML, made when the pages are built: browsers draw it by themselves, with no script and no network."""

import re
from typing import Any
from xml.etree import ElementTree

import latex2mathml.converter
from docutils import nodes
from sphinx.application import Sphinx

NAMESPACE = "http://www.w3.org/1998/Math/MathML"
TAG = re.compile(r"\\tag\{(.+?)\}")


def mathml(text: str, display: str = "inline") -> str:
    """A formula of LaTeX as MathML, its primes no longer small as powers, with room at bars and at cos."""
    ElementTree.register_namespace("", NAMESPACE)
    formula = ElementTree.fromstring(latex2mathml.converter.convert(text, display=display))
    for power in formula.iter(f"{{{NAMESPACE}}}msup"):
        if power[1].text == "′":
            power.tag, power[1].tag = f"{{{NAMESPACE}}}mrow", f"{{{NAMESPACE}}}mo"
            power[1].attrib = {"lspace": "0.05em", "rspace": "0"}
    for sign in formula.iter(f"{{{NAMESPACE}}}mo"):
        if sign.text == "|" and "form" not in sign.attrib:
            sign.attrib = {"stretchy": "false", "lspace": "0", "rspace": "0"}
    for name in formula.iter(f"{{{NAMESPACE}}}mi"):
        if len(name.text or "") > 1:
            name.tag, name.attrib = f"{{{NAMESPACE}}}mo", {"lspace": "0.17em", "rspace": "0.17em"}
    return ElementTree.tostring(formula, encoding="unicode")


def inline(translator: Any, node: nodes.math) -> None:
    """A formula within a line."""
    translator.body.append(mathml(node.astext()))
    raise nodes.SkipNode


def block(translator: Any, node: nodes.math_block) -> None:
    r"""A formula on a separate line, in a box that scrolls where the screen is narrow; \tag gives its number."""
    text = node.astext()
    formula = mathml(TAG.sub("", text), "block")
    number = "".join(f'<span class="number">({tag})</span>' for tag in TAG.findall(text))
    translator.body.append(f'<div class="formula">{formula}{number}</div>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the renderer `mathml`."""
    app.add_html_math_renderer("mathml", (inline, None), (block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
