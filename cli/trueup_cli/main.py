"""`trueup`: the one place that may import everything.

Commands import what they need when they run, so that `--help` is quick.
"""

from __future__ import annotations

import os
import sys

from cyclopts import App, CycloptsError, CycloptsPanel

from trueup import __version__
from trueup_cli.exits import (
    CALLS_SERVICE,
    INTERRUPTED,
    LOCAL,
    MEANING,
    PIPE_CLOSED,
    VERIFIES,
    VERIFIES_LOCALLY,
    exit_codes,
)


def _misuse_panel(error: CycloptsError) -> object:
    """Shows what is wrong with a command line, which may hold characters that must be escaped."""
    from trueup_cli.show import visible

    return CycloptsPanel("\n".join(map(visible, str(error).split("\n"))))


app = App(
    name="trueup",
    version=__version__,
    help=(
        "Find where a robot's dynamics model is wrong, correct it, and serve the correction "
        "only if it has earned it."
    ),
    help_epilogue=exit_codes(tuple(MEANING)),
    error_formatter=_misuse_panel,
)

_COMMANDS = {
    "serve": ("run:serve", "Run the service, with a worker beside it.", LOCAL),
    "look": ("look:look", "Open the service in a browser, signed in.", CALLS_SERVICE),
    "work": ("run:work", "Run one worker.", LOCAL),
    "migrate": ("run:migrate", "Bring the database's schema up to date.", LOCAL),
    "kernels": ("run:kernels", "Compile the rollout kernels into the cache.", LOCAL),
    "plant": ("plant:app", "Register and look at plants.", CALLS_SERVICE),
    "upload": ("upload:upload", "Upload recordings of any format.", CALLS_SERVICE),
    "fit": ("registry:fit", "Fit a candidate from adaptation episodes.", CALLS_SERVICE),
    "diagnosis": (
        "registry:diagnosis",
        "Diagnose uploaded episodes, as a job of the service.",
        CALLS_SERVICE,
    ),
    "gate": ("registry:gate", "Judge a candidate against what serves, by a gate.", CALLS_SERVICE),
    "versions": ("registry:versions", "List the versions of a plant's model.", CALLS_SERVICE),
    "decisions": ("registry:decisions", "List what gates decided.", CALLS_SERVICE),
    "jobs": (
        "jobs:jobs",
        "Show what is under way and what has ended, or cancel it.",
        CALLS_SERVICE,
    ),
    "calibrate": (
        "monitor:calibrate",
        "Calibrate a monitor of what serves, for a promised rate of false alarms.",
        CALLS_SERVICE,
    ),
    "monitor": (
        "monitor:monitor",
        "Show whether a plant's model is watched, and what its monitor saw.",
        CALLS_SERVICE,
    ),
    "alarms": ("monitor:alarms", "List alarms and what changed, or close an alarm.", CALLS_SERVICE),
    "policy": (
        "monitor:policy",
        "Show or declare what may happen to a plant's model without a person.",
        CALLS_SERVICE,
    ),
    "serving": ("serving:serving", "Show what serves, or what served when.", CALLS_SERVICE),
    "promote": ("serving:promote", "Serve the candidate of an accepted decision.", VERIFIES),
    "approve": (
        "serving:approve",
        "Approve a decision, where a promotion takes two people.",
        VERIFIES,
    ),
    "rollback": (
        "serving:rollback",
        "Serve what served before, after its switchback test.",
        VERIFIES,
    ),
    "fetch": ("serving:fetch", "Fetch a model and verify every byte.", VERIFIES),
    "convert": (
        "convert:convert",
        "Write a model for Isaac Lab, mjlab or ros2_control, or as ONNX, FMU or MJCF.",
        LOCAL,
    ),
    "mlflow": (
        "mlflow:app",
        "Export versions to an MLflow registry, or import them from one.",
        VERIFIES,
    ),
    "oci": (
        "oci:app",
        "Push models and archives to an OCI registry, or pull them from one.",
        VERIFIES_LOCALLY,
    ),
    "evidence": (
        "channels:evidence",
        "List the evidence on a version, by stage, or add to it.",
        CALLS_SERVICE,
    ),
    "channels": (
        "channels:channels",
        "Show what each channel serves, or declare a channel.",
        CALLS_SERVICE,
    ),
    "release": (
        "channels:release",
        "Serve a version on a channel; by default the one that serves.",
        VERIFIES,
    ),
    "init": ("init:init", "Make a case folder from recordings alone, such as a ROS 2 bag.", LOCAL),
    "diagnose": (
        "diagnose:run",
        "Find where the gap lies, which effect causes it, and how far it shrinks.",
        LOCAL,
    ),
    "blindtrial": (
        "blindtrial:run",
        "Hide effects in simulated machines like yours, and say how often a diagnosis finds them.",
        VERIFIES,
    ),
    "openloop": (
        "openloop:openloop",
        "Tell how far models' rollouts go astray, beside the bound on it.",
        VERIFIES,
    ),
    "closedloop": (
        "closedloop:closedloop",
        "Tell how models track with a fixed planner, and whether they keep the envelope.",
        VERIFIES,
    ),
    "consistency": (
        "consistency:consistency",
        "Tell whether other recordings of the machine give the same numbers.",
        VERIFIES,
    ),
    "randomise": (
        "randomise:randomise_plants",
        "Draw a family of plants, and fit one predictor for all of them.",
        VERIFIES,
    ),
    "excite": (
        "excite:excite",
        "Design a bounded excitation that is safe under every plausible model.",
        LOCAL,
    ),
    "predict": ("predict:predict", "Roll a model out over an episode.", LOCAL),
    "login": ("access:login", "Store a token for a service.", CALLS_SERVICE),
    "whoami": ("access:whoami", "Show who you are to the service.", CALLS_SERVICE),
    "token": ("access:tokens", "Issue, list and revoke tokens.", CALLS_SERVICE),
    "project": ("access:projects", "Create and list projects.", CALLS_SERVICE),
    "webhook": ("webhooks:app", "Tell other services what happens.", CALLS_SERVICE),
    "audit": ("audit:app", "Print or verify the audit log.", VERIFIES),
    "replay": ("replay:replay", "Recompute a decision, and check that it agrees.", VERIFIES),
    "backup": (
        "archives:backup",
        "Write a backup of the whole registry, while the service runs.",
        VERIFIES_LOCALLY,
    ),
    "restore": ("archives:restore", "Restore a backup into empty storage.", VERIFIES_LOCALLY),
    "export": ("archives:export", "Export a plant with its whole history.", LOCAL),
    "import": (
        "archives:import_",
        "Import an exported plant, once it is verified.",
        VERIFIES_LOCALLY,
    ),
    "gc": ("archives:gc", "Remove bytes that no row names.", LOCAL),
    "fsck": (
        "fsck:fsck",
        "Check this installation's storage: log, rows and bytes.",
        VERIFIES_LOCALLY,
    ),
    "keygen": ("run:keygen", "Make a signing key for a log.", LOCAL),
    "completion": (
        "completion:completion",
        "Print or install shell completion of commands, options and plants.",
        LOCAL,
    ),
    "doctor": (
        "doctor:doctor",
        "Show what is installed, and what a missing part is needed for.",
        LOCAL,
    ),
    "identifiability": (
        "identifiability:identifiability",
        "Show what the recordings of a case can show, before anything is sought.",
        LOCAL,
    ),
    "effects": (
        "effects:effects",
        "List the effects that a search tries, and check one of your own by the laws.",
        LOCAL,
    ),
    "chapter": (
        "chapter:chapter",
        "Reproduce the chapter's figures, beside the published digits.",
        LOCAL,
    ),
    "demo": ("demo:demo", "Run the main job on a real recording.", LOCAL),
}
# which have help and exit codes of their own
APPS = (
    "plant:app",
    "audit:app",
    "mlflow:app",
    "oci:app",
    "access:tokens",
    "access:projects",
    "webhooks:app",
)
for _name, (_target, _help, _codes) in _COMMANDS.items():
    app.command(
        f"trueup_cli.{_target}",
        name=_name,
        **({} if _target in APPS else {"help": _help, "help_epilogue": exit_codes(_codes)}),
    )


def _load_own_files() -> None:
    """Loads the files that TRUEUP_EFFECTS and TRUEUP_SIMULATORS name, before any effect is
    compiled."""
    effects, simulators = (
        list(filter(None, os.environ.get(name, "").split(os.pathsep)))
        for name in ("TRUEUP_EFFECTS", "TRUEUP_SIMULATORS")
    )
    if effects:
        from trueup.model.effect import load_effect

        for file in effects:
            load_effect(file)
    if simulators:
        from trueup.model.simulator.simulator import load_simulator

        for file in simulators:
            load_simulator(file)


def main() -> None:
    """Runs a command, and exits with one of the codes in `trueup_cli.exits`."""
    try:
        try:
            _load_own_files()
            app()
        finally:
            sys.stdout.flush()
    except BrokenPipeError:  # the reader of standard output is gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(PIPE_CLOSED)
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    except Exception as error:  # noqa: BLE001  (an unexpected one is printed with its traceback)
        # imported here: it is slow to load, and only a command that fails needs it
        from trueup_cli.error_output import print_error, print_traceback

        code = print_error(error)
        sys.exit(print_traceback(error) if code is None else code)


if __name__ == "__main__":
    main()
