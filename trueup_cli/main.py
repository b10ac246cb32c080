"""`trueup`: the one place that may import everything. Commands import what they need when they run, so that `--help` is quick."""

from __future__ import annotations

import sys

from cyclopts import App

from trueup import __version__

app = App(
    name="trueup",
    version=__version__,
    help="Find where a robot's dynamics model is wrong, correct it, and serve the correction only if it has earned it.",
)

_COMMANDS = {
    "serve": ("run:serve", "Run the service, with a worker beside it."),
    "look": ("look:look", "Open the service in a browser, signed in."),
    "work": ("run:work", "Run one worker."),
    "migrate": ("run:migrate", "Bring the database's schema up to date."),
    "kernels": ("run:kernels", "Compile the rollout kernels into the cache."),
    "plant": ("plant:app", "Register and look at plants."),
    "upload": ("registry:upload", "Upload recordings."),
    "fit": ("registry:fit", "Fit a candidate from adaptation episodes."),
    "diagnosis": ("registry:diagnosis", "The same as a job of the service, on uploaded episodes."),
    "gate": ("registry:gate", "Judge a candidate by a declared gate against what serves."),
    "calibrate": ("monitor:calibrate", "Calibrate a monitor of what serves, to a promise in operating hours."),
    "monitor": ("monitor:monitor", "Say whether a plant's model is watched, and what was seen."),
    "alarms": ("monitor:alarms", "List alarms, with what changed, or close one."),
    "policy": ("monitor:policy", "Say or declare what may happen to a plant's model without a person."),
    "serving": ("serving:serving", "Say what serves, or what served when."),
    "promote": ("serving:promote", "Serve the candidate of an accepted decision."),
    "approve": ("serving:approve", "Approve a decision, where a promotion takes two people."),
    "rollback": ("serving:rollback", "Serve what served before, after its switchback test."),
    "fetch": ("serving:fetch", "Fetch a model, every byte verified."),
    "convert": ("convert:convert", "Write a fetched model as ONNX or MJCF."),
    "evidence": ("channels:evidence", "List what was found of a version, and at which stage, or add to it."),
    "channels": ("channels:channels", "Say what each channel serves, or declare one."),
    "release": ("channels:release", "Serve what serves, or another version that did, on a channel."),
    "init": ("init:init", "Make a case folder from recordings alone, such as a ROS 2 bag."),
    "diagnose": ("diagnose:run", "Say where the gap lies, which effect causes it, and how far it shrinks."),
    "blindtrial": ("blindtrial:run", "Hide effects in machines like yours and say how often the diagnosis is right."),
    "excite": ("excite:excite", "Design a bounded excitation, safe under every model still in play."),
    "predict": ("predict:predict", "Roll a model out over an episode."),
    "login": ("access:login", "Keep a token for a service."),
    "whoami": ("access:whoami", "Say whom the service takes you for."),
    "token": ("access:tokens", "Issue, list and revoke tokens."),
    "project": ("access:projects", "Create and list projects."),
    "audit": ("audit:app", "Print or verify the audit log."),
    "replay": ("audit:replay", "Recompute a decision and say whether it agrees."),
    "backup": ("archives:backup", "Write all that is kept, while the service runs."),
    "restore": ("archives:restore", "Bring a backup back into empty storage."),
    "export": ("archives:export", "Write a plant with its whole history as one file."),
    "import": ("archives:import_", "Bring an exported plant in, verified."),
    "gc": ("archives:gc", "Remove bytes that nothing names."),
    "fsck": ("fsck:fsck", "Check this installation's own storage: log, rows, bytes, nothing lost, nothing left over."),
    "keygen": ("run:keygen", "Make a signing key for a log."),
    "doctor": ("doctor:doctor", "Say what this installation has, and what is missing for what."),
    "chapter": ("chapter:chapter", "Reproduce the chapter's figures beside the published digits."),
    "demo": ("demo:demo", "Run the main job on a real recording."),
}
APPS = ("plant:app", "audit:app", "access:tokens", "access:projects")  # with help of their own
for _name, (_where, _help) in _COMMANDS.items():
    app.command(f"trueup_cli.{_where}", name=_name, **({} if _where in APPS else {"help": _help}))


def main() -> None:
    """Run a command. Exit codes: 0 done, 1 refused, 2 misused, 3 the service does not answer, 4 a replay or a log disagrees."""
    try:
        app()
    except KeyboardInterrupt:
        sys.exit(130)
    except Exception as error:
        from trueup_cli.complaints import complain  # what it needs to print loads slowly, and a server never complains

        code = complain(error)
        if code is None:
            raise
        sys.exit(code)


if __name__ == "__main__":
    main()
