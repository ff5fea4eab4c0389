"""A serial chain from a URDF file: its moving bodies, with the fixed ones merged into them."""

import math
import os
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from npred.base import json_files
from npred.base.errors import ConfigError, unlisted
from npred_robots.rigid_body import Body

LARGEST = 2**20  # bytes of a file: a chain has kilobytes, its meshes are elsewhere and not read
MOVING = {"revolute": False, "continuous": False, "prismatic": True}  # whether the joint slides


def read(path: str | Path) -> list[Body]:
    """The moving bodies from the base to the tip.

    Raises ConfigError, in one line that names the file and the joint or link, for what is no chain of revolute,
    continuous, prismatic and fixed joints, or misses a mass. Limits, friction, meshes and transmissions are not read,
    but for `effort`.
    """
    path = Path(path)
    root = _parsed(path)
    try:
        return _Tree(root).bodies()
    except _Wrong as error:
        raise ConfigError(f"{path}: {error}; fix the file") from None


class _Wrong(ValueError):
    """A mistake in the file, without the file's name."""


def _parsed(path: Path) -> ElementTree.Element:
    try:
        text = json_files.read(Path(os.path.realpath(path)), LARGEST)
    except OSError as error:
        raise ConfigError(f"{path}: expected a URDF file, got: {error.strerror}; check the path") from None
    except ValueError as error:
        raise ConfigError(
            f"{path}: expected a URDF file of at most {LARGEST} bytes, got: {error}; is it one?"
        ) from None
    if b"\0" in text:  # UTF-16 and UTF-32, in which a DOCTYPE would not be seen
        raise ConfigError(f"{path}: expected a URDF file in UTF-8, got zero bytes; save it as UTF-8")
    if b"<!DOCTYPE" in text or b"<!ENTITY" in text:
        raise ConfigError(f"{path}: expected a URDF file without DOCTYPE and ENTITY, got one; remove them")
    try:
        return ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise ConfigError(f"{path}: expected XML, got: {error}; edit that line") from None


class _Tree:
    """Links and joints by name, and which joints leave each link."""

    def __init__(self, root: ElementTree.Element) -> None:
        if root.tag != "robot":
            raise _Wrong(f"expected a <robot>, got <{root.tag}>")
        self.links = {_attribute(link, "name"): link for link in root.findall("link")}
        self.leaving: dict[str, list[ElementTree.Element]] = {name: [] for name in self.links}
        children = set()
        for joint in root.findall("joint"):
            parent, child = (_attribute(_part(joint, end), "link") for end in ("parent", "child"))
            for name in (parent, child):
                if name not in self.links:
                    raise _Wrong(f"joint {_attribute(joint, 'name')} names a link {name!r} that is not there")
            if child in children:
                raise _Wrong(f"link {child} hangs on two joints")
            children.add(child)
            self.leaving[parent].append(joint)
        bases = [name for name in self.links if name not in children]
        if len(bases) != 1:
            raise _Wrong(f"expected one base link, found {', '.join(bases) or 'none'}")
        self.base = bases[0]

    def bodies(self) -> list[Body]:
        """From the base to the tip."""
        chain: list[Body] = []
        self.reached: set[str] = set()
        _, leaving = self._rigid(self.base)
        while leaving:
            if len(leaving) > 1:
                names = ", ".join(_attribute(joint, "name") for joint, _, _ in leaving)
                raise _Wrong(f"expected a serial chain, but it branches at the joints {names}")
            joint, turn, position = leaving[0]
            inertial, leaving = self._rigid(_attribute(_part(joint, "child"), "link"))
            chain.append(_body(joint, turn, position, inertial))
        if not chain:
            raise _Wrong("expected a joint that moves, found none")
        astray = ", ".join(sorted(set(self.links) - self.reached))
        if astray:
            raise _Wrong(f"expected every link to hang on {self.base}, found a ring of {astray}")
        return chain

    def _rigid(self, base: str) -> tuple[list[Any], list[Any]]:
        """Inertias of the link and all that is fixed to it, and the moving joints that leave it, in its frame."""
        inertials, leaving, fixed = [], [], [(base, np.eye(3), np.zeros(3))]
        for link, turn, position in fixed:  # which grows meanwhile
            self.reached.add(link)
            inertials += _inertial(self.links[link], turn, position)
            for joint in self.leaving[link]:
                local, offset = _origin(joint)
                there = turn @ local, position + turn @ offset
                if joint.get("type") == "fixed":
                    fixed.append((_attribute(_part(joint, "child"), "link"), *there))
                else:
                    leaving.append((joint, *there))
        return inertials, leaving


def _body(joint: ElementTree.Element, turn: np.ndarray, position: np.ndarray, inertials: list[Any]) -> Body:
    name, kind = _attribute(joint, "name"), joint.get("type", "")
    if kind not in MOVING:
        raise _Wrong(unlisted(f"joint {name}", kind, (*MOVING, "fixed"), "a type of"))
    mass = sum(m for m, _, _ in inertials)
    if not mass > 0:
        raise _Wrong(f"joint {name}: expected a link with a mass above 0 kg, got {mass:g}")
    centre = np.sum([m * c for m, c, _ in inertials], axis=0) / mass
    steiner = [
        m * ((c - centre) @ (c - centre) * np.eye(3) - np.outer(c - centre, c - centre)) for m, c, _ in inertials
    ]
    axis = joint.find("axis")
    direction = np.array([1.0, 0.0, 0.0]) if axis is None else _numbers(axis, "xyz", 3)
    if not np.linalg.norm(direction) > 0:
        raise _Wrong(f"joint {name}: expected an axis, got one of length 0")
    damping, effort = joint.find("dynamics"), joint.find("limit")
    return Body(
        joint=name, slides=MOVING[kind], turn=turn, position=position, axis=direction / np.linalg.norm(direction),
        mass=mass, centre=centre, inertia=sum((i for _, _, i in inertials), start=np.zeros((3, 3))) + sum(steiner),
        damping=0.0 if damping is None else _number(damping, "damping", 0.0),
        effort=math.inf if effort is None else _number(effort, "effort", math.inf) or math.inf,
    )  # fmt: skip


def _inertial(link: ElementTree.Element, turn: np.ndarray, position: np.ndarray) -> list[Any]:
    """[(mass, centre, inertia about the centre)] of a link, in the frame it is seen from; [] for one without."""
    part = link.find("inertial")
    if part is None:
        return []
    local, offset = _origin(part)
    inertia = _part(part, "inertia")
    xx, xy, xz, yy, yz, zz = (_number(inertia, f"i{k}") for k in ("xx", "xy", "xz", "yy", "yz", "zz"))
    frame, about = turn @ local, np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return [(_number(_part(part, "mass"), "value"), position + turn @ offset, frame @ about @ frame.T)]


def _origin(element: ElementTree.Element) -> tuple[np.ndarray, np.ndarray]:
    """Turn (3, 3) and position (3,) of an <origin>: roll, pitch and yaw about fixed axes."""
    origin = element.find("origin")
    if origin is None:
        return np.eye(3), np.zeros(3)
    (a, b, c), position = (_numbers(origin, name, 3) for name in ("rpy", "xyz"))
    x = np.array([[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]])
    y = np.array([[math.cos(b), 0, math.sin(b)], [0, 1, 0], [-math.sin(b), 0, math.cos(b)]])
    z = np.array([[math.cos(c), -math.sin(c), 0], [math.sin(c), math.cos(c), 0], [0, 0, 1]])
    return z @ y @ x, position


def _part(element: ElementTree.Element, tag: str) -> ElementTree.Element:
    part = element.find(tag)
    if part is None:
        raise _Wrong(f"{element.tag} {element.get('name', '')}: expected a <{tag}>, found none".replace(" :", ":"))
    return part


def _attribute(element: ElementTree.Element, name: str) -> str:
    value = element.get(name)
    if value is None:
        raise _Wrong(f"<{element.tag}>: expected an attribute {name}, found none")
    return value


def _numbers(element: ElementTree.Element, name: str, count: int) -> np.ndarray:
    text = element.get(name, " ".join(["0"] * count))
    if not re.fullmatch(r"\s*" + r"\s+".join([r"[-+.\deE]+"] * count) + r"\s*", text):
        raise _Wrong(f"<{element.tag}>: {name} expected {count} numbers, got {text!r}")
    return np.array([_float(element, name, word) for word in text.split()])


def _number(element: ElementTree.Element, name: str, default: float | None = None) -> float:
    if default is not None and element.get(name) is None:
        return default
    return _float(element, name, _attribute(element, name))


def _float(element: ElementTree.Element, name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise _Wrong(f"<{element.tag}>: {name} expected a finite number, got {text!r}")
    return value
