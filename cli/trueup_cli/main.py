"""`trueup`: the one place that may import everything. Commands import what they need when they run,
so that `--help` is quick."""

from __future__ import annotations

import os
import sys

from cyclopts import App, CycloptsError, CycloptsPanel

from trueup import __version__
from trueup_cli.exits import ASKS, HERE, HOLDS, HOLDS_HERE, INTERRUPTED, MEANING, PIPE_CLOSED, told


def _misused(error: CycloptsError) -> object:
    """What is wrong with a command line, which may hold the name of somebody else's file."""
    from trueup_cli.show import visible

    return CycloptsPanel("\n".join(map(visible, str(error).split("\n"))))


app = App(
    name="trueup",
    version=__version__,
    help=(
        "Find where a robot's dynamics model is wrong, correct it, and serve the correction "
        "only if it has earned it."
    ),
    help_epilogue=told(tuple(MEANING)),
    error_formatter=_misused,
)

_COMMANDS = {
    "serve": ("run:serve", "Run the service, with a worker beside it.", HERE),
    "look": ("look:look", "Open the service in a browser, signed in.", ASKS),
    "work": ("run:work", "Run one worker.", HERE),
    "migrate": ("run:migrate", "Bring the database's schema up to date.", HERE),
    "kernels": ("run:kernels", "Compile the rollout kernels into the cache.", HERE),
    "plant": ("plant:app", "Register and look at plants.", ASKS),
    "upload": ("registry:upload", "Upload recordings.", ASKS),
    "fit": ("registry:fit", "Fit a candidate from adaptation episodes.", ASKS),
    "diagnosis": (
        "registry:diagnosis",
        "The same as a job of the service, on uploaded episodes.",
        ASKS,
    ),
    "gate": ("registry:gate", "Judge a candidate by a declared gate against what serves.", ASKS),
    "versions": ("registry:versions", "List the versions of a plant's model.", ASKS),
    "decisions": ("registry:decisions", "List what gates decided.", ASKS),
    "calibrate": (
        "monitor:calibrate",
        "Calibrate a monitor of what serves, to a promise in operating hours.",
        ASKS,
    ),
    "monitor": (
        "monitor:monitor",
        "Say whether a plant's model is watched, and what was seen.",
        ASKS,
    ),
    "alarms": ("monitor:alarms", "List alarms, with what changed, or close one.", ASKS),
    "policy": (
        "monitor:policy",
        "Say or declare what may happen to a plant's model without a person.",
        ASKS,
    ),
    "serving": ("serving:serving", "Say what serves, or what served when.", ASKS),
    "promote": ("serving:promote", "Serve the candidate of an accepted decision.", HOLDS),
    "approve": (
        "serving:approve",
        "Approve a decision, where a promotion takes two people.",
        HOLDS,
    ),
    "rollback": ("serving:rollback", "Serve what served before, after its switchback test.", HOLDS),
    "fetch": ("serving:fetch", "Fetch a model, every byte verified.", HOLDS),
    "convert": ("convert:convert", "Write a fetched model as ONNX or MJCF.", HERE),
    "mlflow": ("mlflow:app", "Pass versions to an MLflow registry, and take them from one.", HOLDS),
    "evidence": (
        "channels:evidence",
        "List what was found of a version, and at which stage, or add to it.",
        ASKS,
    ),
    "channels": ("channels:channels", "Say what each channel serves, or declare one.", ASKS),
    "release": (
        "channels:release",
        "Serve what serves, or another version that did, on a channel.",
        HOLDS,
    ),
    "init": ("init:init", "Make a case folder from recordings alone, such as a ROS 2 bag.", HERE),
    "diagnose": (
        "diagnose:run",
        "Say where the gap lies, which effect causes it, and how far it shrinks.",
        HERE,
    ),
    "blindtrial": (
        "blindtrial:run",
        "Hide effects in machines like yours and say how often the diagnosis is right.",
        HOLDS,
    ),
    "excite": (
        "excite:excite",
        "Design a bounded excitation, safe under every model still in play.",
        HERE,
    ),
    "predict": ("predict:predict", "Roll a model out over an episode.", HERE),
    "login": ("access:login", "Keep a token for a service.", ASKS),
    "whoami": ("access:whoami", "Say whom the service takes you for.", ASKS),
    "token": ("access:tokens", "Issue, list and revoke tokens.", ASKS),
    "project": ("access:projects", "Create and list projects.", ASKS),
    "audit": ("audit:app", "Print or verify the audit log.", HOLDS),
    "replay": ("audit:replay", "Recompute a decision and say whether it agrees.", HOLDS),
    "backup": ("archives:backup", "Write all that is kept, while the service runs.", HOLDS_HERE),
    "restore": ("archives:restore", "Bring a backup back into empty storage.", HOLDS_HERE),
    "export": ("archives:export", "Write a plant with its whole history as one file.", HERE),
    "import": ("archives:import_", "Bring an exported plant in, verified.", HOLDS_HERE),
    "gc": ("archives:gc", "Remove bytes that nothing names.", HERE),
    "fsck": (
        "fsck:fsck",
        "Check this installation's own storage: log, rows, bytes, nothing lost, nothing left over.",
        HOLDS_HERE,
    ),
    "keygen": ("run:keygen", "Make a signing key for a log.", HERE),
    "completion": (
        "completion:completion",
        "Print what a shell needs to complete commands, options and plants.",
        HERE,
    ),
    "doctor": (
        "doctor:doctor",
        "Say what this installation has, and what is missing for what.",
        HERE,
    ),
    "chapter": (
        "chapter:chapter",
        "Reproduce the chapter's figures beside the published digits.",
        HERE,
    ),
    "demo": ("demo:demo", "Run the main job on a real recording.", HERE),
}
APPS = (
    "plant:app",
    "audit:app",
    "mlflow:app",
    "access:tokens",
    "access:projects",
)  # with help and exit codes of their own
for _name, (_where, _help, _codes) in _COMMANDS.items():
    app.command(
        f"trueup_cli.{_where}",
        name=_name,
        **({} if _where in APPS else {"help": _help, "help_epilogue": told(_codes)}),
    )


def main() -> None:
    """Run a command, and end with one of the codes in `trueup_cli.exits`."""
    try:
        try:
            app()
        finally:
            sys.stdout.flush()
    except BrokenPipeError:  # whoever read has read enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(PIPE_CLOSED)
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    except Exception as error:  # noqa: BLE001  (nothing is hidden: it is printed whole)
        from trueup_cli.complaints import (
            complain,
            trace,
        )  # what it needs to print loads slowly, and a server never complains

        code = complain(error)
        sys.exit(trace(error) if code is None else code)


if __name__ == "__main__":
    main()
