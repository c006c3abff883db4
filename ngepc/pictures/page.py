"""HTML pages of interactive scenes and images, with a slider, complete in one file.

The viewer is NGSolve's webgui, whose script is embedded: the pages need no network.  They open
from disk in any browser with WebGL 2; ``page.html#3`` starts at frame 3.
"""

from __future__ import annotations

import html
import importlib.util
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

EXTRA = 'pip install "ngepc[notebook]"'

STYLE = """
:root { color-scheme: light dark; --ink: #1c2733; --soft: #5c6873; --line: #d9dee3;
        --paper: #ffffff; --accent: #1f5a8c; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e6eaee; --soft: #a3adb7; --line: #39434d; --paper: #161b20; --accent: #7db4e6; }
}
* { box-sizing: border-box; }
body { margin: 0; color: var(--ink); background: var(--paper);
       font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; }
"""

_PAGE_STYLE = """
body { height: 100vh; display: flex; flex-direction: column; }
header { padding: .5rem .9rem .35rem; display: flex; flex-wrap: wrap; gap: .2rem 1.6rem;
         align-items: center; justify-content: space-between; }
.legend { display: flex; flex-wrap: wrap; gap: .1rem .9rem; align-items: center; font-size: .8rem;
          color: var(--soft); }
.legend > div { width: 17rem; }
.scale { height: .6rem; border-radius: 2px; border: 1px solid var(--line); }
.ticks { display: flex; justify-content: space-between; font-variant-numeric: tabular-nums; }
h1 { font-size: 1rem; margin: 0; font-weight: 600; }
main { flex: 1; min-height: 0; display: flex; flex-wrap: wrap; gap: 1px; background: var(--line); }
figure { flex: 1 1 18rem; min-height: 12rem; margin: 0; display: flex; flex-direction: column;
         background: var(--paper); container-type: inline-size; }
figcaption { padding: .2rem .9rem; font-size: .85rem; color: var(--soft); }
.place { flex: 1; min-height: 0; max-height: 90cqw; position: relative; overflow: hidden;
         background: #ffffff; color: #1c2733; }
.place > div { position: absolute; inset: 0; }
.place img { width: 100%; height: 100%; object-fit: contain; display: block; }
.place p { color: #1c2733; padding: 1rem; }
.place div[style*="z-index: 2"] { top: auto !important; bottom: 0; opacity: .85; }
canvas { cursor: grab; } canvas:active { cursor: grabbing; }
footer { display: flex; gap: .9rem; align-items: center; padding: .45rem .9rem; font-size: .9rem; }
input[type=range] { flex: 1; accent-color: var(--accent); min-width: 6rem; }
output { min-width: 8rem; font-variant-numeric: tabular-nums; }
"""

_SCRIPT = """
const page = JSON.parse(document.getElementById("page").textContent);
const scenes = page.panels.map((panel, k) => {
  const place = document.getElementById("place-" + k);
  if (panel.kind === "image") {
    const image = document.createElement("img");
    image.alt = panel.caption;
    place.append(image);
    return { show: frame => { image.src = panel.frames[frame]; } };
  }
  let scene = null;
  return { show: frame => {
    if (scene) { scene.setRenderData(panel.frames[frame]); return; }
    try {
      const inner = document.createElement("div");
      place.append(inner);
      scene = new webgui.Scene();
      scene.init(inner, panel.frames[frame], { preserveDrawingBuffer: true });
    } catch (error) {
      place.innerHTML = "<p>This view needs WebGL 2, which this browser does not offer.</p>";
      throw error;
    }
  } };
});
const slider = document.getElementById("slider");
function show(frame) {
  frame = Math.min(Math.max(frame, 0), page.labels.length - 1);
  scenes.forEach(scene => scene.show(frame));
  document.body.dataset.frame = frame;
  if (slider) {
    slider.value = frame;
    document.getElementById("label").textContent = page.labels[frame];
  }
}
if (slider) slider.addEventListener("input", () => show(Number(slider.value)));
addEventListener("hashchange", () => show(Number(location.hash.slice(1)) || 0));
show(Number(location.hash.slice(1)) || 0);
"""


@dataclass(frozen=True, eq=False)
class Panel:
    """One place of a page and what it shows at each position of the slider.

    Parameters
    ----------
    kind
        'scene' (webgui data) or 'image' (data addresses of pictures).
    caption
        Text above it.
    frames
        The data, one for each position of the slider.
    """

    kind: str
    caption: str
    frames: Sequence[dict | str]


@dataclass(frozen=True)
class Legend:
    """The colour scale of a page: label, values at the ends, colours from the least to the most.

    Parameters
    ----------
    label
        What the colours mean, with its unit.
    least, most
        Values at the ends.
    colours
        CSS colours, evenly spaced.
    below, above
        Whether there are values outside, drawn in the colours of the ends.
    """

    label: str
    least: float
    most: float
    colours: Sequence[str]
    below: bool = False
    above: bool = False

    def markup(self) -> str:
        """The scale with five values below it."""
        step = (self.most - self.least) / 4
        size = max(abs(self.least), abs(self.most))
        values = [self.least + k * step for k in range(5)]
        form = ".0f" if 1e3 <= size < 1e5 else ".3g"
        texts = [format(0.0 if abs(v) < 1e-9 * size else v, form) for v in values]
        texts[0] = ("≤ " if self.below else "") + texts[0]
        texts[-1] = ("≥ " if self.above else "") + texts[-1]
        ticks = "".join(f"<span>{text.replace('-', '−')}</span>" for text in texts)
        gradient = f"background:linear-gradient(90deg,{','.join(self.colours)})"
        return (
            f'<div class="legend"><span>{html.escape(self.label)}</span>'
            f'<div><div class="scale" style="{gradient}"></div>'
            f'<div class="ticks">{ticks}</div></div></div>'
        )


def page(
    title: str,
    panels: Sequence[Panel],
    labels: Sequence[str] = ("",),
    name: str = "",
    legend: Legend | None = None,
) -> str:
    """The HTML of a page with panels side by side, and a slider if there are several labels.

    Parameters
    ----------
    title
        Heading of the page.
    panels
        At least one; all have as many frames as there are labels.
    labels
        Text for each position of the slider.
    name
        What the slider moves through, such as 'gamma' or 'load step'.
    legend
        Colour scale shared by all panels.

    Raises
    ------
    ValueError
        If there are no panels, or the numbers of frames and labels differ.
    ImportError
        If a scene is to be shown and the viewer's script is not installed.
    """
    if not panels:
        raise ValueError("panels=[]: at least one panel is needed")
    for panel in panels:
        if len(panel.frames) != len(labels):
            raise ValueError(
                f"the panel {panel.caption!r} has {len(panel.frames)} frames for "
                f"{len(labels)} labels: one frame for each label is needed"
            )
    data = {
        "labels": list(labels),
        "panels": [{"kind": p.kind, "caption": p.caption, "frames": p.frames} for p in panels],
    }
    scenes = any(panel.kind == "scene" for panel in panels)
    viewer = f"<script>{viewer_script()}</script>" if scenes else ""
    figures = "".join(
        f'<figure>{_caption(panel)}<div class="place" id="place-{k}"></div></figure>'
        for k, panel in enumerate(panels)
    )
    heading = f"<h1>{html.escape(title)}</h1>" if title else ""
    text = json.dumps(data, default=float).replace("</", "<\\/")
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{html.escape(title or 'ngepc')}</title>"
        f"<style>{STYLE}{_PAGE_STYLE}</style></head><body>"
        f"<header>{heading}{legend.markup() if legend else ''}</header>"
        f"<main>{figures}</main>"
        f"{_slider(labels, name)}"
        f'<script type="application/json" id="page">{text}</script>'
        f"{viewer}<script>{_SCRIPT}</script></body></html>\n"
    )


def _caption(panel: Panel) -> str:
    return f"<figcaption>{html.escape(panel.caption)}</figcaption>" if panel.caption else ""


def _slider(labels: Sequence[str], name: str) -> str:
    if len(labels) < 2:
        return ""
    return (
        f'<footer><label for="slider">{html.escape(name)}</label>'
        f'<input type="range" id="slider" min="0" max="{len(labels) - 1}" step="1" value="0">'
        '<output id="label" for="slider"></output></footer>'
    )


def viewer_installed() -> bool:
    """Whether the viewer's script is there, so that interactive pages can be made."""
    found = importlib.util.find_spec("webgui_jupyter_widgets")
    return found is not None and found.origin is not None


def viewer_script() -> str:
    """The JavaScript of NGSolve's viewer.

    Raises
    ------
    ImportError
        If it is not installed; the message says what to install.
    """
    if not viewer_installed():
        raise ImportError(
            "interactive views need the package webgui_jupyter_widgets, which brings NGSolve's "
            f"viewer for offline use: {EXTRA}"
        )
    origin = importlib.util.find_spec("webgui_jupyter_widgets").origin
    return (Path(origin).parent / "js" / "webgui.js").read_text(encoding="utf-8")


def frame(content: str, height: int = 480) -> str:
    """HTML of an inline frame that holds a whole page, for notebooks and reports."""
    return (
        f'<iframe srcdoc="{html.escape(content)}" loading="lazy" title="interactive view" '
        f'style="width:100%;height:{height}px;border:1px solid #8884;border-radius:4px"></iframe>'
    )
