// The laboratory: sliders, the viewer, curves.  `webgui` and anywidget's model are given.
const STYLE = `
.ngepc-lab { font: 14px/1.45 system-ui, sans-serif; color: #1c2733; background: #fff; padding: .4rem; }
.ngepc-lab .stage { display: flex; flex-wrap: wrap; gap: .6rem; }
.ngepc-lab .body { flex: 3 1 22rem; min-width: 0; }
.ngepc-lab .place { height: 380px; position: relative; overflow: hidden; }
.ngepc-lab .place > div { position: absolute; inset: 0; }
.ngepc-lab .place div[style*="z-index: 2"] { top: auto !important; bottom: 0; opacity: .85; }
.ngepc-lab .scale { display: flex; align-items: center; gap: .5rem; font-size: 12px; }
.ngepc-lab .bar { flex: 1; max-width: 12rem; height: .7rem; }
.ngepc-lab .caption { font-weight: 600; min-height: 1.45em; }
.ngepc-lab .caption.predicted { color: #b35900; }
.ngepc-lab .said { font-size: 12.5px; color: #45525e; min-height: 2.9em; }
.ngepc-lab .curves { flex: 2 1 16rem; display: flex; flex-direction: column; min-width: 0; }
.ngepc-lab svg { width: 100%; height: 150px; }
.ngepc-lab svg text { font-size: 10px; fill: #45525e; }
.ngepc-lab .sliders { display: grid; grid-template-columns: max-content max-content 1fr 5.5rem; gap: .15rem .7rem; align-items: center; }
.ngepc-lab .sliders button { border: 1px solid #9aa3ad; border-radius: 3px; background: #fff; font-size: 11px; }
.ngepc-lab .lines { font-size: 12px; } .ngepc-lab .lines b { font-weight: 900; }
.ngepc-lab input[type=range] { width: 100%; }
.ngepc-lab output { font-variant-numeric: tabular-nums; }`;

const SVG = "http://www.w3.org/2000/svg";
const WAIT = 5000; // milliseconds without any answer after which there seems to be no kernel
const PART = 1 / 60; // of the range, from one picture to the next while a slider plays

function made(tag, parent, attributes = {}, text = "") {
  const svg = ["svg", "g", "path", "text", "circle", "line"].includes(tag);
  const element = svg ? document.createElementNS(SVG, tag) : document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.textContent = text;
  parent.append(element);
  return element;
}

const shown = value => Number(Number(value).toPrecision(4)).toString();

function ends(values) {
  const low = Math.min(...values), high = Math.max(...values);
  if (low === high) return low === 0 ? [0, 1] : [low - Math.abs(low) / 2, high + Math.abs(high) / 2];
  return [low, high];
}

function plot(svg, curve) {
  const [width, height, left, right, top, bottom] = [320, 150, 46, 8, 18, 30];
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  svg.replaceChildren();
  made("text", svg, { x: left, y: 11, "font-weight": "600" }, curve.title);
  const level = curve.log ? y => Math.log10(Math.max(y, 1e-17)) : y => y;
  const points = curve.lines.flat().map(([x, y]) => [x, level(y)]);
  if (!points.length) return;
  const [x0, x1] = ends(points.map(p => p[0]));
  const [y0, y1] = ends([...points.map(p => p[1]), ...(curve.log ? [] : [0])]);
  const X = x => left + (width - left - right) * (x - x0) / (x1 - x0);
  const Y = y => height - bottom - (height - top - bottom) * (y - y0) / (y1 - y0);
  const axis = { stroke: "#9aa3ad", "stroke-width": 0.8, fill: "none" };
  made("path", svg, { ...axis, d: `M${left},${top}V${height - bottom}H${width - right}` });
  const back = curve.log ? y => `1e${Math.round(y)}` : shown;
  made("text", svg, { x: left - 4, y: top + 8, "text-anchor": "end" }, back(y1));
  made("text", svg, { x: left - 4, y: height - bottom, "text-anchor": "end" }, back(y0));
  made("text", svg, { x: left, y: height - bottom + 12 }, shown(x0));
  made("text", svg, { x: width - right, y: height - bottom + 12, "text-anchor": "end" }, shown(x1));
  const middle = (left + width - right) / 2;
  made("text", svg, { x: middle, y: height - 6, "text-anchor": "middle" }, curve.x);
  for (const line of curve.lines) {
    const path = line.map(([x, y], k) => `${k ? "L" : "M"}${X(x).toFixed(2)},${Y(level(y)).toFixed(2)}`);
    made("path", svg, { d: path.join(""), stroke: "#0072B2", "stroke-width": 1.6, fill: "none" });
    if (line.length === 1) {
      made("circle", svg, { cx: X(line[0][0]), cy: Y(level(line[0][1])), r: 2.5, fill: "#0072B2" });
    }
  }
  if (curve.here) {
    const [x, y] = curve.here;
    made("circle", svg, { cx: X(x), cy: Y(level(y)), r: 3.5, fill: "#D55E00" });
  }
}

export function render({ model, el }) {
  const setup = model.get("setup");
  const root = made("div", el, { class: "ngepc-lab" });
  made("style", root, {}, STYLE);
  const sliders = made("div", root, { class: "sliders" });
  const stage = made("div", root, { class: "stage" });
  const body = made("div", stage, { class: "body" });
  const caption = made("div", body, { class: "caption" });
  const place = made("div", body, { class: "place" });
  const scale = made("div", body, { class: "scale" });
  const lines = made("div", body, { class: "lines" });
  for (const [name, colour] of setup.lines) {
    made("b", lines, { style: `color: ${colour}` }, "— ");
    made("span", lines, {}, `${name}  `);
  }
  const said = made("div", body, { class: "said" });
  const curves = made("div", stage, { class: "curves" });
  const state = { scene: null, busy: false, wanted: null, frames: 0, answered: false, drawn: null };
  root.state = state;

  function draw(frame) {
    state.answered = true;
    state.frames += 1;
    state.drawn = frame;
    caption.textContent = frame.caption;
    caption.className = frame.exact ? "caption" : "caption predicted";
    said.textContent = frame.said;
    if (frame.scene) {
      if (state.scene) state.scene.setRenderData(frame.scene);
      else {
        const inner = made("div", place);
        state.scene = new webgui.Scene();
        state.scene.init(inner, frame.scene, { preserveDrawingBuffer: true });
      }
      const colours = frame.scene.colors.map(c => `rgb(${c.map(v => Math.round(255 * v))})`);
      scale.replaceChildren();
      made("span", scale, {}, shown(frame.scene.funcmin));
      made("span", scale, { class: "bar", style: `background: linear-gradient(90deg, ${colours})` });
      made("span", scale, {}, `${shown(frame.scene.funcmax)}  ${frame.label}`);
    }
    frame.curves.forEach((curve, k) => plot(curves.children[k] || made("svg", curves), curve));
    if (frame.last) { state.busy = false; ask(); }
  }

  function ask() {
    if (state.busy || state.wanted === null) return;
    state.busy = true;
    model.send({ values: state.wanted });
    state.wanted = null;
    setTimeout(() => {
      if (!state.answered) said.textContent = "No answer: the sliders need a running kernel.";
    }, WAIT);
  }

  const inputs = setup.sliders.map(({ name, least, most, step, value }) => {
    const said = name.replaceAll("_", " ");
    made("label", sliders, {}, said);
    const button = made("button", sliders, { title: `play ${said}` }, "▶");
    const input = made("input", sliders, { type: "range", min: least, max: most, step: "any", name });
    const output = made("output", sliders, {}, shown(value));
    input.value = value;
    input.exact = value;
    input.setAttribute("aria-label", said);
    let playing = false;
    const next = () => {
      if (!playing) return;
      if (!state.busy) {
        const further = input.exact + Math.max(step, (most - least) * PART);
        input.value = input.exact >= most ? least : Math.min(further, most);
        input.dispatchEvent(new Event("input"));
      }
      setTimeout(next, 50);
    };
    button.addEventListener("click", () => {
      playing = !playing;
      button.textContent = playing ? "⏸" : "▶";
      if (playing) { input.exact = most; next(); }
    });
    input.addEventListener("input", () => {
      const near = Number((Math.round(input.value / step) * step).toPrecision(12));
      input.exact = Math.min(Math.max(near, least), most);
      output.textContent = shown(input.exact);
      state.wanted = Object.fromEntries(inputs.map(i => [i.name, i.exact]));
      ask();
    });
    return input;
  });
  model.on("msg:custom", draw);
  draw(setup.frame);
  state.answered = false;
  state.frames = 0;
}

export default { render };
