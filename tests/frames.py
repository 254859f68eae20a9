"""Pages in frames of one real browser, whose start takes a second, and what functions of JavaScript find in them."""

import html
import json
import re
import subprocess
from dataclasses import dataclass

from tests.contrast import CHROMIUM

PAGE = """
<!doctype html><body>{frames}<pre id="found"></pre>
<script>
onload = async () => {{
  const frames = [...document.querySelectorAll("iframe")];
  const found = [{functions}].map((ask, number) => ask(frames[number].contentDocument));
  document.getElementById("found").textContent = JSON.stringify(await Promise.all(found));
}};
</script></body>
"""


@dataclass(frozen=True)
class Frame:
    """A page (HTML) in a frame of a width (px), and the function of its document, whose result is wanted."""

    page: str
    width: int
    ask: str

    @property
    def tag(self):
        return f'<iframe width="{self.width}" height="900" srcdoc="{html.escape(self.page, quote=True)}"></iframe>'


def html_after_scripts(address, folder, *options):
    """The page once its scripts have run."""
    command = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={folder / 'profile'}"]
    command += [*options, "--dump-dom", address]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=True).stdout


def found_in(frames, folder):
    """What the browser finds in each frame, or what the promise of its function becomes."""
    file = folder / "frames.html"
    tags, functions = "".join(frame.tag for frame in frames), ", ".join(frame.ask for frame in frames)
    file.write_text(PAGE.format(frames=tags, functions=functions))
    found = html_after_scripts(file.as_uri(), folder, "--virtual-time-budget=8000")
    return json.loads(html.unescape(re.search(r'<pre id="found">(.*?)</pre>', found, re.DOTALL)[1]))
