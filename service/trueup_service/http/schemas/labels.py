"""Labels on the wire."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, StringConstraints

from trueup_service.actions.label import MOST_OF_NAME, MOST_OF_NOTE, MOST_TAGS
from trueup_service.control_characters import CONTROL
from trueup_service.http.schemas.wire import FromRecord, RequestBody

# one line of text; a note may have several
Line = Annotated[str, StringConstraints(pattern=rf"^[^{CONTROL}]*$", max_length=MOST_OF_NAME)]
Lines = Annotated[
    str,
    StringConstraints(
        pattern=r"^[^\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]*$",
        max_length=MOST_OF_NOTE,
    ),
]


class Label(FromRecord):
    """What people call something of a plant. `subject` is the name of the plant, or the digest of
    an episode, an artifact or a decision; `updated_at` is empty where nobody has labelled it."""

    plant: str
    kind: str
    subject: str
    name: str | None
    tags: list[str]
    note: str | None
    updated_at: str
    updated_by: str


class LabelChange(RequestBody):
    """What changes of a label; what is left out stays. Empty text, or an empty list, takes away
    what was there."""

    name: Annotated[Line | None, Field(description="One line")] = None
    tags: Annotated[
        list[Line] | None,
        Field(max_length=10 * MOST_TAGS, description="All tags; kept in lower case, each once"),
    ] = None
    note: Annotated[Lines | None, Field(description="Text of several lines")] = None
    updated_at: Annotated[
        str | None,
        Field(
            max_length=27,
            description="The label's `updated_at` as it was read: refused with `label-changed` if "
            "somebody changed it since",
        ),
    ] = None
