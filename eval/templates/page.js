"use strict";
// The page's own script: an overview that sorts and filters, and the inspector. Plots are plotly.js's.
(() => {
const $ = (id) => document.getElementById(id);

// --- overview --------------------------------------------------------------------------------------------------------

const results = $("results");
if (results) {
  const body = results.tBodies[0], rows = [...body.rows];
  const words = rows.map((row) => (row.cells[0].textContent + " " + row.cells[1].textContent).toLowerCase());

  const filter = () => {
    const sought = $("filter-text").value.toLowerCase().split(/\s+/).filter(Boolean);
    const method = $("filter-method").value, status = $("filter-status").value, verdict = $("filter-verdict").value;
    let shown = 0;
    rows.forEach((row, i) => {
      row.hidden = !(sought.every((word) => words[i].includes(word)) && (!method || row.dataset.method === method)
        && (!status || row.dataset.status === status) && (!verdict || row.dataset.verdict === verdict));
      shown += !row.hidden;
    });
    $("filter-count").textContent = `${shown} of ${rows.length}`;
  };
  for (const id of ["filter-text", "filter-method", "filter-verdict", "filter-status"]) $(id).addEventListener("input", filter);

  // What is not known comes last, whichever way the rest is sorted.
  const sortBy = (column, descending) => {
    const key = (row) => {
      const cell = row.cells[column];
      return column < 3 ? cell.textContent : Number(cell.dataset.value === "inf" ? Infinity : cell.dataset.value);
    };
    const order = (a, b) => {
      if (column < 3) return a.localeCompare(b, undefined, { numeric: true }) * (descending ? -1 : 1);
      if (Number.isNaN(a) || Number.isNaN(b)) return Number.isNaN(a) - Number.isNaN(b);
      return (a < b ? -1 : a > b ? 1 : 0) * (descending ? -1 : 1);
    };
    body.append(...rows.map((row) => [key(row), row]).sort((a, b) => order(a[0], b[0])).map((pair) => pair[1]));
  };
  [...results.tHead.rows[0].cells].forEach((th, column) => th.querySelector("button").addEventListener("click", () => {
    const descending = th.getAttribute("aria-sort") === "ascending";
    for (const other of results.tHead.rows[0].cells) other.removeAttribute("aria-sort");
    th.setAttribute("aria-sort", descending ? "descending" : "ascending");
    sortBy(column, descending);
  }));
}

let opened = [];
addEventListener("beforeprint", () => {
  opened = [...document.querySelectorAll("details:not([open], .figures)")]; // figures are not printed
  for (const details of opened) details.open = true;
});
addEventListener("afterprint", () => { for (const details of opened) details.open = false; });

// --- numbers of pixels: see eval/readout.py --------------------------------------------------------------------------

async function unpacked(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const planes = new Uint8Array(await new Response(stream).arrayBuffer());
  const count = planes.length / 2, code = new Uint16Array(count);
  for (let i = 0, sum = 0; i < count; i++) {
    sum = (sum + (planes[i] << 8) + planes[count + i]) & 65535;
    code[i] = sum;
  }
  return code;
}

async function unpackFixed({ text, decimals }) {
  const code = new Int16Array((await unpacked(text)).buffer), count = code.length / 3, scale = 10 ** -decimals;
  const at = (i) => [0, 1, 2].map((k) => (code[k * count + i] === -32768 ? NaN : code[k * count + i] * scale));
  return { at, words: (i) => at(i).map((v) => (Number.isNaN(v) ? "–" : v.toFixed(decimals))).join("  ") };
}

async function unpackDegrees(text) {
  const code = await unpacked(text);
  const at = (i) => {
    if (code[i] === 0) return NaN;
    if (code[i] === 65535) return 0;
    const c = code[i] - 1;
    return (1000 + (c % 9000)) * 10 ** (Math.floor(c / 9000) - 7);
  };
  return { at, words: (i) => (code[i] === 0 ? "not scored" : code[i] === 65535 ? "below 0.0001°" : `${at(i).toPrecision(4)}°`) };
}

async function unpackReasons(text) {
  const code = text ? await unpacked(text) : null;
  return { words: (i) => (code ? constants.reasons[code[i]] ?? "–" : "–") };
}

// --- inspector -------------------------------------------------------------------------------------------------------

if (!$("inspector")) return;
const constants = JSON.parse($("constants").textContent);
const texts = [...document.querySelectorAll("script.viewer")];
const pictures = texts.map((script) => ({ anchor: script.dataset.anchor, id: script.dataset.id, data: null, script }));
const NAMES = ["picture", "true normals", "estimate", "error"];
const dark = matchMedia("(prefers-color-scheme: dark)");
const ink = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const LETTERS = ["", "2", "3", "4"];
const CLEAR = "rgba(0,0,0,0)"; // the page's own ground shows, light or dark
const font = () => ({ family: "system-ui, sans-serif", size: 12, color: ink("--ink") });
const QUIET = { displaylogo: false, responsive: true, logging: 0 };
const coarse = matchMedia("(pointer: coarse)").matches;
let shown = null; // { item, which, picture, truth, normals, error, stated, doubtful, preview }
let light = [Math.SQRT1_2, 0, Math.SQRT1_2];
let pixel = null; // the one read out, in the picture as the page has it
let asked = 0; // number of the last request to show something: an older one that ends later is dropped

function parsed(picture) {
  picture.data ??= JSON.parse(picture.script.textContent);
  return picture.data;
}

const encoded = (v) => 255 * (v <= 0.0031308 ? 12.92 * Math.max(v, 0) : 1.055 * Math.min(v, 1) ** (1 / 2.4) - 0.055);

// (H, W) colours by a function of the pixel, on a canvas.
function painted(canvas, [height, width], colour) {
  canvas.width = width;
  canvas.height = height;
  const context = canvas.getContext("2d"), image = context.createImageData(width, height);
  for (let i = 0; i < width * height; i++) {
    const [r, g, b, a = 255] = colour(i);
    image.data.set([r, g, b, a], 4 * i);
  }
  context.putImageData(image, 0, 0);
  return canvas;
}

const ofNormal = (n, missing) => (Number.isNaN(n[0]) ? missing : n.map((v) => 127.5 * v + 127.5));

// The picture with stripes, black beside white, on the pixels that the result itself doubts: see eval/maps.py hatched.
async function hatched({ item, doubtful }) {
  const [height, width] = item.size, factor = Math.max(1, Math.ceil(512 / Math.max(height, width)));
  const image = new Image();
  image.src = item.preview;
  await image.decode();
  const canvas = document.createElement("canvas");
  canvas.width = width * factor;
  canvas.height = height * factor;
  const context = canvas.getContext("2d");
  context.imageSmoothingEnabled = false;
  context.drawImage(image, 0, 0, canvas.width, canvas.height);
  if ($("look-doubtful").checked) {
    const pixels = context.getImageData(0, 0, canvas.width, canvas.height);
    const stripe = Math.max(1, Math.floor(Math.max(canvas.width, canvas.height) / 256));
    for (let y = 0; y < canvas.height; y++) for (let x = 0; x < canvas.width; x++) {
      const at = Math.floor((x + y) / stripe) % constants.stripe_every;
      if (at < 2 && doubtful[Math.floor(y / factor) * width + Math.floor(x / factor)]) pixels.data.set(at ? [255, 255, 255, 255] : [0, 0, 0, 255], 4 * (y * canvas.width + x));
    }
    context.putImageData(pixels, 0, 0);
  }
  return { source: canvas.toDataURL(), factor };
}

function paints({ truth, normals, error }) {
  const { declined, palette, low, high } = constants, span = Math.log(high / low);
  const off = [0, 0, 0, 0], missing = (i) => (Number.isNaN(truth.at(i)[0]) ? off : declined);
  return [
    null, // the preview, hatched
    (i) => ofNormal(truth.at(i), off),
    (i) => ofNormal(normals.at(i), missing(i)),
    (i) => {
      const e = error.at(i);
      return Number.isNaN(e) ? missing(i) : palette[Math.round(255 * Math.min(Math.max(Math.log(e / low) / span, 0), 1))];
    },
  ];
}

// Four panes in a row, or two by two where the page is narrow; their zoom is one.
function panes(view) {
  const [height, width] = view.item.size, total = $("panes").clientWidth, columns = total < 640 ? 2 : 4;
  const gap = 8, heading = 22, side = (total - gap * (columns - 1)) / columns, tall = Math.min((side * height) / width, 720);
  const rows = 4 / columns, full = rows * (tall + heading);
  const layout = {
    width: total, height: full, margin: { l: 0, r: 0, t: 0, b: 0 }, font: font(), showlegend: false,
    dragmode: coarse ? false : "zoom", hovermode: "closest", annotations: [], shapes: [], plot_bgcolor: CLEAR, paper_bgcolor: CLEAR,
  };
  const canvas = document.createElement("canvas");
  const traces = paints(view).map((paint, k) => {
    const column = k % columns, row = Math.floor(k / columns), left = column * (side + gap), top = row * (tall + heading) + heading;
    const x = `xaxis${LETTERS[k]}`, y = `yaxis${LETTERS[k]}`, bare = { showgrid: false, zeroline: false, showticklabels: false, ticks: "" };
    layout[x] = { ...bare, domain: [left / total, (left + side) / total], range: [-0.5, width - 0.5], anchor: `y${LETTERS[k]}`, constrain: "domain" };
    layout[y] = { ...bare, domain: [1 - (top + tall) / full, 1 - top / full], range: [height - 0.5, -0.5], anchor: `x${LETTERS[k]}`, scaleanchor: `x${LETTERS[k]}`, constrain: "domain" };
    if (k) Object.assign(layout[x], { matches: "x" }), Object.assign(layout[y], { matches: "y" }), delete layout[y].scaleanchor;
    layout.annotations.push({ text: NAMES[k], x: left / total, y: 1 - (top - heading) / full, xref: "paper", yref: "paper", xanchor: "left", yanchor: "top", showarrow: false });
    layout.shapes.push({ type: "rect", xref: `x${LETTERS[k]}`, yref: `y${LETTERS[k]}`, x0: -9, x1: -9, y0: -9, y1: -9, line: { color: "#fff", width: 1.5 } });
    layout.shapes.push({ type: "rect", xref: `x${LETTERS[k]}`, yref: `y${LETTERS[k]}`, x0: -9, x1: -9, y0: -9, y1: -9, line: { color: "#000", width: 1.5, dash: "dot" } });
    const { source, factor } = paint ? { source: painted(canvas, view.item.size, paint).toDataURL(), factor: 1 } : view.preview;
    return { type: "image", source, dx: 1 / factor, dy: 1 / factor, x0: 0.5 / factor - 0.5, y0: 0.5 / factor - 0.5, xaxis: `x${LETTERS[k]}`, yaxis: `y${LETTERS[k]}`, hoverinfo: "none" };
  });
  return Plotly.react("panes", traces, layout, { ...QUIET, responsive: false, scrollZoom: false, displayModeBar: coarse, modeBarButtons: [["zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d"]] });
}

function read(x, y) {
  const { item, picture, truth, normals, error, stated, reasons } = shown, [height, width] = item.size;
  if (!(x >= 0 && y >= 0 && x < width && y < height)) return;
  pixel = [x, y];
  const i = y * width + x, reach = Math.max(width, height) / 80;
  $("read-pixel").textContent = `${x * item.step}, ${y * item.step}`;
  $("read-picture").textContent = picture.words(i);
  $("read-truth").textContent = truth.words(i);
  $("read-normal").textContent = normals.words(i);
  $("read-error").textContent = error.words(i);
  $("read-stated").textContent = stated.words(i).replace("not scored", "–");
  $("read-reason").textContent = reasons.words(i);
  const moved = {};
  for (let k = 0; k < 8; k++) Object.assign(moved, { [`shapes[${k}].x0`]: x - reach, [`shapes[${k}].x1`]: x + reach, [`shapes[${k}].y0`]: y - reach, [`shapes[${k}].y1`]: y + reach });
  return Plotly.relayout("panes", moved);
}

// The pixel of before, in the picture or under the method that is shown now.
function readAgain() {
  const [height, width] = shown.item.size;
  if (pixel && pixel[0] < width && pixel[1] < height) return read(...pixel);
  pixel = null;
  for (const dd of document.querySelectorAll("#readout dd")) dd.textContent = "–";
}

let pending = null;
function readSoon(event) {
  $("readout").setAttribute("aria-live", "off"); // a pointer crosses too many to be told of each
  const point = event.points[0], idle = !pending;
  pending = [Math.round(point.x), Math.round(point.y)];
  if (idle) requestAnimationFrame(async () => { const at = pending; pending = null; await read(...at); });
}

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const modified = (event) => event.altKey || event.ctrlKey || event.metaKey;

// Both axes about the pixel, by a factor; no closer than eight pixels, no wider than the picture.
function zoom(factor) {
  const [height, width] = shown.item.size, [x, y] = pixel ?? [width >> 1, height >> 1], { xaxis } = $("panes").layout;
  const span = Math.min(Math.max((xaxis.range[1] - xaxis.range[0]) * factor, 8), width), tall = (span * height) / width;
  if (span === width) return whole();
  return Plotly.relayout("panes", { "xaxis.range": [x - span / 2, x + span / 2], "yaxis.range": [y + tall / 2, y - tall / 2] });
}

function whole() {
  const [height, width] = shown.item.size;
  return Plotly.relayout("panes", { "xaxis.range": [-0.5, width - 0.5], "yaxis.range": [height - 0.5, -0.5] });
}

async function step([across, down]) {
  const [height, width] = shown.item.size, within = (v, size) => Math.min(Math.max(v, 0), size - 1);
  const [x, y] = pixel ? [within(pixel[0] + across, width), within(pixel[1] + down, height)] : [width >> 1, height >> 1];
  $("readout").setAttribute("aria-live", "polite");
  await read(x, y);
  const { xaxis, yaxis } = $("panes").layout;
  if (x < xaxis.range[0] || x > xaxis.range[1] || y < yaxis.range[1] || y > yaxis.range[0]) await zoom(1); // follow it
}

$("panes").addEventListener("keydown", (event) => {
  if (!shown || modified(event)) return;
  const arrow = ARROWS[event.key];
  if (arrow) step(arrow.map((v) => v * (event.shiftKey ? 10 : 1)));
  else if (event.key === "+" || event.key === "=") zoom(0.5);
  else if (event.key === "-") zoom(2);
  else if (event.key === "Escape") whole();
  else return;
  event.preventDefault();
});

const SPACE = { showbackground: false, showspikes: false, tickfont: { size: 10 }, nticks: 5 };

function spaceLayout(names, camera, more = {}) {
  const [x, y, z] = names.map((name) => ({ ...SPACE, gridcolor: ink("--line"), zerolinecolor: ink("--rule"), ...more, title: { text: name } }));
  return { margin: { l: 0, r: 0, t: 0, b: 0 }, font: font(), paper_bgcolor: CLEAR, showlegend: false, uirevision: names.join(), scene: { xaxis: x, yaxis: y, zaxis: z, aspectmode: "cube", camera, dragmode: "orbit" } };
}

const threeD = (id, traces, layout) => Plotly.react(id, traces, layout, { ...QUIET, displayModeBar: false, scrollZoom: false });

function cloud({ item, which }) {
  const own = $("cloud-space").value === "axes" && which.ellipsoid;
  const M = own ? which.ellipsoid.to_sphere : [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
  const times = (v, A) => [0, 1, 2].map((j) => v[0] * A[0][j] + v[1] * A[1][j] + v[2] * A[2][j]);
  const axes = (points) => ({ x: points.map((p) => p[0]), y: points.map((p) => p[1]), z: points.map((p) => p[2]) });
  const traces = ["1", "0"].map((flag) => ({
    type: "scatter3d", mode: "markers", hoverinfo: "skip", marker: { size: 2, color: flag === "1" ? constants.accepted : constants.rejected },
    ...axes(item.colours.filter((_, i) => which.on[i] === flag).map((rho) => times(rho, M))),
  }));
  if (which.ellipsoid) {
    const back = own ? null : inverse(which.ellipsoid.to_sphere);
    const wire = which.ellipsoid.wire.flatMap((line) => [...line.map((u) => (own ? u : times(u, back))), [null, null, null]]);
    traces.push({ type: "scatter3d", mode: "lines", hoverinfo: "skip", line: { color: ink("--soft"), width: 1.5 }, connectgaps: false, ...axes(wire) });
  }
  const names = own ? ["axis 1", "axis 2", "axis 3"] : ["R", "G", "B"];
  const away = own ? 1.4 : 1;
  const layout = spaceLayout(names, { eye: { x: 1.5 * away, y: -1.9 * away, z: 1.05 * away }, center: { x: 0, y: 0, z: -0.12 } });
  layout.scene.aspectmode = own ? "data" : "cube"; // natural light makes the ellipsoid too thin to see in RGB as it is
  return threeD("cloud", traces, layout);
}

function inverse([[a, b, c], [d, e, f], [g, h, i]]) {
  const A = e * i - f * h, B = f * g - d * i, C = d * h - e * g, det = a * A + b * B + c * C;
  return [[A, c * h - b * i, b * f - c * e], [B, a * i - c * g, c * d - a * f], [C, b * g - a * h, a * e - b * d]].map((row) => row.map((v) => v / det));
}

function lights({ item, which }) {
  const steps = [...Array(25).keys()].map((k) => (k * Math.PI) / 12), polar = [...Array(9).keys()].map((k) => (k * Math.PI) / 16);
  const dome = (f) => polar.map((t) => steps.map((a) => f(t, a)));
  const traces = [{ type: "surface", showscale: false, opacity: 0.35, hoverinfo: "skip", colorscale: [[0, "#9fb3c8"], [1, "#eef2f6"]],
    x: dome((t, a) => Math.sin(t) * Math.cos(a)), y: dome((t, a) => Math.sin(t) * Math.sin(a)), z: dome((t) => Math.cos(t)) }];
  for (const { name, direction } of item.lights) {
    const [x, y, z] = direction.map((v) => [0, 1.15 * v]);
    // A name is plain text here: plotly reads a few tags in texts, and nothing else that looks like one may pass.
    traces.push({ type: "scatter3d", mode: "lines+markers+text", hoverinfo: "skip", x, y, z, text: ["", name.replaceAll("<", "‹")], textposition: "top center", line: { color: "#d55e00", width: 4 }, marker: { size: [0, 4], color: "#d55e00" } });
  }
  if (which.lights.length) {
    const [x, y, z] = [0, 1, 2].map((k) => which.lights.map((v) => 1.15 * v[k]));
    traces.push({ type: "scatter3d", mode: "markers", hoverinfo: "skip", x, y, z, marker: { size: 9, symbol: "circle-open", color: "#0072b2", line: { width: 3 } } });
  }
  return threeD("lights", traces, spaceLayout(["x", "y", "z"], { eye: { x: 0.35, y: -0.9, z: 1.75 }, up: { x: 0, y: 1, z: 0 } }, { range: [-1.25, 1.25], showticklabels: false }));
}

function relight() {
  const { item, normals, truth } = shown, missing = [176, 190, 208];
  for (const [id, source] of [["relit-estimate", normals], ["relit-truth", truth]]) {
    painted($(id), item.size, (i) => {
      const n = source.at(i);
      if (Number.isNaN(n[0])) return Number.isNaN(truth.at(i)[0]) ? [0, 0, 0, 0] : missing;
      const v = encoded(n[0] * light[0] + n[1] * light[1] + n[2] * light[2]);
      return [v, v, v];
    });
  }
  $("relit-light").textContent = `light from (${light.map((v) => v.toFixed(2)).join(", ")})`;
}

$("relit").addEventListener("keydown", (event) => {
  const arrow = ARROWS[event.key];
  if (!shown || !arrow || modified(event)) return;
  event.preventDefault();
  shine(light[0] + 0.1 * arrow[0], light[1] - 0.1 * arrow[1]);
  relight();
});

// Light from (x, y) on the unit disc, seen from the camera; what is beyond the rim is on it.
function shine(x, y) {
  const most = Math.min(1, 0.98 / (Math.hypot(x, y) || 1));
  light = [x * most, y * most, Math.sqrt(1 - (x * x + y * y) * most * most)];
}

let relighting = false;
for (const id of ["relit-estimate", "relit-truth"]) for (const kind of ["pointermove", "pointerdown"]) $(id).addEventListener(kind, (event) => {
  if (!shown) return;
  const box = event.target.getBoundingClientRect(), half = Math.min(box.width, box.height) / 2;
  shine((event.clientX - box.left - box.width / 2) / half, (box.top + box.height / 2 - event.clientY) / half);
  if (!relighting) requestAnimationFrame(() => { relighting = false; relight(); });
  relighting = true;
});

// Rodrigues' rotation of v about a unit axis k.
function rotated(v, k, angle) {
  const c = Math.cos(angle), s = Math.sin(angle), along = k[0] * v[0] + k[1] * v[1] + k[2] * v[2];
  const across = cross(k, v);
  return v.map((each, i) => each * c + across[i] * s + k[i] * along * (1 - c));
}

function cross(a, b) {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

const unit = (v) => v.map((each) => each / Math.hypot(...v));

// Left and right about the upward axis, up and down about the one across.
for (const id of ["cloud", "lights"]) $(id).addEventListener("keydown", (event) => {
  const arrow = ARROWS[event.key], camera = $(id)._fullLayout?.scene?._scene?.getCamera(); // as the pointer left it
  if (!camera || !arrow || modified(event)) return;
  event.preventDefault();
  const list = ({ x, y, z }) => [x, y, z], named = ([x, y, z]) => ({ x, y, z }), ten = Math.PI / 18;
  const up = unit(list(camera.up)), eye = list(camera.eye);
  const turn = (v) => (arrow[0] ? rotated(v, up, -ten * arrow[0]) : rotated(v, unit(cross(up, eye)), ten * arrow[1]));
  Plotly.relayout(id, { "scene.camera": { ...camera, eye: named(turn(eye)), up: named(turn(up)) } });
});

// What is drawn in space costs seconds where there is no graphics card: only once somebody scrolls there.
let near = false;
const solids = () => Promise.all([cloud(shown), lights(shown)]);
new IntersectionObserver((entries, observer) => {
  if (near || !entries.some((entry) => entry.isIntersecting)) return;
  near = true;
  observer.disconnect();
  if (shown) solids().catch(trouble);
}, { rootMargin: "50%" }).observe($("cloud"));

// The method that errs least, of those that are ok.
function best(cases) {
  const rank = ({ status, median }) => (status === "ok" ? (median ?? Infinity) : Infinity);
  return cases.reduce((least, each) => (rank(each) < rank(least) ? each : least), cases[0]);
}

async function show(picture, anchor) {
  const request = ++asked, item = parsed(picture);
  const which = item.cases.find((each) => each.anchor === anchor) ?? best(item.cases);
  const options = (select, list, chosen) => {
    select.replaceChildren(...list.map(([value, text]) => new Option(text, value, false, value === chosen)));
  };
  options($("look-picture"), pictures.map((each) => [each.anchor, each.id]), picture.anchor);
  options($("look-method"), item.cases.map((each) => [each.anchor, each.status === "ok" ? each.method : `${each.method} (${each.status})`]), which?.anchor);
  if (!which) {
    $("look-trouble").textContent = "There is no estimate for this picture.";
    $("look-trouble").hidden = false;
    return;
  }
  const [colours, truth, normals, error, stated, doubtful, reasons] = await Promise.all([
    unpackFixed(item.picture), unpackFixed(item.truth), unpackFixed(which.normals), unpackDegrees(which.error),
    unpackDegrees(which.stated), unpacked(which.doubtful), unpackReasons(which.reason)]);
  const preview = await hatched({ item, doubtful });
  if (request !== asked) return;
  $("look-trouble").hidden = true;
  shown = { picture: colours, truth, normals, error, stated, doubtful, preview, reasons, item, which, anchor: picture.anchor };
  tell(which.verdict);
  await panes(shown);
  await readAgain();
  relight();
  if (near) await solids();
  $("inspector").dataset.shows = which.anchor;
}

// The verdict of what is shown: the word, what it means, why, and what to do. All of it is text, never markup.
function tell({ word, sign, meaning, why, todo }) {
  const box = $("look-verdict");
  box.hidden = !word;
  box.className = `verdict-box ${word}`;
  const line = (label, text) => {
    const p = document.createElement("p"), b = document.createElement("b");
    b.textContent = label;
    p.append(b, ` ${text}`);
    return p;
  };
  box.replaceChildren(line(`${sign} ${word}`, meaning), ...why.map((text) => line("Why:", text)), ...todo.map((text) => line("What to do:", text)));
}

const pictureOf = (anchor) => pictures.find((each) => anchor === each.anchor || anchor.startsWith(`${each.anchor}-`));

function trouble(error) {
  $("look-trouble").textContent = `The inspector does not work in this browser: ${error.message}`;
  $("look-trouble").hidden = false;
  console.error(error);
}

function look(anchor) {
  const picture = pictureOf(anchor);
  return picture ? show(picture, anchor).catch(trouble) : Promise.resolve();
}

$("look-picture").addEventListener("change", (event) => {
  const picture = pictureOf(event.target.value), before = shown?.which.method;
  look(parsed(picture).cases.find((each) => each.method === before)?.anchor ?? picture.anchor);
});
$("look-method").addEventListener("change", (event) => look(event.target.value));
$("cloud-space").addEventListener("change", () => shown && near && cloud(shown));
$("look-reset").addEventListener("click", () => shown && whole());
async function drawAgain() {
  if (!shown) return;
  shown.preview = await hatched(shown);
  await panes(shown);
  await readAgain();
  $("inspector").dataset.hatched = $("look-doubtful").checked;
}
$("look-doubtful").addEventListener("change", () => drawAgain().catch(trouble));
dark.addEventListener("change", () => {
  drawAgain().catch(trouble);
  if (shown && near) solids().catch(trouble);
});
document.addEventListener("click", (event) => {
  const link = event.target.closest("a[data-look]");
  if (!link || !pictureOf(link.dataset.look)) return;
  event.preventDefault();
  history.replaceState(null, "", `#${link.dataset.look}`);
  look(link.dataset.look);
  $("inspector").scrollIntoView({ behavior: "smooth" });
});
let width = innerWidth;
addEventListener("resize", () => {
  if (innerWidth === width || !$("panes").clientWidth) return; // a phone's bars come and go; print hides the panes
  width = innerWidth;
  if (shown) panes(shown).then(readAgain);
});
// The page is there first: the plotting library is only read, and the first picture unpacked, once it has been painted.
const painted_once = () => new Promise((resolve) => requestAnimationFrame(() => setTimeout(resolve, 0)));
async function start() {
  await painted_once();
  const library = $("plotly");
  if (library) {
    const script = document.createElement("script");
    script.textContent = library.textContent;
    document.head.append(script);
  }
  const first = location.hash.slice(1);
  await look(pictureOf(first) ? first : pictures[0].anchor);
  const gd = $("panes");
  if (!gd.on) return;
  gd.on("plotly_hover", readSoon);
  gd.on("plotly_click", readSoon);
}
start().catch(trouble);
})();
