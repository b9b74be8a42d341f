// Draws each chart from the JSON beside it, in the colours of the page, and again when these change.
"use strict";

function colours() {
  const style = getComputedStyle(document.documentElement);
  const text = style.getPropertyValue("--text").trim();
  const line = style.getPropertyValue("--line").trim();
  const axis = { gridcolor: line, linecolor: line, zerolinecolor: line, tickcolor: line };
  const layout = {
    "font.color": text,
    "modebar.color": line,
    "modebar.activecolor": text,
    "modebar.bgcolor": "rgba(0,0,0,0)",
    "font.family": getComputedStyle(document.body).fontFamily,
  };
  for (const name of ["xaxis", "yaxis"])
    for (const number of ["", "2", "3"])
      for (const [key, value] of Object.entries(axis)) layout[`${name}${number}.${key}`] = value;
  return layout;
}

// Panels stand side by side, and one above the other where titles and numbers would run into each other.
const narrow = matchMedia("(max-width: 44rem)");
const BETWEEN = 84; // pixels: the numbers and the title of an axis
function arranged(layout) {
  const names = Object.keys(layout).filter((name) => /^xaxis\d*$/.test(name)).sort();
  if (!narrow.matches || names.length < 2) return layout;
  const { t: top, b: bottom } = layout.margin;
  const panel = 0.6 * (layout.height - top - bottom);
  const inner = names.length * panel + (names.length - 1) * BETWEEN;
  const found = { ...layout, height: inner + top + bottom };
  names.forEach((name, index) => {
    const y = name.replace("x", "y");
    const end = 1 - (index * (panel + BETWEEN)) / inner;
    found[name] = { ...layout[name], domain: [0, 1] };
    found[y] = { ...layout[y], domain: [end - panel / inner, end], showticklabels: true, title: layout.yaxis.title };
  });
  return found;
}

const plots = [];
function draw(plot) {
  const figure = JSON.parse(plot.parentElement.querySelector("script").textContent);
  const options = { displaylogo: false, displayModeBar: "hover", responsive: true };
  Plotly.react(plot, figure.data, arranged(figure.layout), options)
    .then(() => Plotly.relayout(plot, colours()))
    .then(() => plot.setAttribute("role", "group")) // plotly's "img" would hide its buttons from a screen reader
    .then(() => plot.offsetParent && Plotly.Plots.resize(plot)); // the window may have changed while it was drawn
  if (!plots.includes(plot)) plots.push(plot);
}
narrow.addEventListener("change", () => plots.forEach(draw));
for (const plot of document.querySelectorAll(".chart .plot")) {
  // What is folded has no width yet: it is drawn when it is opened first.
  const folded = plot.closest("details:not([open])");
  if (folded) folded.addEventListener("toggle", () => draw(plot), { once: true });
  else draw(plot);
}
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  for (const plot of plots) Plotly.relayout(plot, colours());
});
