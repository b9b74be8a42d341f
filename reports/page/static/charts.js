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
  for (const name of ["xaxis", "xaxis2", "yaxis", "yaxis2"])
    for (const [key, value] of Object.entries(axis)) layout[`${name}.${key}`] = value;
  return layout;
}

const plots = [...document.querySelectorAll(".chart .plot")];
for (const plot of plots) {
  const figure = JSON.parse(plot.parentElement.querySelector("script").textContent);
  Plotly.newPlot(plot, figure.data, figure.layout, { displaylogo: false, displayModeBar: "hover", responsive: true })
    .then(() => Plotly.relayout(plot, colours()))
    .then(() => plot.setAttribute("role", "group")); // plotly's "img" would hide its buttons from a screen reader
}
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  for (const plot of plots) Plotly.relayout(plot, colours());
});
