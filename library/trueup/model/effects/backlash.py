"""Backlash: play in the drive."""

import numpy as np

from trueup.model.effect import Effect, Number, Port, Scale


class Backlash(Effect):
    """What arrives follows what is issued only after the play is used up.

    Equation: play' = clip(play, u - gap / 2, u + gap / 2)
    Source: M. A. Krasnosel'skii, A. V. Pokrovskii, Systems with Hysteresis (1989), the play
      operator.
    Blind: commands that never turn.
    """

    name = "backlash"
    port = Port.COMMAND
    order = 6
    category = "structure"
    in_mjcf = (
        "apply the play to ctrl before each step: play = clip(play, ctrl - gap / 2, ctrl + gap / "
        "2); a joint of limited range before the link is another law, in which the link is free "
        "within the play"
    )
    params = (Number("gap", Scale.COMMAND, 0.0, 0.0, 1.2),)
    states = ("play",)
    begins = ("u",)
    memory = (Scale.COMMAND,)
    starts = tuple((0.02 * 1.5**i,) for i in range(10))
    threshold = ("gap",)

    @staticmethod
    def apply(u, play, gap):  # type: ignore[no-untyped-def]
        play = np.minimum(np.maximum(play, u - 0.5 * gap), u + 0.5 * gap)
        return play, play
