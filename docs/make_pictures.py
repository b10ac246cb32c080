"""Take the pictures of the documentation from a diagnosis that runs now, on the recordings in
examples/."""

import subprocess
import sys
import tempfile
from pathlib import Path

from tests.support.browser import browsing

ROOT = Path(__file__).parent.parent
WIDTH, SCALE = 1080, 1.5


def main() -> None:
    """Diagnose, open the report, and take the pictures."""
    with tempfile.TemporaryDirectory() as out:
        command = [
            sys.executable,
            "-m",
            "trueup_cli.main",
            "diagnose",
            str(ROOT / "examples" / "emps"),
            "--out",
            out,
        ]
        subprocess.run(command, cwd=ROOT, check=True)
        with browsing() as browser:
            page = browser.new_page(
                viewport={"width": WIDTH, "height": 900}, device_scale_factor=SCALE
            )
            page.goto((Path(out) / "report.html").as_uri())
            page.wait_for_selector("#recordings canvas")
            page.get_by_role("radio", name="the nominal model").check()
            maps = page.locator(".layer.nominal").first.bounding_box()
            below = maps["y"] + maps["height"] + 8
            page.screenshot(
                path=ROOT / "docs" / "pictures" / "diagnosis.png",
                clip={"x": 0, "y": 0, "width": WIDTH, "height": below},
            )
            plots = page.locator("section[aria-labelledby=recorded]")
            plots.screenshot(path=ROOT / "docs" / "pictures" / "diagnosis-recordings.png")


if __name__ == "__main__":
    main()
