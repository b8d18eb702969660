"use strict";

const $ = (id) => document.getElementById(id);
const SVG = "http://www.w3.org/2000/svg";
const AGES = 6; // shades of the path so far
const KEPT = 2000; // poses of the path
const MARGIN = 34; // pixels around the plan
const SIGMAS = 2.45; // radius that holds 95 % of a plane's normal distribution

function drawn(kind, parent, attributes) {
  const made = document.createElementNS(SVG, kind);
  for (const [key, value] of Object.entries(attributes || {})) made.setAttribute(key, value);
  parent.append(made);
  return made;
}

const number = (value, digits) => value === null || value === undefined ? "–" : value.toFixed(digits);
const degrees = (angle) => angle * 180 / Math.PI;
const known = (value) => value !== null && value !== undefined;

let map = null;
let track = []; // [x, y, lost]
let layers = {}; // none before the plan is drawn, and in a map without positions
let unit = "m";
let scale = 1; // pixels per unit
let place = null; // from a position to pixels, which point down
let robot = null; // the last state with a location

/** Draw the plan in the size that the page gives it. */
function draw() {
  drawMap();
  drawWay();
  if (robot) drawRobot(robot);
}

function drawMap() {
  const plan = $("plan"), { width, height } = plan.getBoundingClientRect();
  plan.replaceChildren();
  plan.setAttribute("viewBox", `0 0 ${width} ${height}`);
  const [across, up] = map.plan ? map.plan.around : [map.x, map.y];
  const low = [Math.min(...across), Math.min(...up)], high = [Math.max(...across), Math.max(...up)];
  const extent = [high[0] - low[0], high[1] - low[1]].map((length) => Math.max(length, 1e-6));
  scale = Math.min((width - 2 * MARGIN) / extent[0], (height - 2 * MARGIN) / extent[1]);
  place = (x, y) => [width / 2 + (x - (low[0] + high[0]) / 2) * scale, height / 2 - (y - (low[1] + high[1]) / 2) * scale];
  if (map.plan) {
    const { x, y, heading, width, height } = map.plan;
    const transform = `translate(${place(x, y)}) rotate(${degrees(-heading)}) scale(${scale}) translate(0 ${-height})`;
    drawn("image", plan, { href: "/plan.png", width, height, preserveAspectRatio: "none", transform });
  }
  map.x.forEach((x, row) => {
    const [cx, cy] = place(x, map.y[row]), room = map.room[row];
    drawn("circle", plan, { cx, cy, r: 2.2, class: "dot " + (map.rooms[room] ? `k${room % 8}` : "none-room") });
  });
  const way = drawn("g", plan);
  for (let age = 0; age < AGES; age++) drawn("path", way, { class: "way", opacity: 0.12 + 0.88 * ((age + 1) / AGES) ** 2 });
  drawRooms(drawn("g", plan, { class: "names" }), width);
  drawScale(drawn("g", plan, { class: "scale" }), height);
  layers = { way, truth: drawn("g", plan), robot: drawn("g", plan) };
}

/** Write each room's name at the map frame nearest to the middle of the room's frames where it covers no other name. */
function drawRooms(parent, width) {
  const rows = map.rooms.map(() => []), taken = [];
  map.room.forEach((room, row) => rows[room].push(row));
  const named = rows.map((inside, room) => [map.rooms[room], inside]).filter(([name]) => name);
  for (const [name, inside] of named.sort(([, a], [, b]) => b.length - a.length)) { // those with many frames come first
    const mean = (values) => inside.reduce((sum, row) => sum + values[row], 0) / inside.length;
    const middle = [mean(map.x), mean(map.y)], off = (row) => Math.hypot(map.x[row] - middle[0], map.y[row] - middle[1]);
    const text = drawn("text", parent);
    text.textContent = name;
    const half = text.getComputedTextLength() / 2 + 3, inPlan = ([x, y]) => [Math.max(half, Math.min(x, width - half)), y];
    const places = inside.sort((a, b) => off(a) - off(b)).map((row) => inPlan(place(map.x[row], map.y[row])));
    const at = places.find(([x, y]) =>
      taken.every(([tx, ty, th]) => Math.abs(tx - x) >= th + half || Math.abs(ty - y) >= 14));
    if (!at) { text.remove(); continue; }
    taken.push([...at, half]);
    text.setAttribute("x", at[0]);
    text.setAttribute("y", at[1] - 7);
  }
}

function drawScale(parent, height) {
  const wanted = 110 / scale, power = 10 ** Math.floor(Math.log10(wanted));
  const length = power * [5, 2, 1].find((step) => step * power <= wanted * (1 + 1e-9));
  const x = 14, y = height - 14;
  drawn("path", parent, { d: `M${x} ${y - 4}V${y}H${x + length * scale}V${y - 4}` });
  drawn("text", parent, { x: x + 4, y: y - 6 }).textContent = `${Number(length.toPrecision(3))} ${unit}`;
}

function drawWay() {
  if (!layers.way) return;
  const paths = layers.way.children, step = Math.ceil(track.length / AGES) || 1;
  for (let age = 0; age < AGES; age++) {
    // Each shade begins with the last pose of the one before, so that the path has no gaps.
    const begin = Math.max(0, track.length - (AGES - age) * step - 1), end = Math.max(0, track.length - (AGES - age - 1) * step);
    let path = "", pen = false;
    for (const [x, y, lost] of track.slice(begin, end)) {
      if (lost) { pen = false; continue; }
      path += `${pen ? "L" : "M"}${place(x, y)}`;
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
  if (!layers.robot) return;
  layers.robot.replaceChildren();
  layers.truth.replaceChildren();
  if (state.pose) {
    $("truth").hidden = false;
    const transform = `translate(${place(state.pose.x, state.pose.y)})`;
    drawn("path", layers.truth, { class: "truth", transform, d: "M-5.5 0H5.5M0 -5.5V5.5" });
  }
  if (!known(state.x)) return;
  const here = drawn("g", layers.robot, { transform: `translate(${place(state.x, state.y)})` });
  const shape = ellipse(state);
  if (shape) {
    const turn = { rx: shape[0] * scale, ry: shape[1] * scale, transform: `rotate(${degrees(-shape[2])})` };
    drawn("ellipse", here, { ...turn, class: "halo" });
    drawn("ellipse", here, { ...turn, class: "rim" });
  }
  if (known(state.theta)) {
    drawn("path", here, { class: "body", transform: `rotate(${degrees(-state.theta)})`, d: "M13 0L-7.5 7.5L-5 0L-7.5 -7.5Z" });
  } else {
    drawn("circle", here, { class: "body", r: 6.5 });
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
  $("heading").textContent = known(state.theta) ? `${Math.round(degrees(state.theta))}°` : "–";
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
  robot = state;
  drawRobot(robot);
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
  $("legend").hidden = !map.x.length;
  $("no-plan").hidden = Boolean(map.x.length);
  if (map.x.length) new ResizeObserver(draw).observe($("plan"));
  listen();
}

begin();
