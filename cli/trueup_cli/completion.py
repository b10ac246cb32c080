"""`trueup completion`: commands, options and names of plants, completed by the shell."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from trueup.errors import TrueupError
from trueup_cli.show import lines, say

Shell = Literal["bash", "zsh", "fish", "powershell"]


class NoShell(TrueupError):
    """The shell that runs here is not known."""

    code = "no-shell"
    hint = "Name it: `trueup completion bash`, zsh, fish or powershell."


def completion(
    shell: Shell | None = None,
    *,
    install: Annotated[
        bool,
        Parameter(
            negative=(), help="Put it where the shell finds it, and load it when the shell starts"
        ),
    ] = False,
    to: Annotated[
        Path | None, Parameter(help="Write it to this file; no start-up file is changed")
    ] = None,
) -> None:
    """Print what a shell needs to complete commands, options and plants: `eval "$(trueup completion
    bash)"`, or --install it.

    Names of plants come from the service at TRUEUP_URL when they are asked for.

    Parameters
    ----------
    shell
        bash, zsh, fish or powershell; default: the one that runs here
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
    says = (
        "completes trueup in every shell that is started from now on"
        if to is None
        else "completes trueup in a shell that reads it"
    )
    say("{} {}", written, says)
