"""Read a URDF into a `Robot` with Pinocchio, which no other module of stiffbench imports.

A description may be a tree: grippers, hands, heads, wheels, second arms. The robot is the chain
from the base to one link, the tip. All other joints are locked, and the links behind them are
merged into the link that carries them; so are joints of the chain that are held at a position, and
mimic joints that follow them. Other mimic joints of the chain move with the joint that they follow
(`Robot.mimics`): their mechanism, such as a parallelogram, is rigid. The default tip is the end of
the longest chain: the chain with most independent joints, without fingers (`_fingers`). Of several
ends, a usual name (`TIP_NAMES`) comes first, then a link that is not a helper (`HELPER_NAMES`),
then the link farthest from the last moving joint, then the largest number of fixed joints before
the end, then the last in the file.

A file is read if ROS and Pinocchio read it, also where it is not strict XML: see `_urdf_text`.
"""

from __future__ import annotations

import codecs
import os
import re
import shlex
import tempfile
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import takewhile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np

from stiff_protocols.contract.controller import Controller
from stiff_protocols.contract.errors import ConfigError, DataError, unknown_name, warn
from stiff_protocols.contract.files import other_content
from stiff_protocols.contract.robot import UNLIMITED_RAD
from stiff_protocols.contract.types import ChainJoint, FloatArray, JointType, Robot
from stiff_protocols.paths.inverse import held_position, joint_number

try:
    import pinocchio as pin
except ImportError as error:  # Windows: what reads no URDF works without it
    pin, WHY_MISSING = None, str(error)

LONGEST_TCP_M = 5.0
"""Limit of a tool's length; a larger number is in mm."""


TIP_NAMES = ("tool0", "tcp", "ee_link", "end_effector", "tool_link", "flange")
"""Usual name endings of an arm's tip, the most usual first."""
HELPER_NAMES = re.compile(
    "_sc$|collision|inerti|visual|camera|optical|imu|lidar|laser|sensor", re.IGNORECASE
)
"""Names of fixed links that are not a flange: copies for collisions or masses, and sensors."""
FINGER_NAMES = re.compile("finger|thumb|jaw|knuckle", re.IGNORECASE)
SLIDING_FINGER_NAMES = re.compile(f"{FINGER_NAMES.pattern}|grip", re.IGNORECASE)
"""Names of fingers' joints; the second, of prismatic joints only: a wrist may turn a gripper."""
LONGEST_FINGER_TRAVEL_M = 0.1
"""A last joint that slides less may be a gripper's."""
DECLARED_ENCODING = re.compile(
    rb"""\s*<\?xml\b[^>]*\bencoding=["']((?:iso|latin|windows|cp|gb|big5|euc|shift|koi)[\w-]*)""",
    re.IGNORECASE,
)
XACRO_ADDRESS = "ros.org/wiki/xacro"
"""End of the address of xacro's elements, also in the older http://www.ros.org/wiki/xacro."""
OTHER_FORMATS = {
    "sdf": "an SDF model",
    "mujoco": "an MJCF model",
    "COLLADA": "a COLLADA mesh",
    "launch": "a ROS launch file",
}
"""Outermost element -> another format."""
MAX_START_SHOWN = 40
"""Characters of a file's first line in an error."""
MAX_NAMED_IN_NOTE, MAX_NAMED_IN_ERROR = 6, 20
"""Largest number of joints or links in a note or an error; a mobile robot has eighty links."""


@dataclass(frozen=True)
class Mimic:
    """The rule of a mimic joint: its position is `multiplier` times `joint`'s, plus `offset`."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class ChainModel:
    """A serial chain as a Pinocchio model and as a `Robot`.

    Attributes:
        model: Pinocchio model, fixed base; mimic joints move in it like others.
        robot: the same chain without Pinocchio.
        notes: choices that the description leaves open, one sentence each.
    """

    model: pin.Model
    robot: Robot
    notes: tuple[str, ...] = ()


def read_chain(
    urdf: Path,
    *,
    tcp: Sequence[float] = (0.0, 0.0, 0.0),
    tip: str | None = None,
    base: str | None = None,
    hold: Mapping[str, float | None] | None = None,
) -> ChainModel:
    """Read the serial chain from the base of a URDF to one of its links.

    Args:
        urdf: the file; its meshes are not needed.
        tcp: (3,) tool centre point in the frame of the tip, m.
        tip: last link of the chain; None: the end of the longest chain, see this module.
        base: link that the chain starts from, and the base frame; None: the URDF's first link.
        hold: joints that do not move: deg or mm by name or number in the chain.

    Raises:
        ConfigError: no link has the name `tip` or `base`, a joint cannot be held, the direction of
            gravity in `base` is open, or Pinocchio is missing.
        DataError: the file is not a URDF, a joint of the chain is neither revolute nor prismatic or
            mimics a joint that is not on the chain, or limits are reversed or in degrees.
    """
    _require_pinocchio()
    tree, mimics, controller = _parse(urdf)
    frame, notes = _chosen_tip(tree, mimics, urdf, tip)
    chain = [*tree.supports[frame.parentJoint]][1:]
    ahead: list[int] = []
    if base is not None:
        base_frame = _link(tree, urdf, base, "base")
        ahead = [*tree.supports[base_frame.parentJoint]][1:]
        if ahead != chain[: len(ahead)]:
            text = f"{base}: the chain to the link {frame.name!r} does not pass it"
            raise ConfigError(f"{urdf}: {text}", "base")
    chain, hold = chain[len(ahead) :], hold or {}
    fixed = _held_joints(tree, mimics, chain, hold, urdf)
    path = [joint for joint in chain if joint not in fixed]
    if not path:
        place = f" between the base and the link {tip or frame.name!r}" * bool(tip or base or hold)
        raise DataError(f"{urdf}: no moving joint{place}; a stiffness model needs at least one")
    names = [tree.names[joint] for joint in path]
    rules = {name: _rule(mimics, name) for name in names if name in mimics}
    for name, rule in rules.items():
        if rule.joint not in names or rule.joint in mimics:
            raise DataError(
                f"{urdf}: joint {name!r} on the chain to {frame.name!r} is a mimic joint, which "
                f"follows {rule.joint!r}; it can follow a joint of the chain, or a joint that "
                f"stands still: --hold {rule.joint}=VALUE"
            )
    offset = np.asarray(tcp, dtype=np.float64)
    if offset.shape != (3,) or not np.isfinite(offset).all() or abs(offset).max() > LONGEST_TCP_M:
        raise DataError(
            f"tcp {list(tcp)}: expected three lengths in m, each within +-{LONGEST_TCP_M:g}; are "
            "these mm?"
        )
    notes += _finger_notes(tree, path)
    positions = _locked_positions(tree, path, fixed)
    if base is not None:
        for joint in ahead:
            tilts = _tilts(tree, joint, positions)
            if tilts and joint not in fixed:
                text = f"its direction of gravity depends on the joint {tree.names[joint]}; hold it"
                raise ConfigError(f"{urdf}: {base}: {text}", "base")
            if joint in fixed and not tilts and len(fixed) == len(hold):  # else another follows it
                text = f"before the base {base} its position changes no number; leave it out"
                raise ConfigError(f"{tree.names[joint]}: {text}", "hold")
    model, lock_note = _with_other_joints_locked(tree, path, positions, {*ahead, *fixed}, mimics)
    start, stand = pin.SE3.Identity(), np.zeros(3)
    for joint in takewhile(lambda joint: joint in fixed and _slides(tree, joint), chain):
        carriage = model.getFrameId(tree.names[joint], pin.FrameType.FIXED_JOINT)
        stand = model.frames[carriage].placement.translation
    if base is not None:
        start = model.frames[model.getFrameId(base_frame.name, pin.FrameType.BODY)].placement
        model.jointPlacements[1] = start.actInv(model.jointPlacements[1])
        model.gravity.linear = start.rotation.T @ model.gravity.linear
        if controller is not None:
            world = start.actInv(pin.SE3(controller.world)).homogeneous
            controller = replace(controller, world=world)
    independent = [joint for joint in (*ahead, *chain) if tree.names[joint] not in mimics]
    if controller is not None and len(controller.signs) == len(independent):
        moves = [joint in path for joint in independent]
        if controller.j3_from_ground and not all(moves[:3]):
            raise DataError(
                f"{urdf}: <controller> counts joint 3 from the ground, and one of joints 1 to 3 "
                "does not move (valid: signs and zeros_deg of the moving joints only)"
            )
        signs, zeros = controller.signs[moves], controller.zeros[moves]
        controller = replace(controller, signs=signs, zeros=zeros)
    flange = model.frames[model.getFrameId(frame.name, pin.FrameType.BODY)].placement
    try:
        robot = replace(
            _robot(model, flange, offset, rules),
            controller=controller,
            held=tuple(_position_text(tree, joint, fixed[joint]) for joint in fixed),
            stand=start.actInv(stand),
        )
    except DataError as error:
        raise DataError(f"{urdf}: {error}") from error
    unlimited = [
        name
        for name, low in zip(robot.joint_names, robot.lower, strict=True)
        if model.joints[model.getJointId(name)].nq == 1 and np.isinf(low)
    ]
    for doubt in filter(None, (robot.mass_doubt, robot.limit_doubt)):
        warn(f"{urdf}: {doubt}")
    notes += [lock_note] if lock_note else []
    followers = [f"{mimic.name} follows {mimics[mimic.name].joint}" for mimic in robot.mimics]
    notes += [f"mimic joints: {_listed(followers)}"] if followers else []
    zero_text = f"limits 0..0, and beyond +-{UNLIMITED_RAD:g} rad, count as none"
    notes += [f"{zero_text}: {_listed(unlimited)}"] if unlimited else []
    return ChainModel(model, robot, tuple(f"{urdf.name}: {note}" for note in notes))


def read_robot(urdf: Path, **options: Any) -> Robot:
    """Read a URDF into a frozen `Robot`; options and errors: see `read_chain`."""
    return read_chain(urdf, **options).robot


def rotation_of(vector: FloatArray) -> FloatArray:
    """Return the (3, 3) rotation of a (3,) rotation vector, rad."""
    _require_pinocchio()
    return np.asarray(pin.exp3(vector))


def roll_pitch_yaw(rotation: FloatArray) -> FloatArray:
    """Return the (3,) angles of a (3, 3) rotation as in a URDF, rad."""
    _require_pinocchio()
    return np.asarray(pin.rpy.matrixToRpy(rotation))


def _require_pinocchio() -> None:
    """Raise ConfigError where Pinocchio cannot be imported."""
    if pin is None:
        raise ConfigError(
            f"Pinocchio reads URDFs, of shipped robots too, and cannot be imported: {WHY_MISSING} "
            "(valid: Linux, macOS or WSL 2 with the package pin, which has no wheel for Windows)"
        )


def _robot(model: pin.Model, flange: pin.SE3, tcp: FloatArray, rules: Mapping[str, Mimic]) -> Robot:
    """Return a chain without Pinocchio; `tcp` (3,) m in the frame of the flange.

    `rules`: mimic joint -> its rule, which names an independent joint.

    Raises:
        DataError: joints, limits or numbers are invalid; Pinocchio also accepts NaN.
    """
    names = [name for name in [*model.names][1:] if name not in rules]
    joints, limits = list[ChainJoint](), dict[str, tuple[float, float]]()
    for joint in range(1, model.njoints):
        name, (kind, axis) = model.names[joint], joint_type_and_axis(model, joint)
        rule = rules.get(name, Mimic(name, 1.0, 0.0))
        inertia = model.inertias[joint]
        joints.append(
            ChainJoint(
                kind,
                tuple(map(tuple, model.jointPlacements[joint].homogeneous.tolist())),
                tuple(axis.tolist()),
                inertia.mass,
                tuple(inertia.lever.tolist()),
                names.index(rule.joint),
                sum(not earlier.name for earlier in joints),
                rule.multiplier,
                rule.offset,
                name if name in rules else "",
            )
        )
        limits[name] = _limits(model, joint)
    for name, (low, high) in limits.items():
        if not low < high:
            raise DataError(
                f"joint {name!r} has limits {low:g}..{high:g}; expected lower below upper (or type "
                "continuous, which has no limits)"
            )
    for name, rule in rules.items():  # the mimic joint's limits are also its master's
        (low, high), ends = limits[rule.joint], np.array(limits[name])
        if rule.multiplier:
            first, last = sorted((ends - rule.offset) / rule.multiplier)
            limits[rule.joint] = low, high = max(low, first), min(high, last)
        if not low < high:
            raise DataError(
                f"the limits of joint {rule.joint!r} and of the mimic joint {name!r}, which "
                "follows it, exclude each other"
            )
    lower, upper = np.transpose([limits[name] for name in names])
    own_joints = [joint for joint in joints if not joint.name]
    return Robot(
        name=model.name,
        joint_names=tuple(names),
        joint_types=tuple(joint.joint_type for joint in own_joints),
        placements=np.array([joint.placement for joint in own_joints]),
        axes=np.array([joint.axis for joint in own_joints]),
        lower=lower,
        upper=upper,
        masses=np.array([joint.mass for joint in own_joints]),
        centres_of_mass=np.array([joint.centre_of_mass for joint in own_joints]),
        tcp=flange.act(tcp),
        gravity=model.gravity.linear,
        flange=flange.homogeneous,
        mimics=tuple(joint for joint in joints if joint.name),
    )


def _parse(urdf: Path) -> tuple[pin.Model, dict[str, Mimic], Controller | None]:
    """Return the tree, what each mimic joint follows, and the controller."""
    try:
        content = urdf.read_bytes()
    except OSError as error:
        reason = error.strerror or error
        raise DataError(f"{urdf}: cannot read the URDF: {reason}") from error
    refused = f"{urdf}: not a robot description (URDF)"
    text = _urdf_text(content)
    root = _root_element(text, refused)
    if reason := _other_format(root, urdf):
        raise DataError(f"{refused}: {reason}")
    _check_description(root, urdf)
    elements = ((joint.get("name", ""), joint.find("mimic")) for joint in root.findall("joint"))
    try:
        with _captured_stderr() as printed:
            model = pin.buildModelFromXML(text)
        if any("Could not parse inertial" in line for line in printed):
            raise ValueError  # the parser gives such a link no mass
        mimics = {
            name: Mimic(
                mimic.get("joint", ""),
                float(mimic.get("multiplier", "1")),
                float(mimic.get("offset", "0")),
            )
            for name, mimic in elements
            if mimic is not None
        }
    except (ValueError, RuntimeError) as error:
        error_lines = [
            re.sub(r"^Error: +|^at line \d+ in \S+$", "", line.strip()) for line in printed
        ]
        reason = next(filter(None, error_lines), str(error))  # the first message is the cause
        reason += "".join(
            f"; {line}" for line in error_lines if "inertial element for Link" in line
        )
        raise DataError(f"{refused}: {reason}") from error
    return model, mimics, _controller(root.find("controller"), urdf)


def _urdf_text(content: bytes) -> str:
    """Return a file's text as strict XML without a declaration.

    Lines keep their numbers. ROS reads any encoding, blank lines before the declaration, two
    hyphens in comments, and a bare ampersand. No entity is left, so that none is expanded.
    """
    declared = DECLARED_ENCODING.match(content)
    encodings = ["utf-8-sig", declared[1].decode() if declared else "cp1252", "cp1252", "latin-1"]
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        encodings.insert(0, "utf-16")
    text = ""
    for encoding in encodings:
        try:
            text = content.decode(encoding)
            break
        except (UnicodeDecodeError, LookupError):
            continue
    first, *parts = text.split("<!--")
    text_parts = [first]
    for part in parts:
        comment, _, after = part.partition("-->")
        text_parts += ["\n" * comment.count("\n"), after]
    text = "".join(text_parts)
    if declaration := re.match(r"\s*<\?xml\b[^>]*\?>", text):
        text = "\n" * declaration[0].count("\n") + text[declaration.end() :]
    return re.sub(r"&(?!(?:amp|lt|gt|quot|apos|#\d+|#x[\da-fA-F]+);)", "&amp;", text)


def _root_element(text: str, refused: str) -> ElementTree.Element:
    """Return the outermost element; the prefixes of names stay, also those without a namespace.

    Raises:
        DataError: the text is not XML; the message begins with `refused` and names what it is.
    """
    start = text.lstrip()[:1000]
    if content := other_content(start):
        raise DataError(f"{refused}: {content}")
    builder, parser = ElementTree.TreeBuilder(), expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        begins = "" if start.startswith("<") else f"; it begins with {_first_line(start)!r}"
        raise DataError(f"{refused}: not XML: {error}{begins}") from error
    return builder.close()


def _first_line(text: str) -> str:
    """Return at most `MAX_START_SHOWN` characters of the first line."""
    return text.partition("\n")[0][:MAX_START_SHOWN].strip()


def _other_format(root: ElementTree.Element, urdf: Path) -> str:
    """Return the format of a file that is not a URDF, and the next step; "" for a URDF."""
    prefixes = {"xacro"} | {
        name.removeprefix("xmlns:")
        for name, address in root.items()
        if name.startswith("xmlns:") and address.endswith(XACRO_ADDRESS)
    }
    for element in root.iter():
        values = (value for name, value in element.items() if name != "filename")
        if element.tag.partition(":")[0] in prefixes or any("${" in value for value in values):
            stem = urdf.name.removesuffix(".xacro").removesuffix(".urdf").removesuffix(".xml")
            names = (f"{stem}.urdf", f"{stem}_expanded.urdf")
            target = urdf.with_name(next(name for name in names if name != urdf.name))
            paths = [shlex.quote(str(path)) for path in (urdf, target)]
            return f"a xacro file; run: xacro {paths[0]} > {paths[1]}"
    if root.tag in OTHER_FORMATS:
        return (
            f"{OTHER_FORMATS[root.tag]}; convert it to URDF, or give the URDF from which it was "
            "made"
        )
    if root.tag != "robot":
        return f"its outermost element is <{root.tag}> (valid: <robot>)"
    if root.find("link") is None and root.find("group") is not None:
        return "a semantic description (SRDF) of a URDF; give that URDF"
    return ""


def _controller(element: ElementTree.Element | None, urdf: Path) -> Controller | None:
    """Read stiffbench's element of a URDF; other readers ignore it.

    ``<controller signs="1 1 1 1 1 1" zeros_deg="0 0 0 0 0 0" j3_from_ground="false">`` with the
    elements ``<world xyz="" rpy=""/>`` and ``<flange xyz="" rpy=""/>``; see `Controller`.

    Raises:
        DataError: an attribute is missing or invalid.
    """
    if element is None:
        return None

    def numbers(owner: ElementTree.Element, name: str, count: int | None = None) -> FloatArray:
        text = owner.get(name, "")
        try:
            values = np.array(text.split(), dtype=np.float64)
        except ValueError:
            values = np.empty(0)
        if (
            not len(values)
            or len(values) != (count or len(values))
            or not np.isfinite(values).all()
        ):
            valid = f"{count} numbers" if count else "a number for each joint"
            raise DataError(f"{urdf}: <{owner.tag}> has {name}={text!r} (valid: {valid})")
        return values

    def pose(name: str) -> FloatArray:
        owner = element.find(name)
        if owner is None:
            return np.eye(4)
        rotation = pin.rpy.rpyToMatrix(numbers(owner, "rpy", 3))
        return np.asarray(pin.SE3(rotation, numbers(owner, "xyz", 3)).homogeneous)

    from_ground = element.get("j3_from_ground", "false")
    if from_ground not in ("true", "false"):
        raise DataError(f"{urdf}: j3_from_ground={from_ground!r} (valid: true or false)")
    signs = numbers(element, "signs")
    zeros = np.radians(numbers(element, "zeros_deg", len(signs)))
    try:
        return Controller(signs, zeros, pose("world"), pose("flange"), from_ground == "true")
    except DataError as error:
        raise DataError(f"{urdf}: {error}") from error


def _check_description(root: ElementTree.Element, urdf: Path) -> None:
    """Reject a URDF whose joints form no tree: it would overflow the C++ parser's stack."""
    children = Counter(child.get("link") for child in root.findall("joint/child"))
    for link, count in children.items():
        if count > 1:
            raise DataError(f"{urdf}: link {link!r} is the child of {count} joints (valid: one)")
    if any(joint.get("name") == "universe" for joint in root.findall("joint")):
        raise DataError(f"{urdf}: joint 'universe' has a name that Pinocchio reserves")


@contextmanager
def _captured_stderr() -> Iterator[list[str]]:
    """Capture the C++ parser's standard error as lines, filled at the end."""
    lines: list[str] = []
    with tempfile.TemporaryFile() as file:
        original_stderr = os.dup(2)
        os.dup2(file.fileno(), 2)
        try:
            yield lines
        finally:
            os.dup2(original_stderr, 2)
            os.close(original_stderr)
            file.seek(0)
            lines += file.read().decode(errors="replace").split("\n")


def joint_type_and_axis(model: pin.Model, joint: int) -> tuple[JointType, FloatArray]:
    """Return a joint's kind and (3,) unit axis from its motion subspace.

    Raises:
        DataError: the joint has more than one degree of freedom.
    """
    joint_model = model.joints[joint]
    if joint_model.nv != 1:
        raise DataError(
            f"joint {model.names[joint]!r} has {joint_model.nv} degrees of freedom (valid: one; "
            "revolute, continuous or prismatic)"
        )
    data = joint_model.createData()
    joint_model.calc(data, pin.neutral(model)[joint_model.idx_q :][: joint_model.nq])
    subspace = np.asarray(data.S, dtype=np.float64).reshape(6)
    if np.abs(subspace[:3]).max() > 0.0:
        return "prismatic", subspace[:3]
    return "revolute", subspace[3:]


def _chosen_tip(
    tree: pin.Model, mimics: Mapping[str, Mimic], urdf: Path, tip: str | None
) -> tuple[pin.Frame, list[str]]:
    """Return the frame of the tip, and a note if there was a choice.

    Raises:
        ConfigError: no link has the name `tip`.
    """
    fingers, helpers, links = _fingers(tree), _helpers(tree), dict[int, pin.Frame]()
    n_fixed, carries, carries_arm = dict[int, int](), set[int](), set[int]()
    for index, frame in enumerate(tree.frames):
        if frame.type == pin.FrameType.BODY:
            joint = tree.frames[frame.parentFrame]
            is_fixed = joint.type == pin.FrameType.FIXED_JOINT
            links[index], n_fixed[index] = frame, is_fixed * (n_fixed.get(joint.parentFrame, 0) + 1)
            if index not in helpers:
                carries.add(joint.parentFrame)
                if frame.parentJoint not in fingers:
                    carries_arm.add(joint.parentFrame)

    def sort_key(index: int) -> tuple[float, ...]:
        name, joints = links[index].name, [*tree.supports[links[index].parentJoint]][1:]
        n_usable = sum(
            tree.joints[joint].nv == 1 and tree.names[joint] not in mimics for joint in joints
        )
        name_ranks = [number for number, end in enumerate(TIP_NAMES) if name.endswith(end)]
        rank = min(name_ranks, default=len(TIP_NAMES))
        distance = round(float(np.linalg.norm(links[index].placement.translation)), 6)
        is_flange = index not in helpers
        return n_usable, n_usable - len(joints), -rank, is_flange, distance, n_fixed[index], index

    is_finger = {index: frame.parentJoint in fingers for index, frame in links.items()}
    ends = [index for index in links if index not in (carries if is_finger[index] else carries_arm)]
    ends.sort(key=lambda index: (not is_finger[index], *sort_key(index)), reverse=True)
    tips = [links[index].name for index in ends if links[index].parentJoint]
    if tip is None and len(tips) < 2:
        return links[ends[0]], []
    if tip is None:
        note = (
            f"the chain of {sort_key(ends[0])[0]} joints to the link {tips[0]!r} is used; --tip "
            f"LINK selects another ({_listed(tips[1:])})"
        )
        return links[ends[0]], [note]
    return _link(tree, urdf, tip, "tip", tips), []


def _link(
    tree: pin.Model, urdf: Path, name: str, option: str, first_names: Sequence[str] = ()
) -> pin.Frame:
    """Return the frame of a link.

    Raises:
        ConfigError: no link has the name; the message lists `first_names` first.
    """
    links = {frame.name: frame for frame in tree.frames if frame.type == pin.FrameType.BODY}
    if name in links:
        return links[name]
    names = dict.fromkeys([*first_names, *links])
    listed = _listed([*names], MAX_NAMED_IN_ERROR)
    raise ConfigError(f"{urdf}: {unknown_name('link', name, names, listed)}", option)


def _held_joints(
    tree: pin.Model,
    mimics: Mapping[str, Mimic],
    path: Sequence[int],
    hold: Mapping[str, float | None],
    urdf: Path,
) -> dict[int, float]:
    """Return joint -> position, rad or m, of held joints and of all joints that follow them.

    `hold`: deg or mm by name, or by number among the independent joints of the chain `path`.

    Raises:
        ConfigError: a joint is unknown, held twice, follows another or has several degrees of
            freedom, or its value is missing or beyond its limits.
        DataError: the numbers of a mimic joint are not finite.
    """
    numbers = {tree.names[joint]: joint for joint in range(1, tree.njoints)}
    held = dict[int, float]()
    for name, value in hold.items():
        try:
            of_chain = [tree.names[joint] for joint in path if tree.names[joint] not in mimics]
            joint = numbers.get(name) or numbers[of_chain[joint_number(of_chain, name)]]
        except ConfigError as error:
            raise ConfigError(f"{urdf}: {error}", "hold") from error
        full_name = tree.names[joint]
        if joint in held:
            raise ConfigError(f"{name}: {full_name} is held twice", "hold")
        if full_name in mimics:
            text = f"follows {mimics[full_name].joint}, which can be held"
            raise ConfigError(f"{name}: the mimic joint {full_name} {text}", "hold")
        if tree.joints[joint].nv != 1:
            text = f"has {tree.joints[joint].nv} degrees of freedom (valid: one)"
            raise ConfigError(f"{name}: {full_name} {text}", "hold")
        held[joint] = held_position(name, value, not _slides(tree, joint), *_limits(tree, joint))
    for name in mimics:
        rule = _rule(mimics, name)
        if not np.isfinite([rule.multiplier, rule.offset]).all():
            raise DataError(f"{urdf}: mimic joint {name!r}: its numbers are not finite")
        joint, followed = numbers.get(name, 0), numbers.get(rule.joint, 0)
        if joint and followed in held and tree.joints[joint].nv == 1:
            held[joint] = rule.multiplier * held[followed] + rule.offset
    return held


def _rule(mimics: Mapping[str, Mimic], name: str) -> Mimic:
    """Return the rule of a mimic joint by an independent joint: it may follow another mimic joint.

    In a circle of mimic joints the rule names one of them.
    """
    factor, offset, names = 1.0, 0.0, [name]
    while names[-1] in mimics and len(names) == len({*names}):
        mimic = mimics[names[-1]]
        factor, offset = factor * mimic.multiplier, offset + factor * mimic.offset
        names.append(mimic.joint)
    return Mimic(names[-1], factor, offset)


def _limits(tree: pin.Model, joint: int) -> tuple[float, float]:
    """Return the limits of a joint with one degree of freedom, rad or m; infinite without limits.

    Exporters write 0..0, or very large numbers, as limits of a revolute joint without limits.
    """
    entry = tree.joints[joint].idx_q
    low, high = tree.lowerPositionLimit[entry], tree.upperPositionLimit[entry]
    is_unlimited = low == high == 0.0 or low <= -UNLIMITED_RAD < UNLIMITED_RAD <= high
    if tree.joints[joint].nq == 2 or (is_unlimited and not _slides(tree, joint)):
        return -np.inf, np.inf
    return float(low), float(high)


def _position_text(tree: pin.Model, joint: int, position: float) -> str:
    """Return a joint with its position, rad or m, as "rail=500 mm"."""
    unit, factor = ("mm", 1000.0) if _slides(tree, joint) else ("deg", np.degrees(1.0))
    return f"{tree.names[joint]}={factor * position:.12g} {unit}"


def _tilts(tree: pin.Model, joint: int, positions: FloatArray) -> bool:
    """Test if a joint turns what it carries against gravity, at `positions` (n_q,).

    Raises:
        DataError: the joint has several degrees of freedom.
    """
    kind, axis = joint_type_and_axis(tree, joint)
    data = tree.createData()
    pin.forwardKinematics(tree, data, positions)
    upward = (data.oMi[joint].rotation @ axis)[2]
    return kind == "revolute" and abs(upward) < 1.0 - 1e-9


def _slides(tree: pin.Model, joint: int) -> bool:
    """Test if a joint is prismatic."""
    is_simple = tree.joints[joint].nv == 1
    return is_simple and joint_type_and_axis(tree, joint)[0] == "prismatic"


def _helpers(tree: pin.Model) -> set[int]:
    """Return the frames of fixed links with a helper's name (`HELPER_NAMES`), and of their links.

    A link that carries a moving joint is not a helper.
    """
    helpers, moving = set[int](), set[int]()
    for index in range(tree.nframes - 1, 0, -1):
        frame = tree.frames[index]
        if index in moving or frame.type == pin.FrameType.JOINT:
            moving.add(frame.parentFrame)
    for index, frame in enumerate(tree.frames):
        if frame.type == pin.FrameType.BODY and index not in moving:
            joint = tree.frames[frame.parentFrame]
            is_fixed = joint.type == pin.FrameType.FIXED_JOINT
            if is_fixed and (HELPER_NAMES.search(frame.name) or joint.parentFrame in helpers):
                helpers.add(index)
    return helpers


def _finger_notes(tree: pin.Model, path: Sequence[int]) -> list[str]:
    """Return a note if the last joint of the chain `path` slides as shortly as a finger."""
    joint = path[-1]
    entry = tree.joints[joint].idx_q
    low, high = tree.lowerPositionLimit[entry], tree.upperPositionLimit[entry]
    is_short = low < high <= low + LONGEST_FINGER_TRAVEL_M
    if len(path) < 2 or not _slides(tree, joint) or not is_short:
        return []
    frame = tree.frames[tree.getFrameId(tree.names[joint], pin.FrameType.JOINT)]
    before = tree.frames[frame.parentFrame].name
    return [
        f"the last joint {tree.names[joint]!r} slides only {1000.0 * (high - low):.3g} mm, as a "
        f"gripper does; --tip {shlex.quote(before)} leaves it out"
    ]


def _fingers(tree: pin.Model) -> set[int]:
    """Return the joints of hands and grippers.

    A hand is a link with several branches of moving joints, each with fewer joints than the chain
    before them. A joint with a finger's name (`FINGER_NAMES`, `SLIDING_FINGER_NAMES`) also belongs
    to a hand, with all joints behind it.
    """
    height = [0] * tree.njoints
    for joint in range(tree.njoints - 1, 0, -1):
        parent = tree.parents[joint]
        height[parent] = max(height[parent], height[joint] + 1)
    fingers = set[int]()
    for joint in range(1, tree.njoints):
        parent = tree.parents[joint]
        depth = len(tree.supports[parent]) - 1
        is_hand = len(tree.children[parent]) > 1 and height[parent] < depth
        pattern = SLIDING_FINGER_NAMES if _slides(tree, joint) else FINGER_NAMES
        is_named = depth > 0 and pattern.search(tree.names[joint])
        if parent in fingers or is_hand or is_named:
            fingers.add(joint)
    return fingers


def _with_other_joints_locked(
    tree: pin.Model,
    path: Sequence[int],
    positions: FloatArray,
    unlisted: Collection[int],
    mimics: Mapping[str, Mimic],
) -> tuple[pin.Model, str]:
    """Return the chain of the joints `path`, and a note on the locked joints.

    All other joints are locked at `positions` (n_q,). `unlisted` are locked joints that the note
    omits. Links with the name of a joint get another name in `tree`: Pinocchio locks a joint by its
    name.
    """
    locked_joints = [joint for joint in range(1, tree.njoints) if joint not in path]
    if not locked_joints:
        return tree, ""
    listed = [joint for joint in locked_joints if joint not in unlisted]
    entries = [tree.joints[joint].idx_q for joint in listed if tree.joints[joint].nq == 1]
    position_text = "zero (or the nearest limit)" if positions[entries].any() else "zero"
    names = [
        f"{name} (mimics {mimics[name].joint})" if name in mimics else name
        for name in (tree.names[joint] for joint in listed)
    ]
    used_names = {*tree.names}
    for frame in tree.frames:
        if frame.type in (pin.FrameType.BODY, pin.FrameType.FIXED_JOINT):
            while frame.name in used_names:
                frame.name += "'"
            used_names.add(frame.name)
    note = bool(names) * (
        f"{len(names)} joint{'s' * (len(names) > 1)} off the chain locked at {position_text}, "
        f"{'its' if len(names) == 1 else 'their'} links' masses counted: {_listed(names)}"
    )
    return pin.buildReducedModel(tree, locked_joints, positions), note


def _locked_positions(
    tree: pin.Model, path: Sequence[int], fixed: Mapping[int, float]
) -> FloatArray:
    """Return the (n_q,) configuration that all joints off the `path` are locked at.

    `fixed`: joint -> position, rad or m. The others are at zero, or at the limit nearest to zero.
    """
    positions = np.asarray(pin.neutral(tree))
    for joint in range(1, tree.njoints):
        entry, n_q = tree.joints[joint].idx_q, tree.joints[joint].nq
        low, high = tree.lowerPositionLimit[entry], tree.upperPositionLimit[entry]
        if joint in fixed and n_q == 2:
            positions[entry : entry + 2] = np.cos(fixed[joint]), np.sin(fixed[joint])
        elif joint in fixed:
            positions[entry] = fixed[joint]
        elif joint not in path and n_q == 1 and not low <= 0.0 <= high and low <= high:
            positions[entry] = np.clip(0.0, low, high)
    return positions


def _listed(names: Sequence[str], limit: int = MAX_NAMED_IN_NOTE) -> str:
    """Join names with commas; list at most `limit` names."""
    n_more = len(names) - limit
    return ", ".join(names[:limit]) + (f" and {n_more} more" if n_more > 0 else "")
