"use strict";
(() => {
  // A click on a heading sorts the rows by its column, and a second one in the other direction.
  const table = document.querySelector("table.board"), body = table.tBodies[0];
  const heads = [...table.tHead.rows[0].cells];
  const value = (row, column) => row.cells[column].dataset.value ?? row.cells[column].textContent;
  heads.forEach((head, column) => head.firstElementChild.addEventListener("click", () => {
    const sign = head.getAttribute("aria-sort") === "ascending" ? -1 : 1;
    const isNumber = "value" in body.rows[0].cells[column].dataset;
    const order = (a, b) => isNumber ? value(a, column) - value(b, column) : value(a, column).localeCompare(value(b, column));
    body.append(...[...body.rows].sort((a, b) => sign * order(a, b)));
    heads.forEach(other => other.setAttribute("aria-sort", "none"));
    head.setAttribute("aria-sort", sign === 1 ? "ascending" : "descending");
  }));
})();
