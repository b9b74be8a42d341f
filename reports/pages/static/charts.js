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

const plots = [];
function draw(plot) {
  const figure = JSON.parse(plot.parentElement.querySelector("script").textContent);
  Plotly.newPlot(plot, figure.data, figure.layout, { displaylogo: false, displayModeBar: "hover", responsive: true })
    .then(() => Plotly.relayout(plot, colours()))
    .then(() => plot.setAttribute("role", "group")); // plotly's "img" would hide its buttons from a screen reader
  plots.push(plot);
}
for (const plot of document.querySelectorAll(".chart .plot")) {
  // What is folded has no width yet: it is drawn when it is opened first.
  const folded = plot.closest("details:not([open])");
  if (folded) folded.addEventListener("toggle", () => draw(plot), { once: true });
  else draw(plot);
}
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  for (const plot of plots) Plotly.relayout(plot, colours());
});
