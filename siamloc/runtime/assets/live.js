"use strict";

const $ = (id) => document.getElementById(id);
const SVG = "http://www.w3.org/2000/svg";
const AGES = 6; // shades of the path so far
const KEPT = 2000; // poses of the path
const SIGMAS = 2.45; // radius that holds 95 % of a plane's normal distribution

function drawn(kind, parent, attributes) {
  const made = document.createElementNS(SVG, kind);
  for (const [key, value] of Object.entries(attributes || {})) made.setAttribute(key, value);
  parent.append(made);
  return made;
}

const number = (value, digits) => value === null || value === undefined ? "–" : value.toFixed(digits);
const known = (value) => value !== null && value !== undefined;

let map = null;
let track = []; // [x, y, lost]
let layers = {};
let unit = "m";
let size = 1; // of a dot, in units of the map

function drawMap() {
  const plan = $("plan");
  plan.replaceChildren();
  const xs = map.x, ys = map.y, [across, up] = map.plan ? map.plan.around : [xs, ys];
  const low = [Math.min(...across), Math.min(...up)], high = [Math.max(...across), Math.max(...up)];
  const extent = Math.max(high[0] - low[0], high[1] - low[1], 1e-6);
  const margin = 0.09 * extent;
  const box = [low[0] - margin, -high[1] - margin, high[0] - low[0] + 2 * margin, high[1] - low[1] + 2 * margin];
  plan.setAttribute("viewBox", box.map((value) => value.toFixed(4)).join(" "));
  // y points up on the plan, but down in the SVG.
  const world = drawn("g", plan, { transform: "scale(1 -1)" });
  size = Math.max(box[2], box[3]) / 150;
  if (map.plan) {
    const { x, y, heading, width, height } = map.plan, turn = `rotate(${heading * 180 / Math.PI})`;
    const place = `translate(${x} ${y}) ${turn} scale(1 -1) translate(0 ${-height})`; // its rows run downwards
    drawn("image", world, { href: "/plan.png", width, height, preserveAspectRatio: "none", transform: place });
  }
  layers = { map: drawn("g", world), way: drawn("g", world), truth: drawn("g", world), robot: drawn("g", world) };
  for (let row = 0; row < xs.length; row++) {
    const room = map.rooms[map.room[row]];
    const dot = drawn("circle", layers.map, { cx: xs[row], cy: ys[row], class: "dot " + (room ? "k" + (map.room[row] % 8) : "none-room") });
    dot.style.setProperty("--dot", 0.55 * size);
  }
  for (let age = 0; age < AGES; age++) drawn("path", layers.way, { class: "way", opacity: 0.12 + 0.88 * ((age + 1) / AGES) ** 2 });
  drawScale(plan, box, extent);
  $("rooms").replaceChildren(...map.rooms.map((room, place) => {
    if (!room) return document.createTextNode("");
    const item = document.createElement("li"), swatch = document.createElement("i");
    swatch.className = "k" + (place % 8);
    item.append(swatch, room);
    return item;
  }));
}

function drawScale(plan, box, extent) {
  const wanted = extent / 5, power = 10 ** Math.floor(Math.log10(wanted));
  const length = power * [5, 2, 1].find((step) => step * power <= wanted);
  const x = box[0] + 0.02 * box[2], y = box[1] + box[3] - 0.02 * box[2];
  const scale = drawn("g", plan, { class: "scale" });
  drawn("line", scale, { x1: x, x2: x + length, y1: y, y2: y });
  drawn("text", scale, { x: x, y: y - 0.8 * size, "font-size": 2.6 * size }).textContent = `${length} ${unit}`;
}

function drawWay() {
  if (!layers.way) return; // a map without positions has no plan
  const paths = layers.way.children, step = Math.ceil(track.length / AGES) || 1;
  for (let age = 0; age < AGES; age++) {
    // Each shade begins with the last pose of the one before, so that the path has no gaps.
    const begin = Math.max(0, track.length - (AGES - age) * step - 1), end = Math.max(0, track.length - (AGES - age - 1) * step);
    let path = "", pen = false;
    for (const [x, y, lost] of track.slice(begin, end)) {
      if (lost) { pen = false; continue; }
      path += `${pen ? "L" : "M"}${x} ${y}`;
      pen = true;
    }
    paths[age].setAttribute("d", path);
  }
}

function ellipse(state) {
  if (state.covariance) {
    const [[a, b], [, d]] = state.covariance;
    const half = (a + d) / 2, apart = Math.hypot((a - d) / 2, b);
    const angle = Math.atan2(b, (a - d) / 2) / 2;
    return [Math.sqrt(Math.max(0, half + apart)) * SIGMAS, Math.sqrt(Math.max(0, half - apart)) * SIGMAS, angle];
  }
  return known(state.error_m) ? [state.error_m, state.error_m, 0] : null;
}

function drawRobot(state) {
  layers.robot.replaceChildren();
  layers.truth.replaceChildren();
  if (state.pose) {
    $("truth").hidden = false;
    const { x, y } = state.pose, arm = 1.1 * size;
    drawn("path", layers.truth, { class: "truth", d: `M${x - arm} ${y}H${x + arm}M${x} ${y - arm}V${y + arm}` });
  }
  if (!known(state.x)) return;
  const robot = drawn("g", layers.robot, { transform: `translate(${state.x} ${state.y})` });
  const shape = ellipse(state);
  if (shape) {
    const turn = { rx: shape[0], ry: shape[1], transform: `rotate(${shape[2] * 180 / Math.PI})` };
    drawn("ellipse", robot, { ...turn, class: "halo" });
    drawn("ellipse", robot, { ...turn, class: "rim" });
  }
  if (known(state.theta)) {
    const nose = 2.6 * size, wing = 1.5 * size;
    drawn("path", robot, { class: "body", transform: `rotate(${state.theta * 180 / Math.PI})`, d: `M${nose} 0L${-wing} ${wing}L${-0.7 * wing} 0L${-wing} ${-wing}Z` });
  } else {
    drawn("circle", robot, { class: "body", r: 1.3 * size });
  }
}

function say(state, lost) {
  const words = { waiting: "waiting", running: "located", "left out": "image skipped", ended: "end of the drive", fault: "stopped" };
  const status = $("status");
  status.dataset.state = state.status === "running" && lost ? "lost" : state.status;
  status.textContent = state.status === "running" && lost ? "lost" : words[state.status];
  const banner = $("banner"), calm = state.status === "ended" || state.status === "left out" || state.status === "waiting";
  const silent = !lost && state.status === "running";
  banner.className = silent ? "silent" : calm ? "calm" : "";
  banner.textContent = silent ? "" : state.status === "ended" ? `End of the drive: ${state.text}`
    : state.status === "running" ? "Lost: this image shows nothing that is on the map, or the expected error is too large"
      : state.text;
}

function picture(id, source, missing) {
  const image = $(id), none = $(`no-${id}`);
  image.hidden = !source;
  none.hidden = Boolean(source);
  if (source) image.src = source;
  else none.textContent = missing;
}

function show(state) {
  const lost = Boolean(state.lost);
  say(state, lost);
  if (!known(state.located)) return;
  $("name").textContent = state.name;
  $("number").textContent = state.located;
  $("number-of").textContent = state.located === state.number ? "image" : "last located image";
  picture("live", `/live.jpg?${state.located}`, "");
  const best = state.candidates[0];
  picture("match", state.picture ? `/map/${best.row}.jpg` : null, "no pictures in this bundle: export it with thumbnails=true");
  $("match-name").textContent = best.image;
  $("room").textContent = state.room || "–";
  $("position").textContent = known(state.x) ? `${number(state.x, 2)}, ${number(state.y, 2)}` : "unknown";
  $("heading").textContent = known(state.theta) ? `${Math.round(state.theta * 180 / Math.PI)}°` : "–";
  $("error").textContent = lost ? "unknown" : known(state.error_m) ? `${number(state.error_m, 2)} ${unit}` : "–";
  $("off-card").hidden = !known(state.off_by);
  $("off").textContent = `${number(state.off_by, 2)} ${unit}`;
  $("agreement-card").hidden = !known(state.agreement);
  $("agreement").textContent = `${Math.round(100 * state.agreement)} %`;
  $("ms").textContent = `${number(state.ms, 1)} ms`;
  $("candidates").replaceChildren(...state.candidates.map((candidate) => {
    const row = document.createElement("tr");
    for (const [text, name] of [[candidate.image, ""], [candidate.room || "–", ""], [number(candidate.distance, 3), "n"]]) {
      const cell = document.createElement("td");
      cell.textContent = cell.title = text;
      cell.className = name;
      row.append(cell);
    }
    return row;
  }));
  drawRobot(state);
}

function listen() {
  const events = new EventSource("/events");
  events.onmessage = (message) => {
    const state = JSON.parse(message.data);
    track = (state.first ? [] : track).concat(state.track).slice(-KEPT);
    drawWay();
    show(state);
  };
  events.onerror = () => {
    if ($("status").dataset.state === "ended" && events.readyState === EventSource.CLOSED) return;
    $("status").dataset.state = "away";
    $("status").textContent = "connection lost";
  };
}

async function begin() {
  try {
    map = await (await fetch("/map.json")).json();
  } catch (error) {
    setTimeout(begin, 1000);
    return;
  }
  unit = map.unit;
  for (const place of document.querySelectorAll(".unit")) place.textContent = `(${unit})`;
  $("bundle").textContent = `${map.bundle} · ${map.frames.toLocaleString("en")} map frames`;
  document.title = `siamloc live · ${map.bundle}`;
  if (map.x.length) drawMap();
  listen();
}

begin();
