"""Contrast of text with its background, from the colours that Chromium computes."""

import html
import json
import re
import shutil
import subprocess

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
LEAST = 4.5
"""Of WCAG 2.2, level AA, for text of any size."""
PAGE = """
<!doctype html><body>{frames}<pre id="found"></pre>
<script>
const context = document.createElement("canvas").getContext("2d", {{ willReadFrequently: true }});
const parsed = new Map();
function rgba(colour) {{
  if (!parsed.has(colour)) {{
    context.clearRect(0, 0, 1, 1);
    context.fillStyle = colour;
    context.fillRect(0, 0, 1, 1);
    parsed.set(colour, [...context.getImageData(0, 0, 1, 1).data].map((part) => part / 255));
  }}
  return parsed.get(colour);
}}
const over = ([r, g, b, a], under) => [r, g, b].map((part, i) => part * a + under[i] * (1 - a));
const linear = (part) => (part <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4);
const luminance = (colour) => colour.map(linear).reduce((sum, part, i) => sum + part * [0.2126, 0.7152, 0.0722][i], 0);
function contrast(one, other) {{
  const [dark, light] = [luminance(one), luminance(other)].sort((a, b) => a - b);
  return (light + 0.05) / (dark + 0.05);
}}
function low(page) {{
  const view = page.defaultView;
  for (const folded of page.querySelectorAll("details")) folded.open = true;
  const walker = page.createTreeWalker(page.body, NodeFilter.SHOW_TEXT);
  const found = new Map();
  let texts = 0;
  while (walker.nextNode()) {{
    const text = walker.currentNode.data.trim();
    const element = walker.currentNode.parentElement;
    const range = page.createRange();
    range.selectNodeContents(walker.currentNode);
    if (!text || !element.checkVisibility({{ visibilityProperty: true }}) || !range.getClientRects().length) continue;
    const [layers, style] = [[], view.getComputedStyle(element)];
    let opacity = 1;
    for (let box = element; box; box = box.parentElement) {{
      layers.unshift(rgba(view.getComputedStyle(box).backgroundColor));
      opacity *= Number(view.getComputedStyle(box).opacity);
    }}
    if (!opacity) continue;
    texts += 1;
    const background = layers.reduce((under, layer) => over(layer, under), [1, 1, 1]);
    const own = rgba(element.namespaceURI.endsWith("svg") ? style.fill : style.color);
    const ratio = contrast(over([...own.slice(0, 3), own[3] * opacity], background), background);
    const name = `${{element.tagName}}.${{element.getAttribute("class")}}`;
    if (ratio < {least}) found.set(`${{name}} '${{text.slice(0, 40)}}'`, ratio);
  }}
  const body = view.getComputedStyle(page.body).backgroundColor;
  return {{ texts, background: luminance(rgba(body).slice(0, 3)), low: Object.fromEntries(found) }};
}}
onload = () => {{
  const frames = [...document.querySelectorAll("iframe")];
  document.getElementById("found").textContent = JSON.stringify(frames.map((frame) => low(frame.contentDocument)));
}};
</script></body>
"""


def measured_contrast(pages, folder, *, dark):
    """Per page (HTML): the number of texts, the luminance of the page, and texts with too little contrast."""
    frames = "".join(
        f'<iframe width="1400" height="900" srcdoc="{html.escape(page, quote=True)}"></iframe>' for page in pages
    )
    file = folder / f"contrast-{'dark' if dark else 'light'}.html"
    file.write_text(PAGE.format(frames=frames, least=LEAST), encoding="utf-8")
    command = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={folder / 'profile'}"]
    command += [f"--blink-settings=preferredColorScheme={0 if dark else 1}", "--virtual-time-budget=8000"]
    command += ["--host-resolver-rules=MAP * ~NOTFOUND", "--dump-dom", file.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    return json.loads(html.unescape(re.search(r'<pre id="found">(.*?)</pre>', done.stdout, re.DOTALL)[1]))


def check_contrast(pages, folder, *, dark):
    """Asserts that every text of the pages is readable, and that their colours are those of the wanted scheme."""
    for found in measured_contrast(pages, folder, dark=dark):
        assert found["texts"] > 5
        assert (found["background"] < 0.1) is dark
        assert found["low"] == {}
