"use strict";
// A button in each chart's caption saves the data that its picture carries.
for (const figure of document.querySelectorAll("figure.card")) {
  const charts = [...figure.querySelectorAll("svg.fig > metadata")], caption = figure.querySelector("figcaption");
  if (!charts.length || !caption) continue;
  const button = document.createElement("button"), title = caption.textContent.trim();
  const cell = (value) => (/[",\n]/.test(value) ? `"${value.replaceAll('"', '""')}"` : value);
  const csv = (text) => {
    const { columns, curves } = JSON.parse(text), rows = [columns];
    let x;
    for (const [name, across, ...rest] of curves) {
      x = across ?? x;
      x.forEach((at, k) => rows.push([name, at, ...rest.map((column) => column[k] ?? "")]));
    }
    return rows.map((row) => row.map((value) => cell(String(value))).join(",") + "\n").join("");
  };
  button.type = "button";
  button.className = "save";
  button.textContent = "Data (CSV)";
  button.setAttribute("aria-label", `Save the data of: ${title} (CSV)`);
  button.addEventListener("click", () => {
    const name = `${document.querySelector("h1").textContent} ${title}`.normalize("NFKD").replace(/[^\w.-]+/g, "-").slice(0, 100);
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([charts.map((chart) => csv(chart.textContent)).join("\n")], { type: "text/csv" }));
    link.download = `${name}.csv`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  });
  caption.prepend(button);
}
