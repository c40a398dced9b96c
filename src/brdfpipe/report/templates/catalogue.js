"use strict";
(() => {
  const $ = (id) => document.getElementById(id);
  const make = (name, properties = {}, ...children) => {
    const element = Object.assign(document.createElement(name), properties);
    element.append(...children);
    return element;
  };
  const data = JSON.parse($("catalogue-data").textContent);
  // Where scripts run, the table in the page is text. Parsed apart from the page it costs no layout, however long it is.
  const plain = new DOMParser().parseFromString($("plain-table").textContent, "text/html").querySelector(".scroll");
  const frame = document.adoptNode(plain), table = frame.querySelector("table"), body = table.tBodies[0], heads = [...table.tHead.rows[0].cells];
  const MOST_COMPARED = 4, ALL_AT_ONCE = 300, ROW = 72, MARGIN = 12, PAPER = 640; // rows shown without a window; height of a row of the window [px]; rows beyond its edges; width of the plot on paper [px]
  const VERDICT = 1, WARNINGS = 2, FIRST_QUANTITY = 3; // columns
  const rank = { fail: 0, warn: 1, pass: 2 };
  const number = (text) => parseFloat(text.replace("\u2212", "-"));
  const entries = [...body.rows].map((row, index) => {
    const name = row.cells[0].querySelector("a, span").textContent, verdict = row.cells[VERDICT].firstChild.textContent;
    const keys = [...row.cells].map((cell, k) => (k === 0 ? name.toLowerCase() : k === VERDICT ? rank[verdict] ?? NaN : k === WARNINGS ? +cell.textContent || 0 : number(cell.firstChild?.textContent ?? "")));
    return { index, name, verdict, keys, row, text: row.cells[0].textContent.toLowerCase(), route: data.routes[data.route[index]], lab: data.lab[index], delta: NaN };
  });
  body.replaceChildren();
  const byName = new Map(entries.map((entry) => [entry.name.toLowerCase(), entry]));
  const columnOf = (quantity) => (data.quantities.indexOf(quantity) < 0 ? -1 : FIRST_QUANTITY + data.quantities.indexOf(quantity));
  const gloss = columnOf("gloss_60"), anisotropy = columnOf("anisotropy");

  // --- colour differences
  // CIEDE2000: Sharma, Wu and Dalal, Color Research and Application 30 (2005) 21, eqs 2 to 22.
  const deltaE00 = ([l1, a1, b1], [l2, a2, b2]) => {
    const { sqrt, hypot, atan2, cos, sin, exp, abs, PI } = Math, rad = PI / 180, degrees = (y, x) => (y || x ? (atan2(y, x) / rad + 360) % 360 : 0);
    const c7 = ((hypot(a1, b1) + hypot(a2, b2)) / 2) ** 7, g = 0.5 * (1 - sqrt(c7 / (c7 + 25 ** 7)));
    const p1 = (1 + g) * a1, p2 = (1 + g) * a2, c1 = hypot(p1, b1), c2 = hypot(p2, b2), h1 = degrees(b1, p1), h2 = degrees(b2, p2), grey = c1 * c2 === 0;
    let turn = grey ? 0 : h2 - h1;
    if (turn > 180) turn -= 360; else if (turn < -180) turn += 360;
    const dl = l2 - l1, dc = c2 - c1, dh = 2 * sqrt(c1 * c2) * sin((turn / 2) * rad);
    const l = (l1 + l2) / 2, c = (c1 + c2) / 2, h = grey ? h1 + h2 : abs(h1 - h2) <= 180 ? (h1 + h2) / 2 : (h1 + h2 + (h1 + h2 < 360 ? 360 : -360)) / 2;
    const t = 1 - 0.17 * cos((h - 30) * rad) + 0.24 * cos(2 * h * rad) + 0.32 * cos((3 * h + 6) * rad) - 0.2 * cos((4 * h - 63) * rad);
    const sl = 1 + (0.015 * (l - 50) ** 2) / sqrt(20 + (l - 50) ** 2), sc = 1 + 0.045 * c, sh = 1 + 0.015 * c * t;
    const rt = -2 * sqrt(c ** 7 / (c ** 7 + 25 ** 7)) * sin(60 * exp(-(((h - 275) / 25) ** 2)) * rad);
    return sqrt((dl / sl) ** 2 + (dc / sc) ** 2 + (dh / sh) ** 2 + rt * (dc / sc) * (dh / sh));
  };
  // L*a*b* of what was typed: three numbers, or the name of a material; null for anything else.
  const colourOf = (typed) => {
    const named = byName.get(typed.toLowerCase());
    if (named) return named.lab;
    const numbers = typed.replaceAll("\u2212", "-").split(/[\s,;]+/).filter(Boolean).map(Number);
    return numbers.length === 3 && numbers.every(Number.isFinite) ? numbers : null;
  };

  // --- which rows, in which order
  let shown = entries, sorting = { column: VERDICT, sign: 1 };
  const NEAREST = -1; // the column of the colour differences
  const key = (entry) => (sorting.column === NEAREST ? entry.delta : entry.keys[sorting.column]);
  const words = new Intl.Collator("en", { numeric: true });
  entries.toSorted((p, q) => words.compare(p.keys[0], q.keys[0])).forEach((entry, place) => { entry.place = place; });
  const sort = () => {
    const value = sorting.column === 0 ? (entry) => entry.place : key;
    shown.sort((p, q) => {
      const a = value(p), b = value(q);
      return Number.isNaN(a) - Number.isNaN(b) || (Number.isNaN(a) ? 0 : sorting.sign * (a - b)) || p.place - q.place; // unknown values last, either way
    });
    heads.forEach((head, column) => { head.ariaSort = column !== sorting.column ? "none" : sorting.sign > 0 ? "ascending" : "descending"; });
  };
  const field = (id) => $(id).value.trim();
  const limit = (id, otherwise) => (field(id) === "" || !Number.isFinite(+field(id)) ? otherwise : +field(id));
  const update = () => {
    const searched = field("words").toLowerCase().split(/\s+/).filter(Boolean), verdict = $("verdict").value, route = $("route").value;
    const low = limit("gloss-low", -Infinity), high = limit("gloss-high", Infinity), least = limit("anisotropy", -Infinity);
    const typed = field("colour"), colour = typed ? colourOf(typed) : null, most = limit("difference", Infinity);
    const within = (column, a, b) => (entry) => a === -Infinity && b === Infinity ? true : entry.keys[column] >= a && entry.keys[column] <= b;
    const glossy = within(gloss, low, high), directed = within(anisotropy, least, Infinity);
    for (const entry of entries) entry.delta = colour && entry.lab ? deltaE00(colour, entry.lab) : NaN;
    shown = entries.filter((entry) => (!verdict || entry.verdict === verdict) && (!route || entry.route === route) && glossy(entry) && directed(entry)
      && (!colour || entry.delta <= most) && searched.every((word) => entry.text.includes(word)));
    if (!colour && sorting.column === NEAREST) sorting = { column: VERDICT, sign: 1 };
    sort();
    const unread = typed && !colour;
    $("colour").setAttribute("aria-invalid", unread);
    $("count").textContent = unread ? "The colour is not read: give L* a* b*, as in 48 34 22, or the name of a material with a colour" : `${shown.length} of ${entries.length} shown${colour && sorting.column === NEAREST ? ", nearest colour first" : ""}`;
    for (const line of document.querySelectorAll("#failed li")) line.hidden = !searched.every((word) => line.textContent.toLowerCase().includes(word));
    frame.scrollTop = 0;
    draw(true);
    remember();
  };

  // --- the rows in sight
  const above = make("tr", { className: "space" }), below = make("tr", { className: "space" });
  for (const space of [above, below]) { space.setAttribute("aria-hidden", "true"); space.append(make("td", { colSpan: heads.length })); }
  const dressed = (entry) => {
    if (!entry.pick) {
      const first = entry.row.cells[0], description = first.querySelector("small");
      if (description) description.title = description.textContent; // the table shows the first lines of it
      entry.pick = make("input", { type: "checkbox", ariaLabel: `Compare ${entry.name}` });
      entry.pick.addEventListener("change", () => pick(entry, entry.pick.checked));
      entry.difference = make("span", { className: "difference" });
      first.querySelector("a, span").before(make("label", { className: "pick" }, entry.difference, entry.pick, " compare"));
      document.adoptNode(entry.row);
    }
    entry.difference.textContent = Number.isNaN(entry.delta) ? "" : `ΔE00 ${entry.delta.toFixed(2)}`;
    entry.pick.checked = compared.includes(entry);
    entry.pick.disabled = compared.length >= MOST_COMPARED && !entry.pick.checked;
    return entry.row;
  };
  let drawn = [0, -1], whole = false;
  const draw = (anew = false) => {
    const windowed = !whole && shown.length > ALL_AT_ONCE;
    const first = windowed ? Math.max(0, Math.floor(frame.scrollTop / ROW) - MARGIN) : 0;
    const last = windowed ? Math.min(shown.length, first + Math.ceil((frame.clientHeight || 800) / ROW) + 2 * MARGIN) : shown.length;
    if (!anew && first === drawn[0] && last === drawn[1]) return;
    drawn = [first, last];
    table.classList.toggle("windowed", windowed);
    table.setAttribute("aria-rowcount", shown.length + 1);
    const focused = document.activeElement, held = body.contains(focused);
    const rows = shown.slice(first, last).map((entry, k) => { const row = dressed(entry); row.setAttribute("aria-rowindex", first + k + 2); return row; });
    above.firstChild.style.height = `${first * ROW}px`;
    below.firstChild.style.height = `${(shown.length - last) * ROW}px`;
    body.replaceChildren(...(first ? [above] : []), ...rows, ...(last < shown.length ? [below] : []));
    // A row that is replaced by itself loses the focus; one that left the window gives it to the table.
    if (held) (body.contains(focused) ? focused : frame).focus({ preventScroll: true });
  };
  let waiting = false;
  frame.addEventListener("scroll", () => {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => { waiting = false; draw(); });
  }, { passive: true });
  addEventListener("resize", () => draw());
  addEventListener("beforeprint", () => { whole = true; draw(true); drawPlot(); });
  addEventListener("afterprint", () => { whole = false; draw(true); drawPlot(); });

  // --- comparison
  const compared = [];
  const pick = (entry, chosen) => {
    if (chosen && !compared.includes(entry) && compared.length < MOST_COMPARED) compared.push(entry);
    if (!chosen) compared.splice(0, compared.length, ...compared.filter((one) => one !== entry));
    draw(true);
    compare();
    remember();
  };
  const levels = new Uint16Array(Uint8Array.from(atob(data.cuts), (c) => c.charCodeAt(0)).buffer);
  const [lowest, highest] = data.scale.decades, offsets = data.scale.offsets, perMaterial = offsets.length * data.scale.incidences.length;
  const cut = (entry, incidence) => offsets.map((_, k) => {
    const level = levels[entry.index * perMaterial + incidence * offsets.length + k];
    return level ? 10 ** (lowest + ((level - 1) / 65534) * (highest - lowest)) : null;
  });
  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const strokes = [["--c0", []], ["--c2", [7, 4]], ["--c4", [2, 3]], ["--c3", [10, 3, 2, 3]]];
  let plot = null;
  const drawPlot = () => {
    if (plot) plot.destroy();
    plot = null;
    const holder = $("overlay"), curves = compared.map((entry) => cut(entry, +$("overlay-incidence").value));
    const lit = curves.flat().filter((v) => v !== null);
    $("overlay-figure").hidden = !lit.length;
    if (!lit.length || $("comparison").hidden) return;
    const stroke = css("--ink2"), grid = { stroke: css("--grid") }, top = Math.ceil(Math.log10(Math.max(...lit))), base = Math.max(Math.floor(Math.log10(Math.min(...lit))), top - 7);
    plot = new uPlot({
      width: whole ? PAPER : holder.clientWidth || 600, height: whole ? 400 : Math.min(460, Math.max(300, 0.75 * holder.clientWidth)),
      scales: { x: { time: false }, y: { distr: 3, range: () => [10 ** base, 10 ** Math.max(top, base + 1)] } },
      axes: [{ stroke, grid, label: "degree from the mirror direction", labelSize: 20 }, { stroke, grid, size: 66, label: "BRDF, sr⁻¹", labelSize: 18, values: (_, ticks) => ticks.map((v) => (v === null ? "" : v < 1e-3 || v >= 1e5 ? v.toExponential(0).replace("-", "\u2212") : String(+v.toPrecision(1)))) }],
      series: [{ label: "angle", value: (_, v) => (v == null ? "–" : `${v}°`) }, ...compared.map((entry, k) => ({ label: entry.name, stroke: css(strokes[k][0]), dash: strokes[k][1], width: 2, spanGaps: false, value: (_, v) => (v == null ? "–" : v.toPrecision(3)) }))],
    }, [offsets, ...curves], holder);
  };
  const compare = () => {
    const section = $("comparison"), enough = compared.length >= 2;
    $("to-comparison").hidden = !compared.length;
    $("to-comparison").textContent = enough ? `Compare ${compared.length} materials ↓` : "1 material chosen; choose another";
    $("to-comparison").disabled = !enough;
    section.hidden = !enough;
    if (!enough) { drawPlot(); return; }
    $("comparison-title").textContent = `Comparison of ${compared.length} materials`;
    $("pictures").replaceChildren(...compared.map((entry) => {
      const cell = entry.row.cells[0], small = cell.querySelector("img"), link = cell.querySelector("a"), figure = make("figure");
      if (small) {
        const picture = make("img", { alt: `${entry.name}: sphere and panel in the light of all pictures`, src: small.src });
        if (link) { // the whole picture, where the folder of the material is beside this page
          const large = new Image();
          large.addEventListener("load", () => { picture.src = large.src; picture.classList.add("whole"); });
          large.src = link.getAttribute("href").replace(/report\.html$/, "preview.png");
        }
        figure.append(picture);
      }
      const remove = make("button", { type: "button", textContent: "remove" }), near = make("button", { type: "button", textContent: "nearest colours" });
      remove.addEventListener("click", () => { pick(entry, false); $("words").focus(); });
      near.addEventListener("click", () => { $("colour").value = entry.name; sorting = { column: NEAREST, sign: 1 }; update(); frame.focus(); });
      near.hidden = !entry.lab;
      figure.append(make("figcaption", {}, make(link ? "a" : "b", { textContent: entry.name, ...(link ? { href: link.getAttribute("href") } : {}) }), " ", near, " ", remove));
      return figure;
    }));
    const line = (title, cells) => make("tr", {}, make("th", { scope: "row", textContent: title }), ...cells.map((text) => make("td", { textContent: text })));
    const content = (entry, column) => { const cell = entry.row.cells[column], u = cell.querySelector("small"); return `${cell.firstChild?.textContent || "–"}${u && column !== VERDICT ? ` ${u.textContent}` : ""}`; };
    $("figures-compared").tHead.replaceChildren(make("tr", {}, make("th", { scope: "col", textContent: "Quantity" }), ...compared.map((entry) => make("th", { scope: "col", textContent: entry.name }))));
    $("figures-compared").tBodies[0].replaceChildren(
      ...compared.slice(0, -1).map((from) => line(`ΔE00 from ${from.name}`, compared.map((entry) => (entry === from ? "–" : from.lab && entry.lab ? deltaE00(from.lab, entry.lab).toFixed(2) : "no colour")))),
      line("Route", compared.map((entry) => entry.route)),
      ...heads.slice(1).map((head, k) => line(head.textContent, compared.map((entry) => (k + 1 === WARNINGS ? String(entry.keys[WARNINGS]) : content(entry, k + 1))))),
    );
    drawPlot();
  };
  $("overlay-incidence").append(...data.scale.incidences.map((angle, k) => make("option", { value: k, textContent: `${angle}°`, selected: angle === 45 })));
  $("overlay-incidence").addEventListener("change", drawPlot);
  $("to-comparison").addEventListener("click", () => { $("comparison").scrollIntoView(); $("comparison").focus({ preventScroll: true }); });
  $("save-cuts").addEventListener("click", () => {
    const quoted = (text) => `"${(/^[=+\-@]/.test(text) ? "'" : "") + text.replaceAll('"', '""')}"`, k = +$("overlay-incidence").value, curves = compared.map((entry) => cut(entry, k));
    const lines = [`# BRDF in sr-1; incidence ${data.scale.incidences[k]} degree`, ["angle_from_mirror_degree", ...compared.map((entry) => quoted(entry.name))].join(), ...offsets.map((angle, n) => [angle, ...curves.map((curve) => curve[n]?.toPrecision(5) ?? "")].join())];
    make("a", { href: `data:text/csv;charset=utf-8,${encodeURIComponent(lines.join("\n"))}`, download: "comparison.csv" }).click();
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawPlot);
  addEventListener("resize", drawPlot);

  // --- the address has what is shown: it comes back with the page, and can be passed on
  const fields = ["words", "verdict", "route", "gloss-low", "gloss-high", "anisotropy", "colour", "difference"];
  const remember = () => {
    const state = new URLSearchParams(fields.filter((id) => field(id)).map((id) => [id, field(id)]));
    if (sorting.column !== VERDICT || sorting.sign < 0) state.set("sort", `${sorting.column} ${sorting.sign}`);
    for (const entry of compared) state.append("compare", entry.name);
    history.replaceState(null, "", `#${state}`);
  };
  const recall = () => {
    const state = new URLSearchParams(location.hash.slice(1));
    for (const id of fields) if (state.has(id)) $(id).value = state.get(id);
    const [column, sign] = (state.get("sort") ?? "").split(" ").map(Number);
    if (Number.isInteger(column) && column >= NEAREST && column < heads.length && Math.abs(sign) === 1) sorting = { column, sign };
    compared.push(...state.getAll("compare").map((name) => byName.get(name.toLowerCase())).filter((entry, k, all) => entry && all.indexOf(entry) === k).slice(0, MOST_COMPARED));
  };

  heads.forEach((head, column) => {
    const button = make("button", { type: "button", textContent: head.textContent });
    head.replaceChildren(button);
    button.addEventListener("click", () => {
      sorting = { column, sign: head.ariaSort === "ascending" ? -1 : 1 };
      update();
    });
  });
  $("route").append(...data.routes.map((route) => make("option", { textContent: route })));
  for (const [id, absent] of [["route", data.routes.length < 2], ["gloss-low", gloss < 0], ["anisotropy", anisotropy < 0], ["colour", !data.lab.some(Boolean)]]) $(id).closest("[data-filter]").hidden = absent;
  $("filter").addEventListener("submit", (event) => event.preventDefault());
  for (const id of fields) $(id).addEventListener("input", () => {
    if (id === "colour") sorting = colourOf(field("colour")) ? { column: NEAREST, sign: 1 } : sorting;
    update();
  });
  $("filter").addEventListener("reset", () => setTimeout(() => { sorting = { column: VERDICT, sign: 1 }; update(); }));
  frame.classList.add("interactive");
  $("table-place").replaceWith(frame);
  $("filter").hidden = false;
  recall();
  update();
  compare();
})();
