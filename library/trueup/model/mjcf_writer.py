"""MJCF writer: a corrected robot as the file that it was read from, changed only where the
correction is.

Start tags are rewritten where they stand, so that the difference of the two files is the correction
and nothing else. Where an element stands in no tag of the file itself (a URDF, an included file),
MuJoCo's own writing of the whole model is what is changed.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.model.mjcf import joint_axes, links, mujoco, seen_from
from trueup.model.mjcf_patch import Left, Patch
from trueup.model.tree import LINK
from trueup.model.xml_tags import Tag, ancestors, is_closed, spaced, start_tag, tags

Array = NDArray[np.float64]
ACTUATORS = ("general", "motor", "position", "velocity")
KEPT = ("name", "group", "user")  # attributes of an actuator that say nothing of its force
HELD = 1e-6  # of a number's size: it was compiled as it was written
HARD = "0.9999 0.9999"  # impedance of a constraint that hardly gives
# times the samples that a delay's history needs: whoever simulates it on finer steps needs more
SPARE = 8


@dataclass(frozen=True, slots=True)
class Written:
    """A corrected model: its text, the difference from the file as a unified diff ("" where the
    whole was written anew), what is left."""

    text: str
    difference: str
    left: tuple[Left, ...]


def write(path: Path, patch: Patch, heading: Sequence[str]) -> Written:
    """The file with a patch applied, `heading` as a comment before everything. Raises NotInstalled
    without MuJoCo."""
    engine = mujoco()
    spec = engine.MjSpec.from_file(str(path))
    model = spec.compile()
    text = path.read_text()
    whole = _stands(text, patch)
    base = text if whole else spec.to_xml()
    changed = _changed(engine, model, base, patch)
    again = engine.MjSpec.from_string(changed)
    again.modelfiledir = str(path.parent)
    left = [*patch.left, *_lost(engine, model, again.compile(), patch)]
    comments = [*heading, *(f"not expressed: {e}" for e in left)]
    comment = (
        "<!--\n" + "\n".join(f"  {line.replace('--', '- -')}" for line in comments) + "\n-->\n"
    )
    root = tags(changed)[0].first
    encoded = changed.encode()
    result = (encoded[:root] + comment.encode() + encoded[root:]).decode()
    names = (f"a/{path.name}", f"b/{path.name}")
    lines = (
        difflib.unified_diff(
            text.splitlines(keepends=True), result.splitlines(keepends=True), *names
        )
        if whole
        else ()
    )
    ended = (
        line if line.endswith("\n") else f"{line}\n\\ No newline at end of file\n" for line in lines
    )
    return Written(result, "".join(ended), tuple(left))


def _stands(text: str, patch: Patch) -> bool:
    """Whether every element that changes is a tag of an MJCF's own text."""
    try:
        every = tags(text)
    except expat.ExpatError:
        return False
    joints = {
        t.attributes.get("name") for t in every if t.name == "joint" and "joint" not in t.attributes
    }
    driven = {t.attributes.get("joint") for t in every if t.name in ACTUATORS}
    wanted = {c.joint for c in patch.changes}
    acted = {c.joint for c in patch.changes if c.element == "actuator"}
    return every[0].name == "mujoco" and wanted <= joints and acted <= driven


def _changed(engine: Any, model: Any, text: str, patch: Patch) -> str:
    """The text with every change made."""
    every = tags(text)
    edits: list[tuple[int, int, str]] = []
    sections: list[str] = []
    for j in range(model.njnt):
        name = model.joint(j).name
        tag = next(
            (
                t
                for t in every
                if t.name == "joint"
                and t.attributes.get("name") == name
                and "joint" not in t.attributes
            ),
            None,
        )
        actuator = _actuator_of(model, j)
        joint = _joint(model, j, actuator, patch.of(name, "joint"))
        if joint and tag:
            edits.append(
                (
                    tag.first,
                    tag.last,
                    start_tag(tag.name, {**tag.attributes, **joint}, is_closed(text, tag)),
                )
            )
        acts = patch.of(name, "actuator")
        if acts:
            at = next(
                (t for t in every if t.name in ACTUATORS and t.attributes.get("joint") == name),
                None,
            )
            given = {k: v for k, v in at.attributes.items() if k in KEPT} if at else {"name": name}
            element = start_tag(
                "general", {**given, **_general(engine, model, name, actuator, patch)}, True
            )
            if (
                at
                and at.name == "motor"
                and set(acts) == {"gain"}
                and not model.actuator_forcelimited[actuator]
            ):
                edits.append(
                    (
                        at.first,
                        at.last,
                        start_tag(
                            "motor",
                            {**at.attributes, "gear": spaced(acts["gain"])},
                            is_closed(text, at),
                        ),
                    )
                )
            elif at:
                edits.append(
                    (
                        at.first,
                        at.last,
                        element if is_closed(text, at) else element.replace("/>", ">"),
                    )
                )
            else:
                sections.append(f"<actuator>{element}</actuator>")
        sections += _sections(model, name, patch)
    edits += _inertials(engine, model, text, every, patch)
    data = text.encode()
    for first, last, replaced in sorted(edits, reverse=True):
        data = data[:first] + replaced.encode() + data[last:]
    if sections:
        end = data.rindex(b"</mujoco")
        data = data[:end] + "".join(f"  {s}\n" for s in sections).encode() + data[end:]
    return data.decode()


def _actuator_of(model: Any, joint: int) -> int:
    """The joint's actuator, -1 where it has none."""
    return next((i for i in range(model.nu) if model.actuator_trnid[i, 0] == joint), -1)


def _velocity_gain(model: Any, actuator: int) -> float:
    """What of a joint's damping its actuator gives."""
    return (
        -(float(model.actuator_gear[actuator, 0]) ** 2) * float(model.actuator_biasprm[actuator, 2])
        if actuator >= 0
        else 0.0
    )


def _joint(model: Any, j: int, actuator: int, given: Mapping[str, Json]) -> dict[str, str]:
    """Attributes of a joint's tag."""
    written = {name: spaced(given[name]) for name in ("armature", "frictionloss") if name in given}
    if "frictionloss" in given:  # as hard as MuJoCo has it: it holds, and does not creep
        written |= {
            "solreffriction": spaced(2.0 * model.opt.timestep, 1.0),
            "solimpfriction": HARD,
        }
    for name, behind, linear, higher in (
        ("damping", "damping |v|", model.dof_damping[j], model.dof_dampingpoly[j]),
        ("stiffness", "stiffness q^2", model.jnt_stiffness[j], model.jnt_stiffnesspoly[j]),
    ):
        if name not in given and behind not in given:
            continue
        first = float(np.ravel(linear)[0])
        if name in given:
            first = float(given[name])  # type: ignore[arg-type]
            if name == "damping":
                first = max(first - _velocity_gain(model, actuator), 0.0)
        more = list(higher)
        if behind in given:
            more[0 if name == "damping" else 1] += float(given[behind])  # type: ignore[arg-type]
        written[name] = spaced(first, *more) if any(more) else spaced(first)
    return written


def _general(engine: Any, model: Any, name: str, actuator: int, patch: Patch) -> dict[str, str]:
    """Attributes of a general actuator that does what the joint's own does, and what changes."""
    given, passive = patch.of(name, "actuator"), patch.of(name, "joint")
    gain, servo, offset = (1.0, 0.0, 0.0)
    limits: dict[str, str] = {"ctrllimited": "false", "forcelimited": "false"}
    if actuator >= 0:
        gear, affine = float(model.actuator_gear[actuator, 0]), int(engine.mjtBias.mjBIAS_AFFINE)
        bias = (
            model.actuator_biasprm[actuator]
            if model.actuator_biastype[actuator] == affine
            else np.zeros(3)
        )
        gain, servo, offset = (
            gear * float(model.actuator_gainprm[actuator, 0]),
            -(gear**2) * float(bias[1]),
            gear * float(bias[0]),
        )
        if model.actuator_ctrllimited[actuator]:
            limits |= {
                "ctrllimited": "true",
                "ctrlrange": spaced(*model.actuator_ctrlrange[actuator]),
            }
        if model.actuator_forcelimited[actuator]:
            limits |= {
                "forcelimited": "true",
                "forcerange": spaced(*(abs(gear) * model.actuator_forcerange[actuator])),
            }
    velocity = _velocity_gain(model, actuator)
    if "damping" in passive:
        velocity = min(velocity, max(float(passive["damping"]), 0.0))  # type: ignore[arg-type]
    standing = (("gain", gain), ("servo", servo), ("offset", offset))
    gain, servo, offset = (given.get(k, x) for k, x in standing)  # type: ignore[assignment]
    for what in ("ctrl", "force"):
        if f"{what}range" in given:
            span = spaced(*given[f"{what}range"])  # type: ignore[misc]
            limits |= {f"{what}limited": "true", f"{what}range": span}
    written = {
        "joint": name,
        "gear": "1",
        "gaintype": "fixed",
        "gainprm": spaced(gain),
        "biastype": "affine",
    }
    written |= {"biasprm": spaced(offset, -float(servo), -velocity), **limits}
    lag = (
        {"dyntype": "filterexact", "dynprm": spaced(given["lag"]), "actlimited": "false"}
        if "lag" in given
        else {"dyntype": "none"}
    )
    return {**written, **lag, **(_delay(model, given["delay"]) if "delay" in given else {})}


def _delay(model: Any, seconds: Json) -> dict[str, str]:
    """A delay, and as many samples as it needs."""
    late = float(seconds)  # type: ignore[arg-type]
    return {
        "delay": spaced(late),
        "nsample": str(SPARE * (int(np.ceil(late / model.opt.timestep)) + 1)),
    }


def _sections(model: Any, name: str, patch: Patch) -> list[str]:
    """What a joint's correction adds to a file."""
    added = []
    late, stop = patch.of(name, "sensor"), patch.of(name, "tendon")
    if late:
        held = _delay(model, late["delay"])
        sensors = [
            start_tag(k, {"name": f"{name} {k} as logged", "joint": name, **held}, True)
            for k in ("jointpos", "jointvel")
        ]
        added.append(f"<sensor>{''.join(sensors)}</sensor>")
    if stop:
        low, high, stiffness = stop["low high stiffness"]  # type: ignore[misc, str-unpack]
        spring = start_tag(
            "fixed",
            {
                "name": f"stop of {name}",
                "springlength": spaced(low, high),
                "stiffness": spaced(stiffness),
            },
            False,
        )
        driven = start_tag("joint", {"joint": name, "coef": "1"}, True)
        added.append(f"<tendon>{spring}{driven}</fixed></tendon>")
    return added


def _inertials(
    engine: Any, model: Any, text: str, every: list[Tag], patch: Patch
) -> list[tuple[int, int, str]]:
    """Edits that give each changed link's body what its link has more than the bodies welded on to
    it."""
    data = engine.MjData(model)
    data.qpos[:] = model.qpos0
    engine.mj_forward(model, data)
    link_of, axes, edits = links(model), joint_axes(data), []
    for j in range(model.njnt):
        name, body = model.joint(j).name, int(model.jnt_bodyid[j])
        given = list(patch.of(name, "link").values())
        at = next(
            (
                i
                for i, t in enumerate(every)
                if t.name == "joint" and t.attributes.get("name") == name
            ),
            -1,
        )
        if not given or at < 0:
            continue
        own = np.array(given[0], float)
        for other in range(1, model.nbody):
            if link_of[other] == j and other != body:
                own = own - seen_from(model, data, other, axes[j], data.xanchor[j])
        holder = next(i for i in ancestors(every, at) if every[i].name == "body")
        inertial = next((t for t in every if t.name == "inertial" and t.parent == holder), None)
        element = _inertial(
            own, data.xmat[body].reshape(3, 3), data.xpos[body], axes[j], data.xanchor[j]
        )
        if inertial:
            edits.append(
                (
                    inertial.first,
                    inertial.last,
                    start_tag("inertial", element, is_closed(text, inertial)),
                )
            )
        else:
            here = every[holder].last
            edits.append((here, here, start_tag("inertial", element, True)))
    return edits


def _inertial(link: Array, turn: Array, place: Array, axes: Array, origin: Array) -> dict[str, str]:
    """An inertial element in a body's frame (`turn`, `place` in the world) of ten numbers about a
    joint's."""
    mass, centre = link[0], link[1:4] / link[0]
    x, y, z, xy, xz, yz = link[4:]
    about = np.array([[x, xy, xz], [xy, y, yz], [xz, yz, z]]) - mass * (
        centre @ centre * np.eye(3) - np.outer(centre, centre)
    )
    to = turn.T @ axes
    i = to @ about @ to.T
    position = turn.T @ (origin + axes @ centre - place)
    return {
        "pos": spaced(*position),
        "mass": spaced(mass),
        "fullinertia": spaced(i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]),
    }


def _lost(engine: Any, nominal: Any, model: Any, patch: Patch) -> list[Left]:
    """Numbers that the file's own settings did not let through."""
    data = engine.MjData(model)
    data.qpos[:] = model.qpos0
    engine.mj_forward(model, data)
    link_of, axes, lost = links(model), joint_axes(data), []
    for j in range(model.njnt):
        name = model.joint(j).name
        joint = patch.of(name, "joint")
        velocity = _velocity_gain(model, _actuator_of(model, j))
        has = {
            "armature": model.dof_armature[j],
            "damping": model.dof_damping[j] + velocity,
            "stiffness": model.jnt_stiffness[j],
            "frictionloss": model.dof_frictionloss[j],
        }
        wanted = {k: v for k, v in joint.items() if k in has}
        lost += [
            f"{k} of {name}"
            for k, v in wanted.items()
            if not np.allclose(has[k], v, rtol=HELD, atol=1e-9)  # type: ignore[arg-type]
        ]
        for link in patch.of(name, "link").values():
            bodies = [b for b in range(1, model.nbody) if link_of[b] == j]
            compiled = sum(
                (seen_from(model, data, b, axes[j], data.xanchor[j]) for b in bodies),
                np.zeros(LINK),
            )
            if not np.allclose(
                compiled, np.array(link), rtol=HELD, atol=HELD * float(np.abs(compiled).max())
            ):
                lost.append(f"the masses of {name}'s link")
    return [
        Left("", "", f"{what}: the file's own settings (inertiafromgeom, settotalmass) decide it")
        for what in lost
    ]
