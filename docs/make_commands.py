"""Write docs/commands.md from the commands themselves."""

from pathlib import Path

from trueup_cli.exits import MEANING
from trueup_cli.main import _COMMANDS, app, explain_wholly

HEAD = """# Commands

`trueup COMMAND --help` says the same. Tables and colours are for terminals: in a pipe a table is a
line for each row, its cells between tabs. `--json` prints JSON, a refusal too. Progress goes to
standard error. Errors say there what is wrong, under a stable code, and what to do next.

| exit code | meaning |
|---|---|
{codes}

`eval "$(trueup completion bash)"` lets the shell complete commands, options and names of plants;
`trueup completion --install` does so for good.

"""


def page() -> str:
    """The page's text."""
    codes = "\n".join(f"| {code} | {meaning} |" for code, meaning in MEANING.items())
    for name in _COMMANDS:
        explain_wholly(name)
    written = app.generate_docs(
        output_format="markdown", flatten_commands=True, heading_level=2, usage_name="trueup"
    )
    lines = [line.rstrip() for line in written[written.index("## trueup try") :].splitlines()]
    return HEAD.format(codes=codes) + "\n".join(lines).rstrip() + "\n"


if __name__ == "__main__":
    (Path(__file__).parent / "commands.md").write_text(page())
