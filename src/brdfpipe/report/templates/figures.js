"use strict";
// A button in each chart's caption saves the data that its picture carries.
const cards = [...document.querySelectorAll("figure.card")].map((figure) => {
  const caption = figure.querySelector("figcaption");
  return { caption, title: caption?.textContent.trim(), charts: [...figure.querySelectorAll("svg.fig > metadata")].map((chart) => JSON.parse(chart.textContent)) };
});
// A chart that shows the data of others names these.
const shown = (charts) => charts.flatMap((chart) => (chart.charts ? cards.filter((card) => chart.charts.includes(card.title)).flatMap((card) => card.charts) : [chart]));
for (const { caption, title, charts } of cards) {
  if (!charts.length || !caption) continue;
  const button = document.createElement("button");
  const cell = (value) => (/[",\n]/.test(value) ? `"${value.replaceAll('"', '""')}"` : value);
  const csv = ({ columns, curves }) => {
    const rows = [columns];
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
    link.href = URL.createObjectURL(new Blob([shown(charts).map(csv).join("\n")], { type: "text/csv" }));
    link.download = `${name}.csv`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  });
  caption.prepend(button);
}
