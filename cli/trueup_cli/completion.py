"""`trueup completion`: a shell completes commands, options and names of plants."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from trueup.errors import TrueupError
from trueup_cli.show import lines, say

Shell = Literal["bash", "zsh", "fish", "powershell"]


class NoShell(TrueupError):
    """The shell that runs here is unknown."""

    code = "no-shell"
    hint = "Name it: `trueup completion bash`, zsh, fish or powershell."


def completion(
    shell: Shell | None = None,
    *,
    install: Annotated[
        bool,
        Parameter(negative=(), help="Install it where the shell loads it at its start"),
    ] = False,
    to: Annotated[
        Path | None, Parameter(help="Write it to this file, and change no start-up file")
    ] = None,
) -> None:
    """Print the completion script of a shell, or install it.

    Use it with `eval "$(trueup completion bash)"`. Names of plants come from the service at
    TRUEUP_URL when they are completed.

    Parameters
    ----------
    shell
        bash, zsh, fish or powershell; default: the shell that runs here
    """
    from cyclopts.completion.detect import ShellDetectionError

    from trueup_cli.main import app

    try:
        if not install and to is None:
            lines(app.generate_completion(shell=shell))
            return
        written = app.install_completion(shell=shell, output=to, add_to_startup=to is None)
    except ShellDetectionError as error:
        raise NoShell(str(error)) from error
    effect = (
        "completes trueup in every shell that is started from now on"
        if to is None
        else "completes trueup in a shell that reads it"
    )
    say("{} {}", written, effect)
