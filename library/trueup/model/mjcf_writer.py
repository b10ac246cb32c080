"""MJCF writer: a corrected robot as the file that it was read from, changed only where the
correction is.

Start tags are rewritten where they stand, so that the difference of the two files is the correction
and nothing else. Where an element stands in no tag of the file itself (a URDF, an included file),
MuJoCo's own writing of the whole model is what is changed.
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from trueup.model.mjcf import joint_axes, links, mujoco, seen_from
from trueup.model.mjcf_drive import Drive, actuator_of, velocity_gain
from trueup.model.mjcf_patch import Left, Patch
from trueup.model.tree import LINK
from trueup.model.xml_tags import Tag, ancestors, is_closed, spaced, start_tag, tags

Array = NDArray[np.float64]
Edit = tuple[int, int, str]  # bytes [first, last) of a text, and what they become
ACTUATORS = ("general", "motor", "position", "velocity")
HELD = 1e-6  # of a number's size: it was compiled as it was written


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
    edits: list[Edit] = []
    sections: list[str] = []
    for j in range(model.njnt):
        name = model.joint(j).name
        tag = _tag_of(every, name)
        drive = Drive(engine, model, j, patch)
        if drive.joint and tag:
            attributes = {**tag.attributes, **drive.joint}
            edits.append(
                (tag.first, tag.last, start_tag(tag.name, attributes, is_closed(text, tag)))
            )
        if drive.has_motor and tag:
            holder = next(every[i] for i in ancestors(every, every.index(tag)) if is_body(every[i]))
            edits.append((holder.end, holder.end, drive.motor(holder.attributes)))
        if drive.acts:
            at = next(
                (t for t in every if t.name in ACTUATORS and t.attributes.get("joint") == name),
                None,
            )
            element = drive.element(at)
            if at:
                edits.append((at.first, at.end, element))
            else:
                sections.append(f"<actuator>{element}</actuator>")
        sections += drive.sections()
    edits += _inertials(engine, model, text, every, patch)
    data = text.encode()
    for first, last, replaced in sorted(edits, reverse=True):
        data = data[:first] + replaced.encode() + data[last:]
    if sections:
        end = data.rindex(b"</mujoco")
        data = data[:end] + "".join(f"  {s}\n" for s in sections).encode() + data[end:]
    return data.decode()


def _tag_of(every: Sequence[Tag], joint: str) -> Tag | None:
    """The tag that declares a joint, and not one that names it."""
    return next(
        (
            t
            for t in every
            if t.name == "joint"
            and t.attributes.get("name") == joint
            and "joint" not in t.attributes
        ),
        None,
    )


def is_body(tag: Tag) -> bool:
    """Whether a tag begins a body."""
    return tag.name == "body"


def _inertials(engine: Any, model: Any, text: str, every: list[Tag], patch: Patch) -> list[Edit]:
    """Edits that give each changed link's body what its link has more than the bodies welded on to
    it."""
    data = engine.MjData(model)
    data.qpos[:] = model.qpos0
    engine.mj_forward(model, data)
    link_of, axes = links(model), joint_axes(data)
    edits: list[Edit] = []
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
        velocity = velocity_gain(model, actuator_of(model, j))
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
