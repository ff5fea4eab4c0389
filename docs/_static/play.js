// The page to play with: sliders, a loop in WebAssembly, and its figures. LOOPS comes from play_loops.js.
"use strict";

const form = document.getElementById("play");
const panels = document.getElementById("play-panels");
const SVG = "http://www.w3.org/2000/svg";
const SETTLED = 0.05; // of a figure's range
const NEAR = 0.2; // likewise
const SHRINKS = 0.8; // swings that shrink by less from a quarter of the time to the next one do not become smaller
const SLIDERS = ["D", "D_hat", "gamma", "noise"];
const SIZES = { left: 44, right: 8, top: 6, bottom: 30 }; // room around a figure, in pixels
const modules = new Map(); // the compiled loop of each scene
let shown; // the last loop: scene, values, rows

const slider = (name) => form.elements[name];
const scene = () => LOOPS[Number(form.elements.scene.value)];

// A slider of gamma is logarithmic, and below its lowest value gamma is 0.
function valueOf(name) {
  const at = Number(slider(name).value);
  return name !== "gamma" ? at : at < Math.log10(scene().gamma[1]) - 1e-9 ? 0 : 10 ** at;
}

function textOf(name, value) {
  if (name === "gamma") return value === 0 ? "0: D̂ stays" : String(Number(value.toPrecision(2)));
  return name === "noise" ? `${(100 * value).toFixed(1)} %` : seconds(value);
}

function place(name) {
  const [first, low, high] = scene()[name], input = slider(name);
  const logarithmic = name === "gamma", step = logarithmic ? 0.1 : name === "noise" ? 0.005 : 0.01;
  input.min = logarithmic ? (Math.log10(low) - step).toFixed(1) : low;
  input.max = logarithmic ? Math.log10(high) : high;
  input.step = step;
  input.value = logarithmic ? Math.log10(first) : first;
}

async function load(of) {
  if (!modules.has(of)) {
    const bytes = Uint8Array.from(atob(of.module), (letter) => letter.charCodeAt(0));
    const { instance } = await WebAssembly.instantiate(bytes, {});
    instance.exports._initialize();
    modules.set(of, instance.exports);
  }
  return modules.get(of);
}

// Rows of X, U and D_hat, each `every` control steps.
function run(exports, of, values, predicts) {
  const width = of.states.length + of.inputs.length + 1, count = Math.floor(Math.round(of.t_end / of.dt) / of.every) + 1;
  const at = exports.play(values.D, values.D_hat, values.gamma, values.noise, predicts ? 1 : 0);
  const numbers = new Float64Array(exports.memory.buffer, at, count * width);
  return Array.from({ length: count }, (_, k) => Array.from(numbers.subarray(k * width, (k + 1) * width)));
}

// How far a row is from rest: the largest share of a state's figure, as that is at first.
function distance(of, row) {
  return Math.max(...of.rest.map((rest, i) => Math.abs(row[i] - rest) / (of.axes[i][1] - of.axes[i][0])));
}

const short = (value) => Number(value.toPrecision(3)).toString().replace("-", "−");
const seconds = (value) => `${value.toFixed(2)} s`;

// What became of the loop.
function outcome({ of, rows }) {
  const dt = of.dt * of.every, far = rows.map((row) => distance(of, row)), quarter = Math.floor(far.length / 4);
  const broken = far.findIndex((value) => !Number.isFinite(value)), out = far.findLastIndex((value) => value > SETTLED);
  if (broken >= 0) return `Overflows at t = ${(broken * dt).toFixed(1)} s.`;
  if (out < far.length - quarter) return `Settled within 5 % at t = ${((out + 1) * dt).toFixed(1)} s.`;
  const [before, last] = [far.slice(-2 * quarter, -quarter), far.slice(-quarter)].map((part) => Math.max(...part));
  if (last < NEAR) return `Not settled in ${of.t_end} s: it stays within ${Math.ceil(100 * last)} % of rest at the end.`;
  if (last < SHRINKS * before) return `Not settled in ${of.t_end} s, but the swings become smaller.`;
  const i = of.states.length - 1, ends = rows.slice(-quarter).map((row) => row[i]);
  return `Does not settle: ${of.states[i]} swings between ${short(Math.min(...ends))} and ${short(Math.max(...ends))} at the end.`;
}

function sentence(loop) {
  const D_hat = loop.rows[loop.rows.length - 1][loop.of.states.length + loop.of.inputs.length];
  const ends = loop.predicts && Number.isFinite(D_hat);
  return outcome(loop) + (ends ? ` D̂ ends at ${seconds(D_hat)}, D is ${seconds(loop.values.D)}.` : "");
}

// Ticks at 1, 2 or 5 times a power of ten.
function ticks(low, high, about) {
  const rough = (high - low) / about, power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((k) => k * power >= rough * 0.999);
  const first = Math.ceil(low / step - 1e-9), last = Math.floor(high / step + 1e-9);
  return Array.from({ length: last - first + 1 }, (_, k) => Number(((first + k) * step).toPrecision(12)));
}

function element(name, attributes, text = "") {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.textContent = text;
  return made;
}

// One figure: `curves` are points (t, y) with a class; `range` is the least that its axis shows.
function draw(svg, t_end, range, curves) {
  const { left, right, top, bottom } = SIZES, width = svg.clientWidth, height = svg.clientHeight;
  const ys = curves.flatMap((curve) => curve.points.map((point) => point[1])).filter(Number.isFinite);
  const low = Math.min(range[0], ...ys), high = Math.max(range[1], ...ys), room = 0.04 * (high - low);
  const x = (t) => left + (t / t_end) * (width - left - right);
  const y = (v) => height - bottom - ((v - low + room) / (high - low + 2 * room)) * (height - top - bottom);
  const parts = [];
  for (const v of ticks(low, high, height > 140 ? 4 : 3)) {
    parts.push(element("path", { class: "grid", d: `M${left} ${y(v)}H${width - right}` }));
    parts.push(element("text", { x: left - 6, y: y(v) + 4, "text-anchor": "end" }, short(v)));
  }
  for (const t of ticks(0, t_end, 4)) {
    const last = t === t_end;
    parts.push(element("path", { class: "grid", d: `M${x(t)} ${top}V${height - bottom}` }));
    parts.push(element("text", { x: x(t), y: height - bottom + 16, "text-anchor": last ? "end" : "middle" }, last ? `t = ${t} s` : t));
  }
  for (const curve of curves) {
    const points = curve.points.filter((point) => Number.isFinite(point[1]) && point[0] <= t_end);
    const d = points.map((point) => `${x(point[0]).toFixed(1)} ${y(point[1]).toFixed(1)}`).join("L");
    if (points.length) parts.push(element("path", { class: curve.kind, d: `M${d}` }));
  }
  svg.replaceChildren(...parts);
}

// The figures of a scene: each a caption with the keys of its curves, its least range, and its curves of a loop.
function figures(of) {
  const n = of.states.length, dt = of.dt * of.every;
  const curve = (rows, i, late = 0) => rows.map((row, k) => [k * dt + late, row[i]]);
  const level = (v) => [[0, v], [of.t_end, v]];
  return [
    ...of.states.map((_, i) => ({
      label: of.labels[i], keys: [["first", "state"], ["second dashed", "rest"]], range: of.axes[i],
      curves: ({ rows }) => [{ kind: "second dashed", points: level(of.rest[i]) }, { kind: "first", points: curve(rows, i) }],
    })),
    {
      label: of.labels[n], keys: [["first", "sent"], ["second", "arrives"]], range: of.axes[n],
      curves: ({ rows, values }) => [
        { kind: "second", points: curve(rows, n, values.D) }, { kind: "first", points: curve(rows, n) },
      ],
    },
    {
      label: "delay (s)", keys: [["first", "D̂"], ["second dashed", "D"]], range: [0, 1.2 * of.D_hat[0]],
      curves: ({ rows, values, predicts }) => [
        { kind: "second dashed", points: level(values.D) },
        ...(predicts ? [{ kind: "first", points: curve(rows, n + of.inputs.length) }] : []),
      ],
    },
  ];
}

function frame(figure) {
  const outer = document.createElement("figure"), caption = document.createElement("figcaption");
  caption.append(`${figure.label}: `);
  for (const [kind, word] of figure.keys) {
    const key = document.createElement("span");
    key.className = `key ${kind}`;
    caption.append(key, ` ${word} `);
  }
  const svg = element("svg", { role: "img", "aria-label": `${figure.label} over time` });
  outer.append(caption, svg);
  return outer;
}

function redraw() {
  if (!shown) return;
  const all = figures(shown.of);
  panels.querySelectorAll("svg").forEach((svg, k) => draw(svg, shown.of.t_end, all[k].range, all[k].curves(shown)));
}

async function update() {
  const of = scene(), exports = await load(of);
  if (of !== scene()) return; // another was chosen meanwhile, and has its own update
  const predicts = form.elements.predicts.checked;
  const values = Object.fromEntries(SLIDERS.map((name) => [name, valueOf(name)]));
  for (const name of SLIDERS) {
    const input = slider(name), text = textOf(name, values[name]);
    input.previousElementSibling.textContent = text;
    input.setAttribute("aria-valuetext", text);
    input.disabled = !predicts && (name === "D_hat" || name === "gamma");
  }
  shown = { of, values, predicts, rows: run(exports, of, values, predicts) };
  document.getElementById("play-sentence").textContent = sentence(shown);
  redraw();
  if (!performance.getEntriesByName("first curve").length) performance.mark("first curve");
}

function choose() {
  shown = undefined; // what the new figures are not of
  SLIDERS.forEach(place);
  form.elements.predicts.checked = true;
  panels.replaceChildren(...figures(scene()).map(frame));
}

let waiting = false;
function soon() {
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(() => {
    waiting = false;
    update();
  });
}

function begin() {
  const notice = document.getElementById("play-notice");
  if (!LOOPS.every((of) => of.module)) {
    notice.textContent = "These pages were built without ziglang, so that there is no loop to play with: pip install ziglang.";
    return;
  }
  notice.hidden = true;
  document.getElementById("play-controls").hidden = false;
  form.elements.scene.append(...LOOPS.map((of, k) => new Option(of.title, k)));
  form.elements.scene.addEventListener("change", choose);
  form.addEventListener("input", soon);
  form.addEventListener("submit", (event) => event.preventDefault());
  form.addEventListener("reset", (event) => {
    event.preventDefault();
    choose();
    soon();
  });
  choose();
  update();
  new ResizeObserver(redraw).observe(panels);
}

begin();
