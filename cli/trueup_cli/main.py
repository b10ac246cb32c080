"""`trueup`: the one place that may import everything.

Commands import what they need when they run, so that `--help` is quick.
"""

from __future__ import annotations

import gc
import os
import sys

from cyclopts import App, CycloptsError, CycloptsPanel, Group

from trueup import __version__
from trueup.cores import one_blas_thread
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

one_blas_thread()  # before anything loads numpy


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

# by what they are for: name, where it is, what it does, exit codes
_GROUPS: dict[str, dict[str, tuple[str, str, tuple[int, ...]]]] = {
    "On your own recordings": {
        "try": ("first_try:first_try", "Walk through the main job, asking at each step.", LOCAL),
        "init": ("init:init", "Make a case folder from recordings, as of a ROS 2 bag.", LOCAL),
        "doctor": ("doctor:doctor", "Look for faults in a log, or at the installation.", LOCAL),
        "diagnose": ("diagnose:run", "Find where the gap lies, and which effect causes it.", LOCAL),
        "consistency": (
            "consistency:consistency",
            "Tell whether other recordings give the same numbers.",
            VERIFIES,
        ),
        "identifiability": (
            "identifiability:identifiability",
            "Show what the recordings of a case can show.",
            LOCAL,
        ),
        "excite": ("excite:excite", "Design a bounded excitation that is safe.", VERIFIES),
        "predict": ("predict:predict", "Roll a model out over an episode.", LOCAL),
        "convert": ("convert:convert", "Write a model for another tool.", LOCAL),
        "effects": ("effects:effects", "List the effects, or check one of your own.", LOCAL),
        "demo": ("demo:demo", "Run the main job on a real recording.", LOCAL),
        "chapter": ("chapter:chapter", "Reproduce the chapter's figures.", LOCAL),
    },
    "Find and correct": {
        "plant": ("plant:app", "Register and look at plants.", CALLS_SERVICE),
        "upload": ("upload:upload", "Upload recordings of any format.", CALLS_SERVICE),
        "diagnosis": ("registry:diagnosis", "Diagnose uploaded episodes.", CALLS_SERVICE),
        "fit": ("registry:fit", "Fit a candidate from adaptation episodes.", CALLS_SERVICE),
        "versions": ("registry:versions", "List a plant's versions.", CALLS_SERVICE),
        "gate": ("registry:gate", "Judge a candidate against what serves.", CALLS_SERVICE),
        "decisions": ("registry:decisions", "List what gates decided.", CALLS_SERVICE),
        "label": ("label:label", "Name, tag and annotate what a plant has.", CALLS_SERVICE),
        "jobs": ("jobs:jobs", "Show or cancel what is under way.", CALLS_SERVICE),
    },
    "Serve and go back": {
        "serving": ("serving:serving", "Show what serves, or what served when.", CALLS_SERVICE),
        "promote": ("serving:promote", "Serve the candidate of an accepted decision.", VERIFIES),
        "approve": ("serving:approve", "Approve, where a promotion takes two.", VERIFIES),
        "rollback": ("serving:rollback", "Serve what served before, tested first.", VERIFIES),
        "fetch": ("serving:fetch", "Fetch a model and verify every byte.", VERIFIES),
        "evidence": ("channels:evidence", "List or add evidence on a version.", CALLS_SERVICE),
        "channels": ("channels:channels", "Show or declare channels.", CALLS_SERVICE),
        "release": ("channels:release", "Serve a version on a channel.", VERIFIES),
    },
    "Watch": {
        "calibrate": ("monitor:calibrate", "Calibrate a monitor of what serves.", CALLS_SERVICE),
        "monitor": ("monitor:monitor", "Show what a plant's monitor saw.", CALLS_SERVICE),
        "alarms": ("monitor:alarms", "List alarms, or close one.", CALLS_SERVICE),
        "policy": ("monitor:policy", "Show or declare what needs no person.", CALLS_SERVICE),
        "webhook": ("webhooks:app", "Tell other services what happens.", CALLS_SERVICE),
    },
    "Study": {
        "openloop": ("openloop:openloop", "Errors of rollouts, beside their bound.", VERIFIES),
        "closedloop": ("closedloop:closedloop", "Tracking with a fixed planner.", VERIFIES),
        "randomise": ("randomise:randomise_plants", "Fit for a family of plants.", VERIFIES),
        "blindtrial": ("blindtrial:run", "How often a diagnosis is right here.", VERIFIES),
    },
    "Hold to account": {
        "audit": ("audit:app", "Print or verify the audit log.", VERIFIES),
        "replay": ("replay:replay", "Recompute a decision.", VERIFIES),
        "export": ("archives:export", "Export a plant with its history.", LOCAL),
        "import": ("archives:import_", "Import an exported plant.", VERIFIES_LOCALLY),
        "backup": ("archives:backup", "Back up the whole registry.", VERIFIES_LOCALLY),
        "restore": ("archives:restore", "Restore a backup.", VERIFIES_LOCALLY),
        "fsck": ("fsck:fsck", "Check this installation's storage.", VERIFIES_LOCALLY),
        "gc": ("archives:gc", "Remove bytes that no row names.", LOCAL),
        "mlflow": ("mlflow:app", "Exchange versions with an MLflow registry.", VERIFIES),
        "oci": ("oci:app", "Exchange models with an OCI registry.", VERIFIES_LOCALLY),
    },
    "Run the service": {
        "serve": ("run:serve", "Run the service, with a worker beside it.", LOCAL),
        "work": ("run:work", "Run one worker.", LOCAL),
        "look": ("look:look", "Open the service in a browser, signed in.", CALLS_SERVICE),
        "migrate": ("run:migrate", "Bring the database's schema up to date.", LOCAL),
        "kernels": ("run:kernels", "Compile the rollout kernels into the cache.", LOCAL),
        "keygen": ("run:keygen", "Make a signing key for a log.", LOCAL),
        "login": ("access:login", "Store a token for a service.", CALLS_SERVICE),
        "whoami": ("access:whoami", "Show who you are to the service.", CALLS_SERVICE),
        "token": ("access:tokens", "Issue, list and revoke tokens.", CALLS_SERVICE),
        "project": ("access:projects", "Create and list projects.", CALLS_SERVICE),
        "completion": ("completion:completion", "Install shell completion.", LOCAL),
    },
}
_COMMANDS = {name: of for commands in _GROUPS.values() for name, of in commands.items()}
# which have exit codes of their own
APPS = (
    "plant:app",
    "audit:app",
    "mlflow:app",
    "oci:app",
    "access:tokens",
    "access:projects",
    "webhooks:app",
)
for _place, (_title, _commands) in enumerate(_GROUPS.items()):
    _group = Group(_title, sort_key=_place)
    for _name, (_target, _help, _codes) in _commands.items():
        app.command(
            f"trueup_cli.{_target}",
            name=_name,
            help=_help,
            group=_group,
            **({} if _target in APPS else {"help_epilogue": exit_codes(_codes)}),
        )


def explain_wholly(name: str) -> None:
    """Lets the help of a command be its whole docstring, and not the line that a list has."""
    if _COMMANDS[name][0] not in APPS:
        app[name].help = None


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
            asked = next(iter(sys.argv[1:]), "")
            if asked in _COMMANDS:
                explain_wholly(asked)
            gc.freeze()  # what was loaded stays, so no collection need look through it
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
