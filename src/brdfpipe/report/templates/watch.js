"use strict";

// The page of a run while it is measured: it asks for the state every two seconds, and writes nothing.

const SVG = "http://www.w3.org/2000/svg", EVERY = 2000;
const by = (id) => document.getElementById(id);

function element(name, text, attributes = {}) {
  const made = document.createElement(name);
  made.textContent = text;
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return made;
}

function drawn(name, attributes) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return made;
}

function grade(cell) {
  if (cell.saturated) return "over";
  return cell.snr > 50 ? "good" : cell.snr > 10 ? "fair" : "poor";
}

function time(seconds) {
  const minutes = Math.round(seconds / 60), hours = Math.floor(minutes / 60);
  return hours ? `${hours} h ${minutes % 60} min` : `${minutes} min`;
}

function showPicture(state) {
  const picture = by("picture");
  picture.replaceChildren();
  if (!state.picture) return;
  const [width, height] = state.size;
  picture.setAttribute("viewBox", `-0.5 -0.5 ${width} ${height}`);
  picture.append(drawn("image", { href: state.picture, x: -0.5, y: -0.5, width, height, preserveAspectRatio: "none" }));
  for (const cell of state.cells) {
    if (cell.column === null || cell.row === null) continue;
    const circle = drawn("circle", { cx: cell.column, cy: cell.row, r: cell.radius ?? 1.2, class: grade(cell) });
    const title = document.createElementNS(SVG, "title");
    title.textContent = `${cell.name}: ${cell.snr ?? "no light"}`;
    circle.append(title);
    picture.append(circle);
  }
}

function showCells(cells = []) {
  const faintest = [...cells].sort((one, other) => (one.snr ?? -1) - (other.snr ?? -1));
  by("cells").replaceChildren(...faintest.map((cell) => {
    const row = document.createElement("tr");
    const light = cell.saturated ? "out of range" : cell.snr === null ? "not in the picture" : cell.snr.toFixed(1);
    row.append(element("th", cell.name, { scope: "row" }), ...[cell.theta, cell.phi, light].map((value) => element("td", value)));
    return row;
  }));
}

function show(state) {
  document.title = `${state.sample}: ${state.finished} of ${state.frames} frames`;
  by("title").textContent = `${state.sample} on ${state.rig}`;
  by("progress").max = state.frames;
  by("progress").value = state.finished;
  const left = state.finished < state.frames ? `, about ${time(state.seconds_left)} left` : "";
  by("status").textContent = `${state.finished} of ${state.frames} frames, ${state.status}${left}`;
  by("last").textContent = state.last ?? "no frame yet";
  by("warnings").replaceChildren(...[...state.warnings].reverse().map((text) => element("li", text)));
}

let shown = null;

async function refresh() {
  try {
    const answer = await fetch("state.json", { cache: "no-store" });
    if (!answer.ok) throw new Error(answer.statusText);
    const state = await answer.json();
    document.body.classList.remove("lost");
    show(state);
    if (state.last !== shown) {
      showPicture(state);
      showCells(state.cells);
      shown = state.last;
    }
  } catch {
    document.body.classList.add("lost");
    by("status").textContent = "no answer: `brdfpipe rig watch` has ended";
  }
  setTimeout(refresh, EVERY);
}

refresh();
