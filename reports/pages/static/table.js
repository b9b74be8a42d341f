// Sorts and filters each table of class "sortable"; without it they are plain tables in the order of the page.
"use strict";

function cellOf(row, column) {
  const cell = row.cells[column];
  return cell.dataset.sort === undefined ? cell.textContent.trim() : Number.parseFloat(cell.dataset.sort);
}

// Numbers before words, words by letter, and what has no value last whichever way is up.
function compare(a, b, down) {
  const missing = (value) => value === "" || value === "–" || Number.isNaN(value);
  if (missing(a) || missing(b)) return missing(a) - missing(b);
  const order = typeof a === "number" && typeof b === "number" ? a - b : String(a).localeCompare(String(b), "en");
  return down ? -order : order;
}

function sortable(table) {
  const heads = [...table.tHead.rows[0].cells];
  const body = table.tBodies[0];
  heads.forEach((head, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      const down = head.getAttribute("aria-sort") === "ascending";
      for (const each of heads) each.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", down ? "descending" : "ascending");
      const rows = [...body.rows];
      rows.sort((a, b) => compare(cellOf(a, column), cellOf(b, column), down));
      body.append(...rows);
    });
  });
}

function filtered(table) {
  const rows = [...table.tBodies[0].rows];
  const controls = document.createElement("form");
  controls.className = "controls";
  controls.setAttribute("role", "search");
  const shown = document.createElement("output");
  const choices = [];

  const words = document.createElement("input");
  words.type = "search";
  words.placeholder = "any words of a row";
  controls.append(labelled(table.dataset.filter, words));
  [...table.tHead.rows[0].cells].forEach((head, column) => {
    if (head.dataset.choose === undefined) return;
    const choice = document.createElement("select");
    const values = [...new Set(rows.map((row) => valueOf(row, column)))];
    choice.append(new Option("all", ""), ...values.map((value) => new Option(value, value)));
    choices.push([choice, column]);
    controls.append(labelled(head.textContent, choice));
  });
  controls.append(shown);

  function apply() {
    const wanted = words.value.toLowerCase().split(/\s+/).filter(Boolean);
    let count = 0;
    for (const row of rows) {
      const text = row.textContent.toLowerCase();
      row.hidden =
        !wanted.every((word) => text.includes(word)) ||
        choices.some(([choice, column]) => choice.value !== "" && valueOf(row, column) !== choice.value);
      if (!row.hidden) count += 1;
    }
    shown.textContent = `${count} of ${rows.length} rows`;
  }
  controls.addEventListener("input", apply);
  controls.addEventListener("submit", (event) => event.preventDefault());
  apply();
  (table.closest(".scroll") ?? table).before(controls);
}

// What a cell is chosen by: its own word for it where the text holds more, such as the sign of a verdict.
function valueOf(row, column) {
  return row.cells[column].dataset.value ?? row.cells[column].textContent.trim();
}

function labelled(text, control) {
  const label = document.createElement("label");
  label.append(text, control);
  return label;
}

for (const table of document.querySelectorAll("table.sortable")) {
  // The names of columns are read before they become buttons.
  filtered(table);
  sortable(table);
}
