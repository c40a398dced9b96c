"use strict";
(() => {
  const source = document.getElementById("viewer-data"), root = document.getElementById("viewer");
  if (!source || !root) return;
  const data = JSON.parse(source.textContent), $ = (name) => root.querySelector(`[data-part=${name}]`);
  const { PI, sin, cos, hypot, atan2, asinh, sinh, sqrt, max, min, abs, floor, round } = Math;
  const rad = PI / 180, I = data.incidences, clamp = (v, a, b) => max(a, min(b, v));
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const words16 = (text) => new Uint16Array(bytes(text).buffer);
  const decode = (packed, low, high) => Float64Array.from(words16(packed), (v) => (v ? low + ((v - 1) / 65534) * ((high - low) || 1) : NaN));
  for (const s of data.sets) {
    s.values = decode(s.logs, s.low, s.high);
    if (s.ratios) s.ratio = decode(s.ratios, ...s.ratio_range);
    if (s.quality) s.basis = bytes(s.quality);
  }
  const lagrange = (nodes, at) => nodes.map((n, k) => nodes.reduce((w, o, j) => (j === k ? w : (w * (at - o)) / (n - o)), 1));
  const around = (nodes, at) => { let k = 0; while (k < nodes.length - 4 && at >= nodes[k + 2]) k++; return k; };
  const rimAndStretch = (c, psi, slope) => {
    const R = max(-c * cos(psi) + sqrt(max(1 - (c * sin(psi)) ** 2, 0)), 1e-9);
    return [R, clamp(asinh(R / (slope * sqrt(1 - c * c))), 0.5, 14)];
  };
  // The nodes of one incidence and wavelength: everything but the direction is interpolated once.
  const slice = (s, incidence, wavelength) => {
    const [, turns, distances] = s.shape, size = turns * distances, grid = new Float64Array(size);
    const first = around(I, incidence), nodes = I.slice(first, first + 4), w = lagrange(nodes, incidence);
    const full = s.shape[1] === 48;
    let peak = 0;
    for (let k = 0; k < 4; k++) {
      peak += w[k] * s.peak[first + k];
      for (let n = 0; n < size; n++) grid[n] += w[k] * s.values[(first + k) * size + n];
    }
    if (s.ratio && wavelength !== undefined) {
      const L = s.wavelengths, j = clamp(L.findIndex((l) => l >= wavelength), 1, L.length - 1);
      const f = clamp((wavelength - L[j - 1]) / (L[j] - L[j - 1]), 0, 1);
      const I2 = I.filter((_, k) => k % 2 === 0), a = clamp(I2.findIndex((v) => v >= incidence), 1, I2.length - 1);
      const g = clamp((incidence - I2[a - 1]) / (I2[a] - I2[a - 1]), 0, 1);
      const T = Math.ceil(turns / 4), D = Math.ceil(distances / 3), block = I2.length * T * D;
      const at = (l, i, p, d) => s.ratio[l * block + (i * T + (full ? p % T : min(p, T - 1))) * D + min(d, D - 1)];
      for (let p = 0; p < turns; p++) for (let d = 0; d < distances; d++) {
        const p0 = floor(p / 4), fp = p / 4 - p0, d0 = floor(d / 3), fd = d / 3 - d0;
        let sum = 0;
        for (const [l, wl] of [[j - 1, 1 - f], [j, f]]) for (const [i, wi] of [[a - 1, 1 - g], [a, g]]) {
          if (wl * wi === 0) continue;
          sum += wl * wi * ((1 - fp) * ((1 - fd) * at(l, i, p0, d0) + fd * at(l, i, p0, d0 + 1)) + fp * ((1 - fd) * at(l, i, p0 + 1, d0) + fd * at(l, i, p0 + 1, d0 + 1)));
        }
        grid[p * distances + d] += sum;
      }
    }
    return { grid, c: sin(min(peak, 89) * rad), peak, slope: s.slope, turns, distances, full, s, incidence };
  };
  const cubic = (f) => [(-f + 2 * f * f - f ** 3) / 2, (2 - 5 * f * f + 3 * f ** 3) / 2, (f + 4 * f * f - 3 * f ** 3) / 2, (f ** 3 - f * f) / 2];
  const position = (q, x, y) => {
    const dx = x - q.c, psi = atan2(y, dx), [R, a] = rimAndStretch(q.c, psi, q.slope);
    const h = 1 - sqrt(clamp(1 - hypot(dx, y) / R, 0, 1)), turn = (psi + 2 * PI) % (2 * PI);
    return [q.full ? (turn / (2 * PI)) * q.turns : (abs(psi) / PI) * (q.turns - 1), (asinh(h * sinh(a)) / a) * (q.distances - 1)];
  };
  // Decimal logarithm at direction cosines (x, y); NaN without light.
  const logAt = (q, x, y) => {
    const [p, t] = position(q, x, y), p0 = floor(p), t0 = floor(t), wp = cubic(p - p0), wt = cubic(t - t0), half = floor(q.turns / 2);
    let sum = 0;
    for (let a = 0; a < 4; a++) for (let b = 0; b < 4; b++) {
      let column = p0 - 1 + a, row = t0 - 1 + b;
      const opposite = row < 0;
      if (q.full) column = (column + (opposite ? half : 0) + 2 * q.turns) % q.turns;
      else {
        column = abs(column);
        if (column > q.turns - 1) column = 2 * (q.turns - 1) - column;
        if (opposite) column = q.turns - 1 - column;
      }
      row = min(abs(row), q.distances - 1);
      const share = wp[a] * wt[b];
      if (share) sum += share * q.grid[column * q.distances + row];
    }
    return sum;
  };
  const basisAt = (q, x, y) => {
    if (!q.s.basis) return "";
    const [p, t] = position(q, x, y), T = Math.ceil(q.turns / 4), D = Math.ceil(q.distances / 3);
    const i = I.filter((_, k) => k % 2 === 0).reduce((best, v, k, all) => (abs(v - q.incidence) < abs(all[best] - q.incidence) ? k : best), 0);
    return q.s.flags[q.s.basis[(i * T + (q.full ? round(p / 4) % T : min(round(p / 4), T - 1))) * D + min(round(t / 3), D - 1)]];
  };
  // --- state
  const names = [...new Set(data.sets.map((s) => s.name))], sides = [...new Set(data.sets.map((s) => s.side))];
  const both = names.length > 1;
  const state = { incidence: 45, wavelength: data.reference, plane: 0, side: sides[0], show: names[0], cut: 0, zoom: 1, spin: -60, tilt: 25, linear: false };
  const spectral = data.sets.find((s) => s.wavelengths);
  const of = (name) => data.sets.find((s) => s.name === name && s.side === state.side && s.plane === state.plane);
  let shown = {}; // name → slice
  const value = (x, y) => {
    if (hypot(x, y) >= 1) return NaN;
    if (state.show === "ratio") return logAt(shown[names[0]], x, y) - logAt(shown[names[1]], x, y);
    return logAt(shown[state.show], x, y);
  };
  const main = () => shown[state.show === "ratio" ? names[0] : state.show];
  const raised = (power) => `10${[...String(power)].map((c) => (c === "-" ? "⁻" : "⁰¹²³⁴⁵⁶⁷⁸⁹"[c])).join("")}`;
  const plain = (v) => {
    const power = floor(Math.log10(v) + 1e-9), factor = Number((v / 10 ** power).toPrecision(3));
    return power >= -3 && power < 5 ? String(Number(v.toPrecision(3))) : `${factor === 1 ? "" : `${factor}·`}${raised(power)}`;
  };
  const isBelow = (v) => state.show !== "ratio" && main().s.floor !== null && v < main().s.floor + 0.02; // sampled as the least value that is kept
  const text = (v) => (!Number.isFinite(v) ? "no light" : isBelow(v) ? `less than ${plain(10 ** main().s.floor)}` : plain(10 ** v));
  const through = () => state.side === "transmitted";
  const unit = () => (state.show === "ratio" ? "" : " sr⁻¹");
  const quantity = () => (state.side === "reflected" ? "BRDF" : "BTDF");
  // --- controls
  const option = (name, values, labels = values) => {
    const select = $(name);
    select.replaceChildren(...values.map((v, k) => Object.assign(document.createElement("option"), { value: v, textContent: labels[k] })));
    select.closest("label").hidden = values.length < 2;
    select.addEventListener("change", () => { state[name] = typeof state[name] === "number" ? +select.value : select.value; update(); });
  };
  option("plane", data.planes.map((_, k) => k), data.planes);
  option("side", sides);
  option("show", both ? [...names, "ratio"] : names, both ? [...names, `${names[0]} / ${names[1]}`] : names);
  option("cut", [0, 1], ["in the plane of incidence", "across it, through the lobe"]);
  $("incidence").addEventListener("input", (e) => { state.incidence = +e.target.value; update(); });
  if (spectral) {
    const L = spectral.wavelengths;
    Object.assign($("wavelength"), { min: L[0], max: L[L.length - 1], value: state.wavelength });
    $("wavelength").addEventListener("input", (e) => { state.wavelength = +e.target.value; update(); });
  } else $("wavelength").closest("label").hidden = true;
  $("zoom").addEventListener("input", (e) => { state.zoom = 2 ** +e.target.value; draw(); });
  $("lobe").addEventListener("click", () => { state.zoom = clamp(0.25 / (main().slope * sqrt(1 - main().c ** 2)), 1, 1024); $("zoom").value = Math.log2(state.zoom); draw(); });
  $("whole").addEventListener("click", () => { state.zoom = 1; $("zoom").value = 0; draw(); });
  $("linear").addEventListener("change", (e) => { state.linear = e.target.checked; draw(); });
  // --- drawing
  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const V = [[0.2777273272, 0.0054073445, 0.3340998053], [0.1050930431, 1.4046135299, 1.3845901626], [-0.3308618287, 0.2148475595, 0.095095163], [-4.6342304990, -5.7991009734, -19.3324409563], [6.2282699363, 14.1799333668, 56.6905526007], [4.7763849977, -13.7451453777, -65.3530326334], [-5.4354558559, 4.6458526122, 26.3124352496]];
  const palette = Array.from({ length: 257 }, (_, k) => [0, 1, 2].map((c) => 255 * clamp(V.reduce((sum, row, n) => sum + row[c] * (k / 256) ** n, 0), 0, 1)));
  const canvas = (name) => {
    const element = $(name), ratio = min(devicePixelRatio || 1, 2), w = element.clientWidth || 360, h = element.clientHeight || 300;
    if (element.width !== round(w * ratio)) { element.width = round(w * ratio); element.height = round(h * ratio); }
    const pen = element.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, w, h);
    pen.font = "12px system-ui,sans-serif";
    return { pen, w, h, ratio, element };
  };
  let range = [-3, 0]; // colours and radii, decades
  const findRange = () => {
    let low = Infinity, high = -Infinity;
    const seen = [];
    for (let k = 0; k < 31; k++) for (let j = 0; j < 31; j++) { const v = value((k - 15) / 15.2, (j - 15) / 15.2); if (Number.isFinite(v)) seen.push(v); }
    const q = main(), peak = value(q.c, 0);
    if (Number.isFinite(peak)) seen.push(peak);
    seen.sort((a, b) => a - b);
    if (!seen.length) return [-3, 0];
    low = seen[floor(seen.length * 0.03)]; high = seen[seen.length - 1];
    if (state.show === "ratio") { const m = clamp(max(abs(low), abs(high)), 0.02, 1); return [-m, m]; }
    return high - low < 0.02 ? [low - 1, high + 0.05] : [max(low, high - 6), high];
  };
  const level = (v) => clamp((v - range[0]) / (range[1] - range[0]), 0, 1);
  const reach = (v) => (state.linear && state.show !== "ratio" ? 10 ** (v - range[1]) : 0.12 + 0.88 * level(v));
  let map = { centre: 0, scale: 1, x: 0, y: 0 };
  const drawMap = () => {
    const { pen, w, h, ratio, element } = canvas("map"), r = min(w - 70, h - 34) / 2, cx = r + 8, cy = h / 2;
    const centre = state.zoom > 1 ? main().c : 0, scale = r * state.zoom;
    map = { centre, scale, x: cx, y: cy, r };
    const n = round(2 * r * ratio), image = pen.createImageData(n, n);
    for (let row = 0; row < n; row++) for (let col = 0; col < n; col++) {
      const x = centre + (col / ratio - r) / scale, y = (r - row / ratio) / scale, v = value(x, y);
      if (!Number.isFinite(v)) continue;
      const rgb = palette[round(256 * level(v))], k = 4 * (row * n + col);
      image.data[k] = rgb[0]; image.data[k + 1] = rgb[1]; image.data[k + 2] = rgb[2]; image.data[k + 3] = 255;
    }
    pen.putImageData(image, round((cx - r) * ratio), round((cy - r) * ratio));
    pen.save();
    pen.beginPath(); pen.rect(cx - r, cy - r, 2 * r, 2 * r); pen.clip();
    const px = (x) => cx + (x - centre) * scale, py = (y) => cy - y * scale;
    pen.strokeStyle = css("--ref");
    pen.beginPath(); pen.arc(px(0), cy, scale, 0, 2 * PI); pen.stroke();
    pen.strokeStyle = "rgba(255,255,255,.6)";
    for (const angle of [30, 60]) { pen.beginPath(); pen.arc(px(0), cy, scale * sin(angle * rad), 0, 2 * PI); pen.stroke(); }
    // The source: an arrow to drag; the lobe's direction: a ring.
    const sx = px(-sin(state.incidence * rad));
    for (const [colour, width] of [["#000", 5], ["#fff", 2.2]]) {
      pen.strokeStyle = colour; pen.lineWidth = width;
      pen.beginPath(); pen.moveTo(sx - 16, cy); pen.lineTo(sx, cy); pen.lineTo(sx - 6, cy - 5); pen.moveTo(sx, cy); pen.lineTo(sx - 6, cy + 5);
      pen.moveTo(px(main().c) + 7, cy); pen.arc(px(main().c), cy, 7, 0, 2 * PI); pen.stroke();
    }
    pen.restore();
    const bar = cx + r + 14;
    for (let k = 0; k < 2 * r; k++) { pen.fillStyle = `rgb(${palette[round(256 * (1 - k / (2 * r)))].map(round)})`; pen.fillRect(bar, cy - r + k, 10, 1.5); }
    pen.fillStyle = css("--ink2"); pen.textBaseline = "middle";
    for (let k = 0; k <= 4; k++) pen.fillText(text(range[0] + (k / 4) * (range[1] - range[0])), bar + 14, cy + r - (k / 4) * 2 * r);
    pen.textBaseline = "alphabetic";
  };
  // The direction cosines of a cut at an angle from the normal (cut 0) or from the lobe (cut 1), degree.
  const onCut = (angle) => {
    if (state.cut === 0) return [sin(angle * rad), 0];
    const peak = main().peak * rad, a = angle * rad;
    return [cos(a) * sin(peak), sin(a)];
  };
  const cutAngles = () => {
    const peak = state.cut === 0 ? main().peak : 0, width = clamp(main().slope / rad / 4, 1e-3, 0.5), all = new Set([peak]);
    for (let a = -89; a <= 89; a++) all.add(a);
    for (let k = 0; k < 48; k++) { const d = width * (25 / width) ** (k / 47); all.add(peak + d); all.add(peak - d); }
    return [...all].filter((a) => abs(a) <= 89).sort((a, b) => a - b);
  };
  const curves = () => (state.show === "ratio" ? [{ name: "ratio", f: value }] : names.filter((n) => shown[n]).map((name) => ({ name, f: (x, y) => logAt(shown[name], x, y) })));
  const colours = ["--c0", "--c2"];
  let polarBox = null;
  const drawPolar = () => {
    const { pen, w, h } = canvas("polar"), r = min(w / 2 - 26, h - 64), cx = w / 2, up = through() ? -1 : 1, cy = through() ? 26 : h - 22;
    polarBox = { cx, cy, r, up };
    pen.strokeStyle = css("--grid"); pen.fillStyle = css("--ink2"); pen.textAlign = "center";
    for (let k = 1; k <= 4; k++) { pen.beginPath(); pen.arc(cx, cy, (r * k) / 4, through() ? 0 : PI, through() ? PI : 2 * PI); pen.stroke(); }
    for (let a = -90; a <= 90; a += 30) { pen.beginPath(); pen.moveTo(cx, cy); pen.lineTo(cx + r * sin(a * rad), cy - up * r * cos(a * rad)); pen.stroke(); pen.fillText(`${abs(a)}°`, cx + (r + 13) * sin(a * rad), cy - up * (r + 9) * cos(a * rad) + 3); }
    const angles = cutAngles();
    curves().forEach(({ f }, k) => {
      pen.strokeStyle = css(colours[k]); pen.lineWidth = 2; pen.setLineDash(k ? [6, 4] : []); pen.beginPath();
      let down = false;
      for (const a of angles) { const v = f(...onCut(a)); if (!Number.isFinite(v)) { down = false; continue; } const d = r * clamp(reach(v), 0, 1.05), x = cx + d * sin(a * rad), y = cy - up * d * cos(a * rad); down ? pen.lineTo(x, y) : pen.moveTo(x, y); down = true; }
      pen.stroke();
    });
    pen.setLineDash([]);
    if (state.cut === 0 && !through()) { // the source: a triangle to drag
      pen.save(); pen.translate(cx - r * sin(state.incidence * rad), cy - r * cos(state.incidence * rad)); pen.rotate(-state.incidence * rad);
      pen.fillStyle = css("--c3"); pen.beginPath(); pen.moveTo(0, 16); pen.lineTo(-7, -4); pen.lineTo(7, -4); pen.fill(); pen.restore();
    }
    pen.fillStyle = css("--ink2"); pen.fillText(`${state.linear ? "linear" : "logarithmic"} radius; rim ${text(range[1])}${unit()}${through() ? "; angles from the lower normal" : ""}`, cx, h - 4);
    pen.textAlign = "start";
  };
  const drawLobe = () => {
    const { pen, w, h } = canvas("solid"), r = min(w / 2.2, h * (through() ? 0.5 : 0.62)), cx = w / 2, cy = h * (through() ? 0.56 : 0.72), side = through() ? -1 : 1, q = main();
    const a = state.spin * rad, b = state.tilt * rad;
    const project = (x, y, z) => { const u = x * cos(a) - y * sin(a), v = x * sin(a) + y * cos(a); return [cx + r * u, cy - r * (z * cos(b) + v * sin(b)), v * cos(b) - z * sin(b)]; };
    pen.strokeStyle = css("--grid"); pen.lineWidth = 1;
    for (const s of [0.5, 1]) { pen.beginPath(); for (let k = 0; k <= 72; k++) { const p = project(s * cos(k * 5 * rad), s * sin(k * 5 * rad), 0); k ? pen.lineTo(p[0], p[1]) : pen.moveTo(p[0], p[1]); } pen.stroke(); }
    const rows = 26, columns = 48, points = [];
    for (let i = 0; i <= rows; i++) for (let j = 0; j < columns; j++) {
      const psi = (j / columns) * 2 * PI, [R, s] = rimAndStretch(q.c, psi, q.slope), t = sinh((s * i) / rows) / sinh(s), d = min(R * (1 - (1 - t) ** 2), R * (1 - 1e-4));
      const x = q.c + d * cos(psi), y = d * sin(psi), v = value(x, y), k = Number.isFinite(v) ? reach(v) : 0;
      points.push([...project(k * x, k * y, side * k * sqrt(max(1 - x * x - y * y, 0))), v]);
    }
    const faces = [];
    for (let i = 0; i < rows; i++) for (let j = 0; j < columns; j++) {
      const corner = [i * columns + j, i * columns + ((j + 1) % columns), (i + 1) * columns + ((j + 1) % columns), (i + 1) * columns + j].map((k) => points[k]);
      faces.push([corner.reduce((sum, p) => sum + p[2], 0), corner]);
    }
    faces.sort((m, n) => n[0] - m[0]);
    for (const [, corner] of faces) {
      const v = (corner[0][3] + corner[2][3]) / 2;
      pen.fillStyle = pen.strokeStyle = Number.isFinite(v) ? `rgb(${palette[round(256 * level(v))].map(round)})` : css("--grid");
      pen.beginPath(); corner.forEach((p, k) => (k ? pen.lineTo(p[0], p[1]) : pen.moveTo(p[0], p[1]))); pen.closePath(); pen.fill(); pen.lineWidth = 0.6; pen.stroke();
    }
    const end = project(-sin(state.incidence * rad), 0, cos(state.incidence * rad)), origin = project(0, 0, 0), top = project(0, 0, 1);
    pen.strokeStyle = css("--ref"); pen.setLineDash([4, 4]); pen.lineWidth = 1; pen.beginPath(); pen.moveTo(origin[0], origin[1]); pen.lineTo(top[0], top[1]); pen.stroke(); pen.setLineDash([]);
    pen.strokeStyle = css("--c3"); pen.lineWidth = 2.5; pen.beginPath(); pen.moveTo(end[0], end[1]); pen.lineTo(origin[0], origin[1]); pen.stroke();
    pen.fillStyle = css("--ink2"); pen.fillText("normal", top[0] + 4, top[1]); pen.fillText("light", end[0] + 4, end[1] - 4);
  };
  let plot = null, plotKey = "";
  const drawCartesian = () => {
    const holder = $("cartesian"), angles = cutAngles(), lines = curves();
    const series = [angles, ...lines.map(({ f }) => angles.map((a) => { const v = f(...onCut(a)); return Number.isFinite(v) && !isBelow(v) ? 10 ** v : null; }))];
    const key = [state.show, state.side, holder.clientWidth, state.linear, state.cut, css("--ink")].join();
    if (plot && plotKey === key) { plot.setData(series); return; }
    if (plot) plot.destroy();
    plotKey = key;
    const stroke = css("--ink2"), grid = { stroke: css("--grid") };
    plot = new uPlot({
      width: holder.clientWidth || 360, height: 290, scales: { x: { time: false }, y: state.linear || state.show === "ratio" ? {} : { distr: 3, range: () => [10 ** floor(range[0]), 10 ** Math.ceil(range[1])] } },
      axes: [{ stroke, grid, label: state.cut === 0 ? "angle of view, degree" : "angle from the lobe, degree", labelSize: 20 }, { stroke, grid, size: 64, label: state.show === "ratio" ? "ratio" : `${quantity()}, sr⁻¹`, labelSize: 18, ...(state.linear || state.show === "ratio" ? {} : { values: (_, ticks) => ticks.map((v) => (v === null ? "" : plain(v))) }) }],
      series: [{ label: "angle", value: (_, v) => (v == null ? "–" : `${v.toFixed(2)}°`) }, ...lines.map(({ name }, k) => ({ label: name, stroke: css(colours[k]), width: 2, dash: k ? [6, 4] : undefined, value: (_, v) => (v == null ? "–" : plain(v)) }))],
    }, series, holder);
  };
  const say = (x, y) => {
    if (hypot(x, y) >= 1) return;
    const v = value(x, y), q = main(), theta = Math.asin(hypot(x, y)) / rad, phi = atan2(y, x) / rad;
    const z = sqrt(1 - x * x - y * y), from = Math.acos(clamp(x * q.c + z * sqrt(1 - q.c * q.c), -1, 1)) / rad, basis = basisAt(q, x, y);
    $("value").textContent = `${state.show === "ratio" ? "ratio" : quantity()} ${text(v)}${unit()} at θ ${theta.toFixed(1)}°, φ ${phi.toFixed(0)}°, ${from.toFixed(from < 1 ? 3 : 1)}° from the lobe${basis ? `; ${basis}` : ""}`;
    root.dataset.value = Number.isFinite(v) ? String(10 ** v) : "";
    return v;
  };
  let waiting = false;
  const draw = () => {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => { waiting = false; range = findRange(); drawMap(); drawPolar(); drawLobe(); drawCartesian(); });
  };
  const update = () => {
    state.incidence = clamp(state.incidence, 0, I[I.length - 1]);
    shown = {};
    for (const name of names) { const s = of(name); if (s) shown[name] = slice(s, state.incidence, state.wavelength); }
    if (state.show === "ratio" ? !names.every((name) => shown[name]) : !shown[state.show]) {
      state.show = Object.keys(shown)[0];
      if ($("show")) $("show").value = state.show;
    }
    $("incidence").value = state.incidence;
    $("incidence-text").textContent = `${state.incidence.toFixed(1)}°`;
    $("wavelength-text").textContent = spectral ? `${state.wavelength} nm` : "";
    const s = main().s, k = clamp(I.findIndex((v) => v >= state.incidence), 1, I.length - 1), f = (state.incidence - I[k - 1]) / (I[k] - I[k - 1]);
    const share = (1 - f) * s.specular[k - 1] + f * s.specular[k], [median, high] = s.error;
    $("note").textContent = (median === null ? "" : `Between sampled directions: median error ${Number((100 * median).toPrecision(2))} %, 95 % of directions within ${Number((100 * high).toPrecision(2))} %, at ${data.reference ?? "every"} nm. `) +
      (share > 1e-5 ? `Specular light, about ${(100 * share).toPrecision(2)} %, goes into one direction and has no ${quantity()}: it is not drawn. ` : "") +
      (both ? "Cuts: solid measured, dashed predicted." : "");
    say(main().c, 0);
    draw();
  };
  // --- pointer
  const drag = (name, move) => {
    const element = $(name);
    let held = false;
    const at = (event) => { const box = element.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; };
    element.addEventListener("pointerdown", (event) => { held = true; element.setPointerCapture(event.pointerId); move(...at(event), true, event); });
    element.addEventListener("pointerup", () => { held = false; });
    element.addEventListener("pointermove", (event) => move(...at(event), held, event));
  };
  let grabbed = false;
  drag("map", (px, py, held, event) => {
    const x = map.centre + (px - map.x) / map.scale, y = (map.y - py) / map.scale;
    if (event.type === "pointerdown") grabbed = hypot(px - (map.x + (-sin(state.incidence * rad) - map.centre) * map.scale), py - map.y) < 24;
    if (held && grabbed && hypot(x, y) < 1) { state.incidence = Math.asin(clamp(-x, 0, 0.999)) / rad; update(); } else say(x, y);
  });
  drag("polar", (px, py, held, event) => {
    const angle = atan2(px - polarBox.cx, polarBox.up * (polarBox.cy - py)) / rad;
    if (event.type === "pointerdown") grabbed = state.cut === 0 && !through() && angle < 5;
    if (held && grabbed) { state.incidence = clamp(-angle, 0, 85); update(); } else if (abs(angle) < 90) say(...onCut(angle));
  });
  let last = null;
  drag("solid", (px, py, held, event) => {
    if (event.type !== "pointerdown" && held && last) { state.spin += (px - last[0]) * 0.6; state.tilt = clamp(state.tilt + (py - last[1]) * 0.4, -5, 89); drawLobe(); }
    last = [px, py];
  });
  $("map").addEventListener("wheel", (event) => { event.preventDefault(); state.zoom = clamp(state.zoom * (event.deltaY < 0 ? 1.25 : 0.8), 1, 1024); $("zoom").value = Math.log2(state.zoom); draw(); }, { passive: false });
  // --- keyboard: a direction on the map, turning of the lobe
  let probe = null;
  $("map").addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
    if (event.key === "+" || event.key === "-") { state.zoom = clamp(state.zoom * (event.key === "+" ? 1.5 : 1 / 1.5), 1, 1024); $("zoom").value = Math.log2(state.zoom); draw(); event.preventDefault(); return; }
    if (!step) return;
    event.preventDefault();
    probe = probe || [main().c, 0];
    const next = [probe[0] + (0.02 * step[0]) / state.zoom, probe[1] + (0.02 * step[1]) / state.zoom];
    if (hypot(...next) < 1) probe = next;
    say(...probe);
  });
  $("solid").addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [-6, 0], ArrowRight: [6, 0], ArrowUp: [0, 5], ArrowDown: [0, -5] }[event.key];
    if (!step) return;
    event.preventDefault(); state.spin += step[0]; state.tilt = clamp(state.tilt + step[1], -5, 89); drawLobe();
  });
  $("save").addEventListener("click", () => {
    const lines = [`# ${document.title}; incidence ${state.incidence} degree; ${state.wavelength ?? "all"} nm; ${state.side}`, `angle_degree,${curves().map((c) => (c.name === "ratio" ? "ratio" : `${c.name}_sr-1`)).join(",")}`];
    for (const a of cutAngles()) lines.push([a.toFixed(4), ...curves().map(({ f }) => { const v = f(...onCut(a)); return Number.isFinite(v) && !isBelow(v) ? (10 ** v).toPrecision(5) : ""; })].join(","));
    const link = Object.assign(document.createElement("a"), { href: `data:text/csv;charset=utf-8,${encodeURIComponent(lines.join("\n"))}`, download: "cut.csv" });
    link.click();
  });
  root.hidden = false;
  document.documentElement.classList.add("interactive");
  addEventListener("resize", draw);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  update();
})();
