"""The moving bodies of a URDF file: a tree, with what is fixed or locked merged into what carries it."""

import math
import os
import re
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypedDict
from xml.etree import ElementTree

import numpy as np

from npred.base import array_checks, json_files
from npred.base.errors import ConfigError, unlisted
from npred.formulas import array_math
from npred_robots import rigid_body
from npred_robots.rigid_body import Body, Mimic

LARGEST = 2**20  # bytes of a file: a chain has kilobytes, its meshes are elsewhere and not read
EXPAND = "run xacro FILE > robot.urdf, and give that file"
ROUNDING = 1e-6  # share of an inertia that its digits leave open
MOTORS = ("transmission/joint", "ros2_control/joint[command_interface]")  # what names a joint with a motor
OF = "{npred}of"  # an attribute that no file has: the link or joint that an element belongs to, for messages
LOOPS = ("loop_joint", "gazebo/joint")  # Drake's and Gazebo's ways to tie two links of a tree together
MOVING = {"revolute": False, "continuous": False, "prismatic": True}  # whether the joint slides


Locks = Iterable[str] | Mapping[str, float]


class Options(TypedDict, total=False):
    """How a file is read: see `read`."""

    tip: str | None
    lock: Locks
    actuated: Iterable[str] | None
    mounted: bool


def read(
    path: str | Path, tip: str | None = None, lock: Locks = (), actuated: Iterable[str] | None = None,
    mounted: bool = False,
) -> list[Body]:  # fmt: skip
    """The moving bodies, each after the one that carries it; along a chain from the base to the tip.

    Joints that mimic another move with it. Meshes, limits of velocity and the reductions of transmissions are not read;
    dry friction is left out, with a warning.

    Parameters
    ----------
    path : str or Path
        A URDF file of revolute, continuous, prismatic and fixed joints.
    tip : str, optional
        The last link of the arm: joints that do not lead to it are locked, those of a gripper say.
    lock : names, or dict name -> position
        Joints that do not move; without a position they stand where they are closest to 0.
    actuated : names, optional
        The joints with a motor. By default those of the file's <transmission> and <ros2_control>, all of a file that
        has neither; less those of effort 0.
    mounted : bool
        True for a heavy base with several limbs that is bound to the ground: it may as well walk, drive or fly.

    Raises
    ------
    ConfigError
        In one line that names the file and the joint or link, for what is no such tree, and for what no body can be.
    """
    path = Path(path)
    root = _parsed(path)
    try:
        tree = _Tree(root)
        tree.lock(tip, lock)
        bodies = tree.bodies(mounted or tip is not None)
        tree.check_inertias(bodies)
        tree.warn_of_friction(path, bodies)
        return tree.driven(path, bodies, actuated)
    except _Wrong as error:
        raise ConfigError("; ".join(filter(None, (f"{path}: {error}", error.cure)))) from None


def names_of(names: Iterable[str]) -> tuple[str, ...]:
    """The names; one may stand alone."""
    return (names,) if isinstance(names, str) else tuple(names)


class _Wrong(ValueError):
    """A mistake in the file, without the file's name, and what to do."""

    def __init__(self, message: str, cure: str = "fix the file") -> None:
        super().__init__(message)
        self.cure = cure


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
        if b"<xacro:" in text and "unbound prefix" in str(error):
            raise ConfigError(f"{path}: expected URDF, got xacro, a template; {EXPAND}") from None
        raise ConfigError(f"{path}: expected XML, got: {error}; edit that line") from None


def _check_expanded(root: ElementTree.Element) -> None:
    """Raise _Wrong for a xacro file, which is a template."""
    for element in root.iter():
        if "xacro}" in element.tag or any("${" in value for value in element.attrib.values()):
            tag = re.sub(r".*xacro}", "xacro:", element.tag)
            raise _Wrong(f"expected URDF, got xacro, a template, in <{tag}>", EXPAND)


def _by_name(root: ElementTree.Element, tag: str) -> dict[str, ElementTree.Element]:
    parts: dict[str, ElementTree.Element] = {}
    for part in root.findall(tag):
        if parts.setdefault(_attribute(part, "name"), part) is not part:
            raise _Wrong(f"expected different names, got two {tag}s {_attribute(part, 'name')}", f"rename one {tag}")
    return parts


class _Tree:
    """Links and joints by name, which joints leave each link, and the positions of those that are locked."""

    def __init__(self, root: ElementTree.Element) -> None:
        _check_expanded(root)
        for whole in root:
            for part in whole.iter():
                part.set(OF, f"{whole.tag} {whole.get('name', '')}: " if part is not whole else "")
        if root.tag != "robot":
            raise _Wrong(f"expected a <robot>, got <{root.tag}>")
        self.links, self.joints = _by_name(root, "link"), _by_name(root, "joint")
        self.ends: dict[str, tuple[str, str]] = {}  # of a joint: the links before and behind it
        self.leaving: dict[str, list[str]] = {name: [] for name in self.links}
        self.above: dict[str, str] = {}  # the joint that carries a link
        for name, joint in self.joints.items():
            parent, child = (_attribute(_part(joint, end), "link") for end in ("parent", "child"))
            self.ends[name] = parent, child
            for link in (parent, child):
                if link not in self.links:
                    raise _Wrong(f"joint {name} names a link {link!r} that is not there")
            if child in self.above:
                raise _Wrong(f"link {child} hangs on two joints")
            self.above[child] = name
            self.leaving[parent].append(name)
        for part in (part for way in LOOPS for part in root.iterfind(way)):
            raise _Wrong(
                f"expected a tree, got <{part.tag}> {part.get('name', '')}, which closes a loop", "take it out"
            )
        if not self.links:
            raise _Wrong("expected links, found none")
        bases = [name for name in self.links if name not in self.above]
        if len(bases) != 1:
            raise _Wrong(f"expected one base link, found {', '.join(bases) or 'none'}")
        self.base = bases[0]
        self.locked = {name: 0.0 for name, joint in self.joints.items() if joint.get("type") == "fixed"}
        motors = [joint for way in MOTORS for joint in root.iterfind(way)]
        self.motors = {_attribute(joint, "name") for joint in motors} if motors else set(self.joints)

    def lock(self, tip: str | None, lock: Locks) -> None:
        """Lock these joints, all that do not lead to the tip, and those that mimic one of them."""
        positions = dict(lock) if isinstance(lock, Mapping) else dict.fromkeys(names_of(lock))
        self._check_names("lock", positions)
        if tip is not None:
            if tip not in self.links:
                raise _Wrong(unlisted("tip", tip, self.links, "one of the links"), "")
            on_the_way, link = set[str](), tip
            while link in self.above and self.above[link] not in on_the_way:
                on_the_way.add(self.above[link])
                link = self.ends[self.above[link]][0]
            positions = dict.fromkeys(name for name in self.joints if name not in on_the_way) | positions
        free = {name for name, joint in self.joints.items() if joint.find("mimic") is None}
        for name, position in positions.items():
            if position is not None or name in free:
                low, high = _range(self.joints[name])
                at = min(max(0.0, low), high) if position is None else position
                array_checks.finite(f"lock: {name}", np.array(position := array_checks.number(f"lock: {name}", at)))
                self.locked.setdefault(name, position)
        for name in self.joints:
            leader, ratio, offset = self._followed(name) or (name, 1.0, 0.0)
            if leader in self.locked:
                self.locked.setdefault(name, ratio * self.locked[leader] + offset)
            elif name in positions:  # it mimics a joint that moves
                self.locked[name] = 0.0

    def _check_names(self, option: str, names: Iterable[str]) -> None:
        for name in names:
            if name not in self.joints:
                raise _Wrong(unlisted(option, name, self.joints, "names of joints:"), "")

    def _followed(self, name: str) -> tuple[str, float, float] | None:
        """What a joint mimics, with ratio and offset; of a row of such joints, the first that moves by itself."""
        leader, ratio, offset, row = name, 1.0, 0.0, [name]
        while leader not in self.locked and (mimic := self.joints[leader].find("mimic")) is not None:
            leader = _attribute(mimic, "joint")
            if leader not in self.joints:
                raise _Wrong(f"joint {name} mimics a joint {leader!r} that is not there")
            if leader in row:
                raise _Wrong(f"joints {', '.join(row)} mimic each other")
            offset += ratio * _number(mimic, "offset", 0.0)
            ratio *= _number(mimic, "multiplier", 1.0)
            row.append(leader)
        return None if leader == name else (leader, ratio, offset)

    def bodies(self, mounted: bool) -> list[Body]:
        """Each after the one that carries it."""
        reached: set[str] = set()
        carried, leaving = self._rigid(self.base, reached)
        if len(leaving) > 1 and not mounted and self.base != "world" and (mass := sum(m for m, _, _ in carried)) > 0:
            limbs = ", ".join(name for name, _, _ in leaving)
            what = f"expected an arm, got a base {self.base} of {mass:g} kg that {limbs} move against"
            raise _Wrong(what, "mounted=True if it is fixed to the ground (walking, driving or flying is not "
                         "supported), tip=LINK for one arm of it")  # fmt: skip
        waiting = [(-1, *joint) for joint in reversed(leaving)]
        moving: list[tuple[int, str, np.ndarray, np.ndarray, list[Any]]] = []
        while waiting:
            parent, name, turn, position = waiting.pop()
            inertials, leaving = self._rigid(self.ends[name][1], reached)
            waiting += [(len(moving), *joint) for joint in reversed(leaving)]
            moving.append((parent, name, turn, position, inertials))
        if not moving:
            raise _Wrong("expected a joint that moves, found none")
        if astray := ", ".join(sorted(set(self.links) - reached)):
            raise _Wrong(f"expected every link to hang on {self.base}, found a ring of {astray}")
        if not any(inertials for *_, inertials in moving):
            raise _Wrong("expected links with an <inertial>, got none: a drawing", "write the masses")
        numbers = {name: i for i, (_, name, *_) in enumerate(moving)}
        bodies: list[Body] = []
        for parent, name, turn, position, inertials in moving:
            followed = self._followed(name)
            mimic = Mimic(numbers[followed[0]], *followed[1:]) if followed else None
            bodies.append(_body(self.joints[name], turn, position, inertials, parent, mimic))
        return self._within(bodies)

    def _rigid(self, base: str, reached: set[str]) -> tuple[list[Any], list[tuple[str, np.ndarray, np.ndarray]]]:
        """Inertias of the link and all that does not move against it, and the joints that leave it, in its frame."""
        inertials, leaving, fixed = [], [], [(base, np.eye(3), np.zeros(3))]
        for link, turn, position in fixed:  # which grows meanwhile
            reached.add(link)
            inertials += (inertial := _inertial(self.links[link], turn, position))
            for mass, _, inertia in inertial if base != self.base else ():  # the base's are not used
                _check_physical(link, mass, inertia)
            for name in self.leaving[link]:
                local, offset = _origin(self.joints[name])
                there = turn @ local, position + turn @ offset
                if name in self.locked:
                    fixed.append((self.ends[name][1], *_shifted(self.joints[name], *there, self.locked[name])))
                else:
                    leaving.append((name, *there))
        return inertials, leaving

    def _within(self, bodies: list[Body]) -> list[Body]:
        """The bodies with ranges that the joints which mimic them keep too, where there are such."""
        for body in bodies:
            if body.mimic and body.mimic.ratio:
                leader, ratio, offset = bodies[body.mimic.body], body.mimic.ratio, body.mimic.offset
                ends = sorted(((body.lower - offset) / ratio, (body.upper - offset) / ratio))
                low, high = max(leader.lower, ends[0]), min(leader.upper, ends[1])
                if low < high:
                    bodies[body.mimic.body] = replace(leader, lower=low, upper=high)
        return bodies

    def check_inertias(self, bodies: list[Body]) -> None:
        """Raise _Wrong for a joint that moves no mass: it would have every acceleration. Eliminated from the tips on.

        At positions without a symmetry; a link without a mass is no mistake where one behind it has some.
        """
        joints = rigid_body.leaders(bodies)
        q = np.random.default_rng(0).uniform(-1.0, 1.0, len(joints)).tolist()
        H = np.array(rigid_body.mass_matrix(bodies, q, array_math.NUMPY))
        for i, whole in reversed(list(enumerate(np.diag(H).tolist()))):
            if not H[i, i] > 1e-10 * whole:
                name = joints[i].joint
                part = "mass" if joints[i].slides else "inertia about its axis"
                what = f"joint {name}: expected a link {self.ends[name][1]} with {part} above 0, got {whole:.3g}"
                raise _Wrong(what, f"write its <inertial>, or lock=({name!r},)")
            H[:i, :i] -= np.outer(H[:i, i], H[:i, i]) / H[i, i]

    def warn_of_friction(self, path: Path, bodies: list[Body]) -> None:
        """Say which joints that move have dry friction, which f does not."""
        dynamics = [(body.joint, self.joints[body.joint].find("dynamics")) for body in bodies]
        rubbing = [(name, _number(part, "friction", 0.0)) for name, part in dynamics if part is not None]
        for name, friction in rubbing:
            if friction < 0:
                raise _Wrong(f"joint {name}: expected a friction of at least 0, got {friction:g}")
        if names := ", ".join(name for name, friction in rubbing if friction):
            left = f"dry friction of {names} left out; npred simulates joints, motors, damping and gravity"
            warnings.warn(f"{path}: {left}", stacklevel=4)

    def driven(self, path: Path, bodies: list[Body], actuated: Iterable[str] | None) -> list[Body]:
        """The bodies with an effort of 0 where the joint has no motor, and without a limit where only `actuated` says
        that there is one. Warns where an effort speaks against the transmissions.
        """
        if actuated is not None:
            names = set(names_of(actuated))
            self._check_names("actuated", names)
            if still := ", ".join(sorted(names - {body.joint for body in rigid_body.leaders(bodies)})):
                raise _Wrong(f"actuated: expected joints that move by themselves, got {still}", "leave them out")
            efforts = [(body.effort or math.inf) if body.joint in names else 0.0 for body in bodies]
        else:
            efforts = [body.effort if body.joint in self.motors else 0.0 for body in bodies]
            idle = [
                b.joint for b in rigid_body.leaders(bodies) if b.joint not in self.motors and 0 < b.effort < math.inf
            ]
            if idle:
                what = f"{', '.join(idle)} with an effort but without a transmission taken as joints without a motor"
                warnings.warn(f"{path}: {what}; name all that have one: actuated=(…)", stacklevel=4)
        driven = [replace(body, effort=effort) for body, effort in zip(bodies, efforts, strict=True)]
        if not any(body.effort for body in rigid_body.leaders(driven)):
            what = "expected a joint with a motor, got effort 0, or no transmission, for all that move"
            raise _Wrong(what, f"name them: actuated=({driven[0].joint!r},)")
        return driven


def _body(
    joint: ElementTree.Element, turn: np.ndarray, position: np.ndarray, inertials: list[Any], parent: int,
    mimic: Mimic | None,
) -> Body:  # fmt: skip
    name, kind = _attribute(joint, "name"), joint.get("type", "")
    if kind == "floating":
        cure = f"lock=({name!r},) if it is mounted; walking, driving or flying is not supported"
        raise _Wrong(f"joint {name}: expected an arm, got a base that floats", cure)
    if kind not in MOVING:
        raise _Wrong(unlisted(f"joint {name}", kind, (*MOVING, "fixed"), "a type of"), f"or lock=({name!r},)")
    mass = sum(m for m, _, _ in inertials)
    centre = np.sum([m * c for m, c, _ in inertials], axis=0) / mass if mass else np.zeros(3)
    steiner = [
        m * ((c - centre) @ (c - centre) * np.eye(3) - np.outer(c - centre, c - centre)) for m, c, _ in inertials
    ]
    damping, effort = joint.find("dynamics"), joint.find("limit")
    largest = math.inf if effort is None else _number(effort, "effort", math.inf)
    if largest < 0:
        raise _Wrong(f"joint {name}: expected an effort of at least 0, got {largest:g}")
    rubs = 0.0 if damping is None else _number(damping, "damping", 0.0)
    if rubs < 0:
        raise _Wrong(f"joint {name}: expected a damping of at least 0, got {rubs:g}")
    low, high = _range(joint)
    return Body(
        joint=name, slides=MOVING[kind], turn=turn, position=position, axis=_axis(joint),
        mass=mass, centre=centre, inertia=sum((i for _, _, i in inertials), start=np.zeros((3, 3))) + sum(steiner),
        damping=rubs, effort=largest, parent=parent,
        lower=low, upper=high, mimic=mimic,
    )  # fmt: skip


def _check_physical(link: str, mass: float, inertia: np.ndarray) -> None:
    """Raise _Wrong for what no body can have."""
    moments = np.linalg.eigvalsh(inertia)
    if mass < 0:
        raise _Wrong(f"link {link}: expected a mass of at least 0 kg, got {mass:g}")
    if moments[0] < -ROUNDING * abs(moments[2]) - 1e-12:
        got = ", ".join(f"{moment:.3g}" for moment in moments)
        raise _Wrong(f"link {link}: expected principal moments of inertia of at least 0 kg m², got {got}")


def _axis(joint: ElementTree.Element) -> np.ndarray:
    axis = joint.find("axis")
    direction = np.array([1.0, 0.0, 0.0]) if axis is None else _numbers(axis, "xyz", 3)
    if not np.linalg.norm(direction) > 0:
        raise _Wrong(f"joint {_attribute(joint, 'name')}: expected an axis, got one of length 0")
    return direction / np.linalg.norm(direction)


def _range(joint: ElementTree.Element) -> tuple[float, float]:
    """The positions between which a joint stays; a range without a width, as many files write for none, is none."""
    limit, kind = joint.find("limit"), joint.get("type", "")
    low, high = (0.0, 0.0) if limit is None else (_number(limit, end, 0.0) for end in ("lower", "upper"))
    return (low, high) if low < high and kind in MOVING and kind != "continuous" else (-math.inf, math.inf)


def _shifted(
    joint: ElementTree.Element, turn: np.ndarray, position: np.ndarray, at: float
) -> tuple[np.ndarray, np.ndarray]:
    """Turn and position behind a joint that stands at that position."""
    if not at or joint.get("type") not in MOVING:
        return turn, position
    axis = _axis(joint)
    if MOVING[joint.get("type", "")]:
        return turn, position + turn @ axis * at
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return turn @ (np.eye(3) + math.sin(at) * K + (1 - math.cos(at)) * K @ K), position


def _inertial(link: ElementTree.Element, turn: np.ndarray, position: np.ndarray) -> list[Any]:
    """[(mass, centre, inertia about the centre)] of a link, in the frame it is seen from; [] for one without."""
    part = link.find("inertial")
    if part is None:
        return []
    local, offset = _origin(part)
    inertia = _part(part, "inertia")
    xx, xy, xz, yy, yz, zz = (_number(inertia, f"i{k}") for k in ("xx", "xy", "xz", "yy", "yz", "zz"))
    frame, about = turn @ local, np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    mass = _number(_part(part, "mass"), "value")
    return [(mass, position + turn @ offset, frame @ about @ frame.T)]


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
        raise _Wrong(f"{_owned(element)}: expected a <{tag}>, found none")
    return part


def _owned(element: ElementTree.Element) -> str:
    """An element in words: link arm: <inertia>."""
    name = f" name={element.get('name')!r}" if element.get("name") else ""
    return f"{element.get(OF, '')}<{element.tag}{name}>"


def _attribute(element: ElementTree.Element, name: str) -> str:
    value = element.get(name)
    if value is None:
        raise _Wrong(f"{_owned(element)}: expected an attribute {name}, found none")
    return value


def _numbers(element: ElementTree.Element, name: str, count: int) -> np.ndarray:
    text = element.get(name, " ".join(["0"] * count))
    if not re.fullmatch(r"\s*" + r"\s+".join([r"[-+.\deE]+"] * count) + r"\s*", text):
        raise _Wrong(f"{_owned(element)}: {name} expected {count} numbers, got {text!r}")
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
        raise _Wrong(f"{_owned(element)}: {name} expected a finite number, got {text!r}")
    return value
