"use strict";
(() => {
  const $ = (id) => document.getElementById(id);
  const table = $("materials"), body = table.tBodies[0], heads = [...table.tHead.rows[0].cells];
  const rank = { fail: 0, warn: 1, pass: 2 };
  const verdict = 1, warnings = 2; // columns
  const rows = [...body.rows].map((row) => {
    const words = row.cells[0].querySelector("small");
    if (words) words.title = words.textContent; // the table shows three lines of it
    const cells = [...row.cells].map((cell, k) => {
      const text = (cell.querySelector("a, b") || cell).textContent.trim(); // the name, the verdict, else a number
      if (k === 0) return text.toLowerCase();
      if (text in rank) return rank[text];
      return k === warnings && text === "" ? 0 : parseFloat(text.replace("\u2212", "-"));
    });
    return { row, cells, text: row.cells[0].textContent.toLowerCase(), verdict: row.cells[verdict].querySelector("b").textContent };
  });
  const order = (a, b) => (typeof a === "string" ? a.localeCompare(b, "en", { numeric: true }) : a - b);
  const sort = (column, sign) => {
    rows.sort((p, q) => {
      const a = p.cells[column], b = q.cells[column];
      const gone = Number.isNaN(a) - Number.isNaN(b); // unknown values come last, whichever way
      return gone || (Number.isNaN(a) ? 0 : sign * order(a, b)) || order(p.cells[0], q.cells[0]);
    });
    body.append(...rows.map((entry) => entry.row));
  };
  heads.forEach((head, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = head.textContent;
    head.replaceChildren(button);
    head.ariaSort = column === verdict ? "ascending" : "none"; // as the page comes
    button.addEventListener("click", () => {
      const up = head.ariaSort !== "ascending";
      heads.forEach((other) => { other.ariaSort = "none"; });
      head.ariaSort = up ? "ascending" : "descending";
      sort(column, up ? 1 : -1);
    });
  });
  const filter = () => {
    const words = $("words").value.toLowerCase().split(/\s+/).filter(Boolean), wanted = $("verdict").value;
    let shown = 0;
    for (const entry of rows) {
      const keep = (!wanted || entry.verdict === wanted) && words.every((word) => entry.text.includes(word));
      entry.row.hidden = !keep;
      shown += keep;
    }
    $("count").textContent = `${shown} of ${rows.length} shown`;
  };
  $("filter").addEventListener("submit", (event) => event.preventDefault());
  $("words").addEventListener("input", filter);
  $("verdict").addEventListener("change", filter);
  $("filter").hidden = false;
  filter();
})();
