// The viewer of a scene: float32 pixels from scripts in data/, decoded here, shown by two canvases with one view.
"use strict";

const root = document.getElementById("viewer");
const viewed = JSON.parse(document.getElementById("viewed").textContent);
const find = (id) => document.getElementById(id);
const { width, height } = viewed;
const AGAINST = viewed.against ?? { own: "own limit", correct: "correct", physical: "physical" };
const MAPS = { reference: "reference", signed: "signed error", relative: "relative error", deviations: "deviations", p: "p-map", flip: "FLIP" };
const CHANNELS = ["luminance", "red", "green", "blue"];
const OF_CHANNEL = ["signed", "relative", "deviations"]; // maps that a channel has alone
const START = {
  term: "total" in viewed.terms ? "total" : Object.keys(viewed.terms)[0], variant: null, shown: "ours", against: "own", beside: "signed", channel: "luminance", side: 16,
  ev: 0, curve: "srgb", gamma: 2.2, split: false, at: 0.5, zoom: 1, x: width / 2, y: height / 2, pixel: null,
};
let state = { ...START };
let hovered = null; // the pixel under the pointer, where none is held

// Pixels, each loaded once
const waiting = new Map();
const loaded = new Map();

async function decode(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const places = new Uint8Array(await new Response(stream).arrayBuffer());
  const count = places.length / 4;
  const sorted = new Uint8Array(places.length);
  for (let place = 0; place < 4; place++)
    for (let index = 0; index < count; index++) sorted[4 * index + place] = places[place * count + index];
  return new Float32Array(sorted.buffer);
}

window.termwisePixels = (key, text) => decode(text).then((values) => {
  loaded.set(key, values);
  waiting.get(key).resolve(values);
});

function load(key) {
  if (!waiting.has(key)) {
    let settle;
    const promise = new Promise((resolve, reject) => { settle = { resolve, reject }; });
    waiting.set(key, { promise, ...settle });
    const script = document.createElement("script");
    const address = `${viewed.folder}${key}.js`;
    script.src = window.termwiseAddress ? window.termwiseAddress(address) : root.dataset.root + address;
    script.onerror = () => settle.reject(new Error(`${address} could not be read: it belongs beside the page`));
    document.head.append(script);
  }
  return waiting.get(key).promise;
}

// What is looked at
const variants = () => viewed.terms[state.term];
const variant = () => variants().find((each) => each.name === state.variant) ?? variants()[0];
const pair = () => variant().against[state.against] ?? Object.values(variant().against)[0];
const planes = height * width * 3;

// Maps of radiance to colours, (height, width) RGBA
function transfer() {
  const scale = viewed.exposure * 2 ** state.ev;
  const power = 1 / state.gamma;
  const curve = state.curve === "gamma"
    ? (v) => v ** power
    : (v) => (v <= 0.0031308 ? 12.92 * v : 1.055 * v ** (1 / 2.4) - 0.055);
  return (radiance) => Math.round(255 * curve(Math.min(Math.max(radiance * scale, 0), 1)));
}

function picture(values) {
  const image = new ImageData(width, height);
  const shade = transfer();
  for (let pixel = 0; pixel < width * height; pixel++) {
    const rgb = values.subarray(3 * pixel, 3 * pixel + 3);
    const valid = rgb.every(Number.isFinite);
    for (let channel = 0; channel < 3; channel++)
      image.data[4 * pixel + channel] = valid ? shade(rgb[channel]) : viewed.invalid[channel];
    image.data[4 * pixel + 3] = 255;
  }
  return image;
}

function coloured(value, colours, low, high) {
  const image = new ImageData(width, height);
  for (let pixel = 0; pixel < width * height; pixel++) {
    const share = (value(pixel) - low) / (high - low);
    const level = Math.round(Math.min(Math.max(share, 0), 1) * (colours.length - 1));
    image.data.set(Number.isFinite(share) ? colours[level] : viewed.invalid, 4 * pixel);
    image.data[4 * pixel + 3] = 255;
  }
  return image;
}

const luminance = (values, pixel) => viewed.luminance.reduce((sum, weight, channel) => sum + weight * values[3 * pixel + channel], 0);

function deviation(ours, reference, index) {
  const difference = ours[index] - reference[index];
  const error = Math.hypot(ours[planes + index], reference[planes + index]);
  return difference === 0 ? 0 : difference / error;
}

// Tests of tiles, which only the own limit has
const tested = () => variant().tiles && pair()?.key === variant().against.own?.key;

// The tests of one size: of each map of reports.tiles its values, row by row
function tiles() {
  const values = loaded.get(variant().tiles);
  const found = { columns: Math.ceil(width / state.side) };
  let start = 0;
  for (const side of viewed.sides) {
    const count = Math.ceil(width / side) * Math.ceil(height / side);
    for (const name of viewed.maps) {
      if (side === state.side) found[name] = values.subarray(start, start + count);
      start += count;
    }
  }
  return found;
}

const signedColour = (share) => viewed.diverging[Math.round(((share + 1) / 2) * (viewed.diverging.length - 1))];

// Colour of an adjusted p of a tile that is found: the surer, the fuller
function foundColour(p, sign) {
  const surely = Math.log(Math.max(p, viewed.sure) / viewed.level) / Math.log(viewed.sure / viewed.level);
  return signedColour(sign * (viewed.palest + (1 - viewed.palest) * surely));
}

const greyOf = (p) => Array(3).fill(viewed.greys[0] + (viewed.greys[1] - viewed.greys[0]) * p);

function pMap() {
  const found = tiles();
  const image = new ImageData(width, height);
  const { side } = state;
  for (let pixel = 0; pixel < width * height; pixel++) {
    const [x, y] = [pixel % width, Math.floor(pixel / width)];
    const tile = Math.floor(y / side) * found.columns + Math.floor(x / side);
    const adjusted = found.benjamini_hochberg[tile];
    const rim = x % side === 0 || y % side === 0 || (x + 1) % side === 0 || (y + 1) % side === 0 || x === width - 1 || y === height - 1;
    let colour = Array(3).fill(viewed.nothing);
    if (found.holm[tile] <= viewed.level && rim) colour = [0, 0, 0];
    else if (adjusted <= viewed.level) colour = foundColour(adjusted, Math.sign(found.bias[tile]));
    else if (Number.isFinite(found.p[tile])) colour = greyOf(found.p[tile]);
    image.data.set(colour, 4 * pixel);
    image.data[4 * pixel + 3] = 255;
  }
  return image;
}

function scaleOf(map) {
  if (map === "flip") return 1;
  if (map === "deviations") return viewed.deviations;
  const against = variant().against[state.against] ? state.against : Object.keys(variant().against)[0];
  const kind = state.channel !== "luminance" && OF_CHANNEL.includes(map) ? `${map} channel` : map;
  return viewed.scales[state.term][against][kind];
}

function map() {
  const ours = loaded.get(variant().key);
  const reference = loaded.get(pair().key);
  const end = scaleOf(state.beside);
  const mean = pair().mean;
  const channel = CHANNELS.indexOf(state.channel) - 1; // -1 is luminance
  const apart = channel < 0
    ? (pixel) => luminance(ours, pixel) - luminance(reference, pixel)
    : (pixel) => ours[3 * pixel + channel] - reference[3 * pixel + channel];
  switch (state.beside) {
    case "signed":
      return coloured((pixel) => apart(pixel) / mean, viewed.diverging, -end, end);
    case "relative":
      return coloured((pixel) => apart(pixel) / Math.max(luminance(reference, pixel), viewed.floor * mean), viewed.diverging, -end, end);
    case "deviations":
      return coloured((pixel) => {
        if (channel >= 0) return deviation(ours, reference, 3 * pixel + channel);
        const found = [0, 1, 2].map((channel) => deviation(ours, reference, 3 * pixel + channel));
        return found.reduce((a, b) => (Math.abs(b) > Math.abs(a) || Number.isNaN(b) ? b : a));
      }, viewed.diverging, -end, end);
    case "p":
      return tested() ? pMap() : new ImageData(width, height);
    case "flip": {
      const flip = loaded.get(pair().flip);
      return coloured((pixel) => (flip ? flip[pixel] : NaN), viewed.sequential, 0, 1);
    }
    default:
      return picture(reference);
  }
}

// Two canvases, one view: pixel (x, y) in the middle, zoom 1 fits
function surface(image) {
  const canvas = new OffscreenCanvas(width, height);
  canvas.getContext("2d").putImageData(image, 0, 0);
  return canvas;
}

function paint(canvas, images) {
  const ratio = window.devicePixelRatio || 1;
  canvas.width = Math.round(canvas.clientWidth * ratio);
  canvas.height = Math.round((canvas.width * height) / width);
  canvas.style.aspectRatio = `${width} / ${height}`;
  const context = canvas.getContext("2d");
  const scale = (canvas.width / width) * state.zoom;
  const left = canvas.width / 2 - state.x * scale;
  const top = canvas.height / 2 - state.y * scale;
  const cut = Math.round(canvas.width * state.at);
  context.imageSmoothingEnabled = false;
  images.forEach((image, part) => {
    context.save();
    context.beginPath();
    if (images.length === 1) context.rect(0, 0, canvas.width, canvas.height);
    else context.rect(part ? cut : 0, 0, part ? canvas.width - cut : cut, canvas.height);
    context.clip();
    context.drawImage(image, left, top, width * scale, height * scale);
    context.restore();
  });
  if (images.length > 1) line(context, [cut, 0, cut, canvas.height], ratio);
  const pixel = state.pixel ?? hovered;
  if (pixel) {
    for (const [colour, inset] of [["#000", -1], ["#fff", 0]]) {
      context.strokeStyle = colour;
      context.lineWidth = ratio;
      context.strokeRect(left + pixel[0] * scale + inset, top + pixel[1] * scale + inset, scale - 2 * inset, scale - 2 * inset);
    }
  }
}

function line(context, [x0, y0, x1, y1], ratio) {
  for (const [colour, thickness] of [["#000", 3], ["#fff", 1]]) {
    context.strokeStyle = colour;
    context.lineWidth = thickness * ratio;
    context.beginPath();
    context.moveTo(x0, y0);
    context.lineTo(x1, y1);
    context.stroke();
  }
}

// Numbers
const number = (value) => (Number.isFinite(value) ? (value === 0 ? "0" : String(Number(value.toPrecision(5)))) : String(value)).replaceAll("-", "−");

function interval(difference, ours, reference) {
  const [k, r] = [variant().replicates, pair().replicates];
  if (!k || !r || k < 2 || r < 2 || !Number.isFinite(ours + reference)) return "–";
  const [a, b] = [ours * ours, reference * reference];
  const degrees = a + b > 0 ? (a + b) ** 2 / ((a * a) / (k - 1) + (b * b) / (r - 1)) : 1;
  const quantile = viewed.quantiles[Math.min(Math.floor(degrees), viewed.quantiles.length) - 1];
  const half = quantile * Math.sqrt(a + b);
  return `[${number(difference - half)}, ${number(difference + half)}]`;
}

function inspect() {
  const table = find("inspector");
  const pixel = state.pixel ?? hovered;
  table.caption.textContent = pixel
    ? `Pixel x ${pixel[0]}, y ${pixel[1]}${state.pixel ? ", held" : ""}: ${name("ours")} against ${name(state.against)}`
    : "Point at a pixel, or click it to hold it.";
  const rows = [];
  if (pixel && pair()) {
    const ours = loaded.get(variant().key);
    const reference = loaded.get(pair().key);
    const place = pixel[1] * width + pixel[0];
    ["red", "green", "blue"].forEach((channel, offset) => {
      const index = 3 * place + offset;
      const difference = ours[index] - reference[index];
      rows.push([channel, number(ours[index]), number(reference[index]), number(difference),
        interval(difference, ours[planes + index], reference[planes + index]), number(Number(deviation(ours, reference, index).toPrecision(3)))]);
    });
    const [a, b] = [luminance(ours, place), luminance(reference, place)];
    rows.push(["luminance", number(a), number(b), number(a - b), "–", "–"]);
  }
  converge(pixel);
  find("tile").textContent = pixel && state.beside === "p" ? tileWords(pixel) : "";
  table.tBodies[0].replaceChildren(...rows.map(([first, ...rest]) => {
    const row = document.createElement("tr");
    const head = document.createElement("th");
    head.scope = "row";
    head.textContent = first;
    row.append(head);
    for (const text of rest) row.insertCell().textContent = text;
    return row;
  }));
}

function tileWords([x, y]) {
  if (!tested()) return ""; // the caption says so
  const { side } = state;
  const found = tiles();
  const [column, row] = [Math.floor(x / side), Math.floor(y / side)];
  const at = row * found.columns + column;
  const place = `Tile x ${side * column}–${Math.min(side * (column + 1), width) - 1}, y ${side * row}–${Math.min(side * (row + 1), height) - 1}`;
  if (!Number.isFinite(found.p[at])) return `${place}: ${untested() || "nothing on either side"}`;
  const short = (p) => (p < 1e-30 ? "< 1e−30" : number(Number(p.toPrecision(2))));
  const decided = (p) => `${short(p)} (${p <= viewed.level ? "found" : "not found"})`;
  return `${place}: bias of luminance ${percent(found.bias[at], true)}; p ${short(found.p[at])}; adjusted by Holm ${decided(found.holm[at])}, by Benjamini-Hochberg ${decided(found.benjamini_hochberg[at])}`;
}

// Why no tile of this size is tested here; empty if some is
function untested() {
  if (!variant().tiles) return "this row has no p-map: it is not judged, or has no light";
  if (!tested()) return "p-maps test against the own limit alone";
  const into = variant().merged[state.side];
  return into ? `too skewed for the test, merged into the tiles of ${into} px` : "";
}

// Luminance of the pixel's tile after 1, 2, 4, ... samples, with 90 % intervals, beside the reference's
const SVG = { width: 460, height: 190, left: 62, right: 12, top: 10, bottom: 38 };

function element(name, attributes, text) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  return made;
}

function converge(pixel) {
  const figure = find("convergence");
  const { samples } = variant();
  figure.hidden = !pixel || !pair();
  if (figure.hidden) return;
  const svg = figure.querySelector("svg");
  const words = figure.querySelector("figcaption");
  svg.replaceChildren();
  svg.toggleAttribute("hidden", !samples.length);
  if (!samples.length) {
    words.textContent = state.term === "total" ? "No convergence: the sum is measured at its last sample count alone" : "No convergence: this run does not hold it";
    return;
  }
  const side = viewed.sweep_side;
  const [column, row] = [Math.floor(pixel[0] / side), Math.floor(pixel[1] / side)];
  const tilesX = Math.ceil(width / side);
  const count = tilesX * Math.ceil(height / side);
  const at = row * tilesX + column;
  const estimate = (values, index, replicates) => {
    const half = replicates > 1 ? viewed.quantiles[Math.min(replicates - 1, viewed.quantiles.length) - 1] * values[(2 * index + 1) * count + at] : NaN;
    const mean = values[2 * index * count + at];
    return { mean, low: mean - half, high: mean + half };
  };
  const ours = samples.map((_, index) => estimate(loaded.get(variant().sweep), index, variant().replicates));
  const right = estimate(loaded.get(pair().sweep), 0, pair().replicates);
  const shown = [...ours, right].flatMap(Object.values).filter(Number.isFinite);
  let [low, high] = [Math.min(...shown), Math.max(...shown)];
  if (!(high > low)) [low, high] = [low - (Math.abs(low) || 1) * 0.01, high + (Math.abs(high) || 1) * 0.01];
  const last = Math.log2(samples.at(-1)) || 1;
  const x = (n) => SVG.left + ((SVG.width - SVG.left - SVG.right) * Math.log2(n)) / last;
  const y = (value) => SVG.top + ((SVG.height - SVG.top - SVG.bottom) * (high - value)) / (high - low);
  const whole = (each) => Number.isFinite(each.low);
  if (whole(right)) svg.append(element("rect", { class: "reference", x: SVG.left, width: SVG.width - SVG.left - SVG.right, y: y(right.high), height: Math.max(y(right.low) - y(right.high), 1) }));
  const valid = samples.map((n, index) => ({ n, ...ours[index] })).filter((each) => Number.isFinite(each.mean));
  if (valid.length && valid.every(whole)) {
    const edge = [...valid.map((each) => [x(each.n), y(each.high)]), ...valid.map((each) => [x(each.n), y(each.low)]).reverse()];
    svg.append(element("polygon", { class: "ours", points: edge.map(String).join(" ") }));
  }
  if (Number.isFinite(right.mean)) svg.append(element("line", { class: "reference", x1: SVG.left, x2: SVG.width - SVG.right, y1: y(right.mean), y2: y(right.mean) }));
  svg.append(element("polyline", { class: "ours", points: valid.map((each) => `${x(each.n)},${y(each.mean)}`).join(" ") }));
  for (const each of valid) svg.append(element("circle", { class: "ours", cx: x(each.n), cy: y(each.mean), r: 3 }));
  for (const n of samples) svg.append(element("text", { x: x(n), y: SVG.height - SVG.bottom + 16, "text-anchor": "middle" }, n));
  const digits = Math.min(Math.max(2, Math.ceil(1 - Math.log10((high - low) / Math.max(Math.abs(high), Math.abs(low)))) + 1), 7);
  for (const value of [low, (low + high) / 2, high]) svg.append(element("text", { x: SVG.left - 8, y: y(value) + 4, "text-anchor": "end" }, value === 0 ? "0" : value.toPrecision(digits).replaceAll("-", "−")));
  svg.append(element("text", { x: (SVG.left + SVG.width - SVG.right) / 2, y: SVG.height - 4, "text-anchor": "middle" }, "samples per pixel and replicate"));
  svg.setAttribute("aria-label", `Luminance of the tile: ${samples.map((n, index) => `${number(ours[index].mean)} after ${n}`).join(", ")}; reference ${number(right.mean)}`);
  const range = (from, size) => `${from}–${Math.min(from + side, size) - 1}`;
  words.textContent = `Luminance of the tile around the pixel, x ${range(side * column, width)}, y ${range(side * row, height)}: mean of ${variant().replicates} replicates; dashed the reference. Bands: 90 % intervals`;
}

// Words
const percent = (value, signed) => `${signed && value > 0 ? "+" : ""}${number(Number((100 * value).toPrecision(2)))} %`;
const alone = "ours"; // the name of what is no variant: the images of another renderer
const name = (what) => (what === "ours" ? (variant().name === alone ? alone : `ours, ${state.term === "total" ? "sum of the terms" : variant().name}`) : `${AGAINST[what]} (${pair()?.limit})`);

function caption(canvas, text, map) {
  const place = canvas.nextElementSibling;
  canvas.setAttribute("aria-label", `${viewed.scene}, ${state.term}: ${text}`);
  place.replaceChildren();
  if (map) {
    const end = map === "p" ? null : scaleOf(map);
    const colours = map === "flip" ? viewed.sequential : map === "p" ? pColours() : viewed.diverging;
    const bar = document.createElement("span");
    bar.className = "scale";
    const [low, gradient, high] = [0, 1, 2].map(() => document.createElement("span"));
    [low.textContent, high.textContent] = {
      flip: () => ["0", "1"],
      deviations: () => [`−${end}`, `+${end}`],
      p: () => ["too dark, p 10⁻⁶", "too bright, p 10⁻⁶"],
    }[map]?.() ?? [percent(-end), percent(end, true)];
    gradient.className = "gradient";
    const stops = colours.filter((_, index) => index % 15 === 0 || index === colours.length - 1);
    gradient.style.background = `linear-gradient(to right, ${stops.map((rgb) => `rgb(${rgb.join(" ")})`).join(", ")})`;
    bar.append(low, gradient, high);
    place.append(bar);
  }
  place.append(text);
}

// The scale of a p-map: found too dark, not found (p from 0 to 1 and back), found too bright
function pColours() {
  const steps = Array.from({ length: 61 }, (_, index) => index / 60);
  const found = (sign) => steps.map((step) => foundColour(viewed.sure ** (1 - step) * viewed.level ** step, sign));
  const not = steps.map((step) => greyOf(1 - Math.abs(2 * step - 1)));
  return [...found(-1), ...not, ...found(1).reverse()];
}

const ofLuminance = () => (state.channel === "luminance" ? "" : " in luminance");
const EXPLAINED = {
  signed: () => `Ours − reference, ${state.channel}, of the reference’s mean${ofLuminance()}`,
  relative: () => `Ours − reference, ${state.channel}, of the reference’s pixel${ofLuminance()}`,
  deviations: () => `Ours − reference over its standard error, ${state.channel === "luminance" ? "of the channel where it is greatest" : state.channel}`,
  p: () => "Tiles with a bias of luminance: coloured as found by Benjamini-Hochberg (adjusted p ≤ 0.05), outlined as found by Holm; light grey not found, dark grey nothing on either side",
  flip: () => "FLIP of both as displayed at the scene’s exposure (+0.0 EV, sRGB)",
};

// Controls
function choices(id, entries, chosen, act) {
  const box = find(id);
  box.querySelectorAll("label").forEach((label) => label.remove());
  for (const [value, text, key] of entries) {
    const label = document.createElement("label");
    const input = document.createElement("input");
    Object.assign(input, { type: "radio", name: id, value, checked: value === chosen });
    input.addEventListener("change", () => act(value));
    label.append(input, text);
    if (key) label.title = `Key ${key}`;
    box.append(label);
  }
}

// FLIP is of pictures as displayed, and stored for one display.
const stale = () => state.beside === "flip" && Boolean(pair()?.flip) && (state.ev !== 0 || state.curve !== "srgb");

// A choice keeps its focus: boxes are made again only if their entries changed.
const made = {};
function sync(id, entries, chosen, act) {
  const now = JSON.stringify(entries);
  if (made[id] !== now) {
    made[id] = now;
    choices(id, entries, chosen, act);
  }
  for (const input of find(id).querySelectorAll("input")) input.checked = input.value === chosen;
}

const show = (value) => (value.startsWith("ours ") ? { shown: "ours", variant: value.slice(5) } : { shown: value, against: value });

function controls() {
  const has = Object.keys(AGAINST).filter((each) => each in variant().against);
  const label = (each) => (state.term === "total" ? "ours" : each.name);
  sync("shown", [
    ...variants().map((each, index) => [`ours ${each.name}`, label(each), index + 1]),
    ...has.map((each) => [each, AGAINST[each], each[0]]),
  ], state.shown === "ours" ? `ours ${variant().name}` : state.shown, (value) => change(show(value)));
  sync("against", has.map((each) => [each, AGAINST[each]]), state.against, (value) => change({ against: value, ...(state.shown === "ours" ? {} : { shown: value }) }));
  sync("beside", Object.entries(MAPS), state.beside, (value) => change({ beside: value }));
  find("term").value = state.term;
  find("channel").value = state.channel;
  find("channel").disabled = !OF_CHANNEL.includes(state.beside);
  find("side").value = state.side;
  find("side").disabled = state.beside !== "p";
  find("curve").value = state.curve;
  find("split").checked = state.split;
  for (const id of ["ev", "gamma", "at"]) find(id).value = state[id];
  find("gamma").disabled = state.curve !== "gamma";
  find("at").disabled = !state.split;
  const said = { ev: `${state.ev >= 0 ? "+" : "−"}${Math.abs(state.ev).toFixed(1)} EV`, gamma: state.gamma.toFixed(1), at: `${Math.round(100 * state.at)} %` };
  for (const [id, text] of Object.entries(said)) {
    root.querySelector(`output[for=${id}]`).textContent = text;
    find(id).setAttribute("aria-valuetext", text);
  }
}

// State, address, drawing
// A page within a single file has no address of its own: the file keeps what the view is.
const link = window.termwiseLink ?? {
  read: () => location.hash.slice(1),
  write: (view) => history.replaceState(null, "", `#${view}`),
};

function valid(wanted) {
  const next = { ...state, ...wanted };
  if (!(next.term in viewed.terms)) next.term = START.term;
  const those = viewed.terms[next.term];
  const its = those.find((each) => each.name === next.variant) ?? those[0];
  next.variant = its.name;
  if (!(next.against in its.against)) next.against = Object.keys(its.against)[0] ?? "own";
  if (next.shown !== "ours") next.shown = next.against;
  if (!(next.beside in MAPS)) next.beside = START.beside;
  if (!CHANNELS.includes(next.channel)) next.channel = START.channel;
  if (!viewed.sides.includes(next.side)) next.side = START.side;
  if (next.curve !== "gamma") next.curve = "srgb";
  const within = (value, low, high, otherwise) => (Number.isFinite(value) ? Math.min(Math.max(value, low), high) : otherwise);
  next.ev = within(next.ev, -8, 8, START.ev);
  next.gamma = within(next.gamma, 1, 3, START.gamma);
  next.at = within(next.at, 0, 1, START.at);
  next.zoom = within(next.zoom, 1, 64, 1);
  const [spareX, spareY] = [width / next.zoom / 2, height / next.zoom / 2];
  next.x = within(next.x, spareX, width - spareX, width / 2);
  next.y = within(next.y, spareY, height - spareY, height / 2);
  if (next.pixel && !(Number.isInteger(next.pixel[0]) && Number.isInteger(next.pixel[1]) && within(next.pixel[0], 0, width - 1) === next.pixel[0] && within(next.pixel[1], 0, height - 1) === next.pixel[1])) next.pixel = null;
  return next;
}

function change(wanted) {
  state = valid(wanted);
  const written = new URLSearchParams();
  const start = { ...START, variant: variants()[0].name };
  for (const [key, value] of Object.entries(state))
    if (value !== null && String(value) !== String(start[key])) written.set(key, typeof value === "number" ? String(Number(value.toFixed(3))) : String(value));
  link.write(written.toString().replaceAll("%2C", ","));
  draw();
}

function restore() {
  const read = Object.fromEntries(new URLSearchParams(link.read()));
  for (const key of ["side", "ev", "gamma", "at", "zoom", "x", "y"]) if (key in read) read[key] = parseFloat(read[key]);
  if ("split" in read) read.split = read.split === "true";
  if ("pixel" in read) read.pixel = read.pixel.split(",").map(Number);
  const known = Object.fromEntries(Object.entries(read).filter(([key]) => key in START));
  state = valid({ ...START, ...known });
  draw();
}

let latest = 0;
async function draw() {
  const turn = ++latest;
  controls();
  root.dataset.state = "loading";
  const swept = variant().samples.length ? [variant().sweep, pair()?.sweep] : [];
  const needed = [variant().key, pair()?.key, ...swept, state.beside === "flip" ? pair()?.flip : null, state.beside === "p" && tested() ? variant().tiles : null].filter(Boolean);
  try {
    await Promise.all(needed.map(load));
  } catch (error) {
    find("status").textContent = error.message;
    root.dataset.state = "failed";
    return;
  }
  if (turn !== latest) return; // a later change draws
  if (!pair()) {
    find("status").textContent = `${state.term} ${variant().name} has no reference in this run`;
    surfaces = [[surface(picture(loaded.get(variant().key)))], []];
    caption(find("left"), name("ours"));
    caption(find("right"), "no reference");
    repaint();
    root.dataset.state = "ready";
    return;
  }
  find("status").textContent = variant().name === alone ? "" : variant().verdict ? `Verdict of ${state.term}${state.term === "total" ? "" : ` ${variant().name}`} against its own limit: ${variant().verdict}` : "";
  const ours = () => surface(picture(loaded.get(variant().key)));
  const reference = () => surface(picture(loaded.get(pair().key)));
  const order = state.shown === "ours" ? [ours, reference] : [reference, ours];
  const words = state.shown === "ours" ? [name("ours"), name(state.against)] : [name(state.against), name("ours")];
  const count = state.split ? 2 : 1;
  surfaces = [order.slice(0, count).map((make) => make()), [surface(map())]];
  caption(find("left"), state.split ? `Left ${words[0]}; right ${words[1]}` : words[0]);
  find("right").classList.toggle("stale", stale());
  if (state.beside === "reference") caption(find("right"), name(state.against));
  else if (state.beside === "p") caption(find("right"), untested() ? `No p-map: ${untested()}` : EXPLAINED.p(), untested() ? null : "p");
  else if (stale()) caption(find("right"), `${EXPLAINED.flip()}: not that of the pictures shown now. Reset exposure and curve to see it`, "flip");
  else caption(find("right"), pair().flip || state.beside !== "flip" ? EXPLAINED[state.beside]() : "FLIP knows nothing of invalid pixels", state.beside);
  repaint();
  root.dataset.state = "ready";
}

let surfaces = [];
function repaint() {
  if (!surfaces.length) return;
  paint(find("left"), surfaces[0]);
  paint(find("right"), surfaces[1]);
  inspect();
}

// Pointer
function under(canvas, event) {
  const box = canvas.getBoundingClientRect();
  const scale = (box.width / width) * state.zoom;
  const at = [(event.clientX - box.left - box.width / 2) / scale + state.x, (event.clientY - box.top - box.height / 2) / scale + state.y];
  return { at, scale, pixel: [Math.min(Math.max(Math.floor(at[0]), 0), width - 1), Math.min(Math.max(Math.floor(at[1]), 0), height - 1)] };
}

function zoom(factor, [x, y] = state.pixel ?? [state.x, state.y]) {
  const next = Math.min(Math.max(state.zoom * factor, 1), 64);
  const kept = state.zoom / next;
  change({ zoom: next, x: x + (state.x - x) * kept, y: y + (state.y - y) * kept });
}

for (const canvas of [find("left"), find("right")]) {
  let grip = null;
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(2 ** (-event.deltaY / 400), under(canvas, event).at);
  }, { passive: false });
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    grip = { x: event.clientX, y: event.clientY, from: [state.x, state.y], moved: false };
  });
  canvas.addEventListener("pointermove", (event) => {
    const found = under(canvas, event);
    if (grip) {
      const [dx, dy] = [event.clientX - grip.x, event.clientY - grip.y];
      grip.moved ||= Math.hypot(dx, dy) > 4;
      if (grip.moved) change({ x: grip.from[0] - dx / found.scale, y: grip.from[1] - dy / found.scale });
    } else if (!state.pixel) {
      hovered = found.pixel;
      repaint();
    }
  });
  canvas.addEventListener("pointerup", (event) => {
    if (grip && !grip.moved) {
      const { pixel } = under(canvas, event);
      change({ pixel: state.pixel && String(state.pixel) === String(pixel) ? null : pixel });
    }
    grip = null;
  });
  canvas.addEventListener("pointercancel", () => { grip = null; });
}

// Keys
const after = (list, value) => list[(list.indexOf(value) + 1) % list.length];
const flip = () => change({ shown: state.shown === "ours" ? state.against : "ours" });
const act = {
  f: flip,
  t: () => change({ term: after(Object.keys(viewed.terms), state.term) }),
  m: () => change({ beside: after(Object.keys(MAPS), state.beside) }),
  h: () => change({ channel: after(CHANNELS, state.channel) }),
  w: () => change({ beside: "p", side: after(viewed.sides, state.side) }),
  e: () => change({ ev: state.ev + 0.5 }),
  E: () => change({ ev: state.ev - 0.5 }),
  g: () => change({ curve: "gamma", gamma: state.gamma + 0.1 }),
  G: () => change({ curve: "gamma", gamma: state.gamma - 0.1 }),
  s: () => change({ split: !state.split }),
  "[": () => change({ split: true, at: state.at - 0.05 }),
  "]": () => change({ split: true, at: state.at + 0.05 }),
  "+": () => zoom(1.5),
  "=": () => zoom(1.5),
  "-": () => zoom(1 / 1.5),
  0: () => change({ zoom: 1 }),
  "?": () => { const list = find("keys").closest("details"); list.open = !list.open; },
};
for (const against of Object.keys(AGAINST)) act[against[0]] = () => against in variant().against && change(show(against));
for (let digit = 1; digit <= 9; digit++) act[digit] = () => variants()[digit - 1] && change(show(`ours ${variants()[digit - 1].name}`));
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.matches("select")) return;
  if (event.target.matches("canvas")) {
    const pixel = state.pixel ?? hovered ?? [Math.floor(state.x), Math.floor(state.y)];
    const step = ARROWS[event.key];
    if (step && event.shiftKey) change({ x: state.x + (step[0] * width) / state.zoom / 10, y: state.y + (step[1] * height) / state.zoom / 10 });
    else if (step) change({ pixel: [Math.min(Math.max(pixel[0] + step[0], 0), width - 1), Math.min(Math.max(pixel[1] + step[1], 0), height - 1)] });
    else if (event.key === "Enter") change({ pixel: state.pixel ? null : pixel });
    if (step || event.key === "Enter") return event.preventDefault();
  }
  if (find("keys").checked && Object.hasOwn(act, event.key)) {
    act[event.key]();
    event.preventDefault();
  }
});

for (const term of Object.keys(viewed.terms)) find("term").add(new Option(term, term));
find("term").parentElement.toggleAttribute("hidden", Object.keys(viewed.terms).length < 2);
find("against").toggleAttribute("hidden", Object.keys(AGAINST).length < 2);
find("term").addEventListener("change", (event) => change({ term: event.target.value }));
for (const channel of CHANNELS) find("channel").add(new Option(channel));
find("channel").addEventListener("change", (event) => change({ channel: event.target.value }));
for (const side of viewed.sides) find("side").add(new Option(`${side} px`, side));
find("side").addEventListener("change", (event) => change({ side: Number(event.target.value) }));
find("curve").addEventListener("change", (event) => change({ curve: event.target.value }));
find("split").addEventListener("change", (event) => change({ split: event.target.checked }));
for (const id of ["ev", "gamma", "at"]) find(id).addEventListener("input", (event) => change({ [id]: event.target.valueAsNumber }));
find("flip").addEventListener("click", flip);
find("in").addEventListener("click", () => zoom(1.5));
find("out").addEventListener("click", () => zoom(1 / 1.5));
find("fit").addEventListener("click", act[0]);
find("reset").addEventListener("click", () => { hovered = null; change(START); });
window.addEventListener("hashchange", restore);
window.addEventListener("resize", repaint);
root.hidden = false;
restore();
