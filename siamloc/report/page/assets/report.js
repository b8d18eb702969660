"use strict";
(() => {
  const read = (id) => JSON.parse(document.getElementById(id).textContent);
  const sheets = read("sheets").map((set) => ({ ...set, loaded: new Map() }));
  const building = document.getElementById("occupancy") && read("occupancy");
  if (building) {
    building.picture = new Image();
    building.picture.src = `data:image/png;base64,${building.png}`;
    building.picture.decode().then(() => redraw());
  }
  const PLACEHOLDER = { "-1": "missing", "-2": "left out" };

  /** Return a promise of one sheet's image, decoded on first use. */
  function sheetImage(set, number) {
    if (!set.loaded.has(number)) {
      const image = new Image();
      image.src = `data:image/jpeg;base64,${set.images[number]}`;
      set.loaded.set(number, image.decode().then(() => image));
    }
    return set.loaded.get(number);
  }

  /** Show a small picture in a figure; a late result for an earlier query is dropped. */
  function showPicture(figure, set, number) {
    const canvas = figure.querySelector("canvas");
    const ticket = (figure.ticket = {});
    if (number < 0 || !set) {
      canvas.width = 256;
      canvas.height = 64;
      figure.dataset.state = PLACEHOLDER[number] ?? "left out";
      const context = canvas.getContext("2d");
      context.fillStyle = colour(canvas, "--soft");
      context.font = "13px system-ui, sans-serif";
      context.textAlign = "center";
      context.fillText(number === -1 ? "the file could not be read" : "left out to keep the page small", 128, 36);
      return;
    }
    figure.dataset.state = "loading";
    sheetImage(set, Math.floor(number / 64)).then((image) => {
      if (figure.ticket !== ticket) return;
      const at = number % 64;
      canvas.width = set.columns;
      canvas.height = set.rows;
      const left = (at % set.across) * set.columns, top = Math.floor(at / set.across) * set.rows;
      const context = canvas.getContext("2d");
      context.drawImage(image, left, top, set.columns, set.rows, 0, 0, set.columns, set.rows);
      figure.dataset.state = "shown";
    });
  }

  const colour = (element, name) => getComputedStyle(element).getPropertyValue(name).trim();
  const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

  /** The largest of 1, 2, 5 times a power of ten that does not exceed a value. */
  function roundStep(value) {
    const power = 10 ** Math.floor(Math.log10(value));
    return [5, 2, 1].find((k) => k * power <= value * (1 + 1e-9)) * power;
  }

  /** Distance from a point to a segment. */
  function toSegment(px, py, ax, ay, bx, by) {
    const dx = bx - ax, dy = by - ay, square = dx * dx + dy * dy;
    const t = square ? clamp(((px - ax) * dx + (py - ay) * dy) / square, 0, 1) : 0;
    return Math.hypot(px - ax - t * dx, py - ay - t * dy);
  }

  class Plan {
    constructor(article, data) {
      this.article = article;
      this.data = data;
      this.canvas = article.querySelector(".stage canvas");
      this.context = this.canvas.getContext("2d");
      this.set = sheets[data.sheets];
      this.lighting = "all";
      this.hidden = new Set();
      this.selected = -1;
      this.pinned = false;
      this.zoom = 1;
      const { query, map } = data;
      if (data.along) {
        // Along a line: estimated against true position, map frames on the diagonal where both are equal.
        const along = data.along, estimated = along === "x" ? query.ex : query.ey;
        Object.assign(this, { x: query[along], y: query[along], ex: query[along], ey: estimated });
        Object.assign(this, { mx: map[along], my: map[along] });
      } else {
        Object.assign(this, { x: query.x, y: query.y, ex: query.ex, ey: query.ey, mx: map.x, my: map.y });
      }
      this.byError = query.error.map((_, i) => i).sort((a, b) => query.error[a] - query.error[b] || a - b);
      this.classOf = query.error.map((error) => {
        const found = data.classes.findIndex((limit) => error <= limit);
        return found < 0 ? data.classes.length : found;
      });
      const all = (values) => values.reduce(([low, high], v) => [Math.min(low, v), Math.max(high, v)], [Infinity, -Infinity]);
      const [cx, cy] = (!data.along && data.around) || [[], []];
      const [x0, x1] = all([...this.x, ...this.ex, ...this.mx, ...cx]), [y0, y1] = all([...this.y, ...this.ey, ...this.my, ...cy]);
      this.middle = [(x0 + x1) / 2, (y0 + y1) / 2];
      this.extent = [Math.max(x1 - x0, 1e-9), Math.max(y1 - y0, 1e-9)];
      this.centre = [...this.middle];
      this.canvas.dataset.mapFrames = this.mx.length;
      this.listen();
      new ResizeObserver(() => this.resize()).observe(this.canvas.parentElement);
      this.resize();
      this.select(this.byError.at(-1), false);
    }

    listen() {
      const { article, canvas } = this;
      article.querySelectorAll(".classes input").forEach((box) =>
        box.addEventListener("change", () => {
          this.hidden[box.checked ? "delete" : "add"](Number(box.value));
          this.light(this.lighting);
        }));
      article.querySelectorAll("[data-zoom]").forEach((button) => button.addEventListener("click", () => {
        if (button.dataset.zoom === "reset") this.reset();
        else this.zoomBy(button.dataset.zoom === "in" ? 1.5 : 1 / 1.5, this.width / 2, this.height / 2);
      }));
      article.querySelectorAll("[data-query]").forEach((button) => button.addEventListener("click", () => {
        this.show(Number(button.dataset.query));
      }));
      canvas.addEventListener("keydown", (event) => this.key(event));
      canvas.addEventListener("wheel", (event) => {
        // The page keeps scrolling unless the plan is in focus.
        if (document.activeElement !== canvas && !event.ctrlKey) return;
        event.preventDefault();
        this.zoomBy(Math.exp(-event.deltaY / 400), event.offsetX, event.offsetY);
      }, { passive: false });
      let drag = null;
      canvas.addEventListener("pointerdown", (event) => {
        drag = { x: event.clientX, y: event.clientY, centre: [...this.centre], moved: false };
        canvas.setPointerCapture(event.pointerId);
      });
      canvas.addEventListener("pointermove", (event) => {
        if (drag) {
          const dx = event.clientX - drag.x, dy = event.clientY - drag.y;
          drag.moved ||= Math.hypot(dx, dy) > 5;
          if (drag.moved && this.zoom > 1) {
            this.centre = [drag.centre[0] - dx / this.across, drag.centre[1] + dy / this.scale];
            this.draw();
          }
        } else if (!this.pinned && event.pointerType !== "touch") {
          const found = this.hit(event.offsetX, event.offsetY);
          if (found >= 0 && found !== this.selected) this.select(found, false);
        }
      });
      canvas.addEventListener("pointerup", (event) => {
        if (drag && !drag.moved) {
          const found = this.hit(event.offsetX, event.offsetY);
          if (found >= 0) this.select(found, true);
          else this.pinned = false;
          canvas.dataset.pinned = this.pinned;
        }
        drag = null;
      });
      canvas.addEventListener("pointercancel", () => { drag = null; });
    }

    resize() {
      const width = this.canvas.parentElement.clientWidth;
      if (!width) return;
      const ratio = this.data.along ? 0.62 : this.extent[1] / this.extent[0];
      this.width = width;
      this.height = Math.round(clamp(width * ratio + 60, 260, Math.max(320, Math.min(620, innerHeight * 0.72))));
      const density = Math.max(devicePixelRatio || 1, document.documentElement.classList.contains("printing") ? 2 : 1);
      this.canvas.width = Math.round(width * density);
      this.canvas.height = Math.round(this.height * density);
      this.canvas.style.height = `${this.height}px`;
      this.context.setTransform(density, 0, 0, density, 0, 0);
      this.draw();
    }

    get fits() {
      const margin = this.data.along ? 56 : 34;
      return [(this.width - 2 * margin) / this.extent[0], (this.height - 2 * margin) / this.extent[1]];
    }

    /** Pixels per unit vertically; horizontally the same on a plan, and whatever fills the width along a line. */
    get scale() {
      return this.zoom * (this.data.along ? this.fits[1] : Math.min(...this.fits));
    }

    get across() {
      return this.data.along ? this.zoom * this.fits[0] : this.scale;
    }

    place(x, y) {
      return [
        this.width / 2 + (x - this.centre[0]) * this.across,
        this.height / 2 - (y - this.centre[1]) * this.scale,
      ];
    }

    visible(i) {
      const { lightings, query } = this.data;
      const lit = this.lighting === "all" || (lightings[query.lighting[i]] || "(unlabelled)") === this.lighting;
      return lit && !this.hidden.has(this.classOf[i]);
    }

    light(lighting) {
      this.lighting = lighting;
      if (this.selected < 0 || !this.visible(this.selected)) {
        this.select(this.byError.findLast((i) => this.visible(i)) ?? -1, false);
      }
      this.draw();
    }

    reset() {
      this.zoom = 1;
      this.centre = [...this.middle];
      this.draw();
    }

    zoomBy(factor, px, py) {
      const dx = px - this.width / 2, dy = py - this.height / 2;
      const at = [this.centre[0] + dx / this.across, this.centre[1] - dy / this.scale];
      this.zoom = clamp(this.zoom * factor, 1, 60);
      if (this.zoom === 1) this.centre = [...this.middle];
      else this.centre = [at[0] - dx / this.across, at[1] + dy / this.scale];
      this.draw();
    }

    key(event) {
      const along = this.byError.map((_, i) => i);
      const moves = {
        ArrowRight: [along, 1], ArrowLeft: [along, -1], ArrowUp: [this.byError, 1], ArrowDown: [this.byError, -1],
      };
      const middle = [this.width / 2, this.height / 2];
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      if (event.key in moves) {
        const [order, step] = moves[event.key];
        const shown = order.filter((i) => this.visible(i));
        const next = shown[clamp(shown.indexOf(this.selected) + step, 0, shown.length - 1)];
        if (next !== undefined) this.select(next, true);
      } else if (event.key === "+" || event.key === "=") this.zoomBy(1.5, ...middle);
      else if (event.key === "-") this.zoomBy(1 / 1.5, ...middle);
      else if (event.key === "0") this.reset();
      else if (event.key === "Escape") {
        this.pinned = false;
        this.canvas.dataset.pinned = false;
      } else return;
      event.preventDefault();
    }

    /** Show a query selected elsewhere on the page: all lightings, all classes, whole plan. */
    show(i) {
      this.hidden.clear();
      this.article.querySelectorAll(".classes input").forEach((box) => { box.checked = true; });
      this.lighting = "all";
      this.article.querySelectorAll(".switch input").forEach((radio) => { radio.checked = radio.value === "all"; });
      this.zoom = 1;
      this.centre = [...this.middle];
      this.select(i, true);
      const calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
      this.canvas.focus({ preventScroll: true });
      this.article.querySelector(".plan").scrollIntoView({ behavior: calm ? "auto" : "smooth" });
    }

    hit(px, py) {
      let best = -1, nearest = 12;
      for (const i of this.byError) {
        if (!this.visible(i)) continue;
        const [ax, ay] = this.place(this.x[i], this.y[i]);
        // A query's own position takes precedence over its arrow, which crosses others.
        let distance = Math.hypot(px - ax, py - ay);
        if (distance > 4) {
          const [bx, by] = this.place(this.ex[i], this.ey[i]);
          distance = Math.min(distance, 6 + toSegment(px, py, ax, ay, bx, by));
        }
        if (distance <= nearest) [best, nearest] = [i, distance];
      }
      return best;
    }

    select(i, pinned) {
      this.selected = i;
      this.pinned = pinned;
      this.canvas.dataset.pinned = pinned;
      this.draw();
      const { query, map, rooms, lightings, unit } = this.data;
      const facts = this.article.querySelector(".facts");
      this.article.querySelector(".details .triple").style.visibility = i < 0 ? "hidden" : "";
      if (i < 0) {
        facts.textContent = "no query is shown";
        return;
      }
      const match = query.match[i], near = query.nearest[i];
      const length = (value) => `${value.toFixed(2)} ${unit}`;
      const room = rooms[query.room[i]], matched = rooms[map.room[match]];
      const words = [
        ` off, floor ${length(query.floor[i])}`,
        lightings[query.lighting[i]],
        room && (room === matched ? `room ${room}` : `room ${room}, taken for ${matched}`),
        query.heading && query.heading[i] !== null && `heading ${query.heading[i].toFixed(1)}° off`,
        `query ${query.row[i]}`,
      ].filter(Boolean);
      const strong = document.createElement("b");
      strong.textContent = length(query.error[i]);
      facts.replaceChildren(strong, words.join(" · "));
      const at = (x, y) => `at (${x.toFixed(2)}, ${y.toFixed(2)}) ${unit} · `;
      const shown = {
        query: [query.picture[i], `${at(query.x[i], query.y[i])}${query.name[i]}`],
        match: [map.picture[match], `${at(map.x[match], map.y[match])}${map.name[match]}`],
        nearest: [map.picture[near], `${at(map.x[near], map.y[near])}${map.name[near]}`],
      };
      for (const [name, [picture, text]] of Object.entries(shown)) {
        const figure = this.article.querySelector(`[data-picture=${name}]`);
        figure.querySelector("span").textContent = text;
        showPicture(figure, this.set, picture);
      }
    }

    draw() {
      const { context, canvas, data } = this;
      if (!this.width) return;
      const style = getComputedStyle(canvas);
      const ink = style.getPropertyValue("--ink"), soft = style.getPropertyValue("--soft");
      const paper = style.getPropertyValue("--sheet");
      const colours = [0, 1, 2, 3, 4, 5].map((k) => style.getPropertyValue(`--c${k}`));
      const shade = (i) => colours[this.classOf[i] + colours.length - data.classes.length - 1];
      canvas.style.touchAction = this.zoom > 1 ? "none" : "auto";
      context.clearRect(0, 0, this.width, this.height);
      context.lineCap = "round";
      this.drawBuilding();
      if (data.along) this.drawDiagonal(soft);
      context.fillStyle = style.getPropertyValue("--map");
      const dot = clamp(1.6 * Math.sqrt(this.zoom), 1.6, 4);
      this.mx.forEach((x, i) => this.dot(...this.place(x, this.my[i]), 2 * dot));
      const counts = new Array(data.classes.length + 1).fill(0);
      let drawn = 0;
      for (const i of this.byError) {
        const lit = this.lighting === "all" || (data.lightings[data.query.lighting[i]] || "(unlabelled)") === this.lighting;
        if (lit) counts[this.classOf[i]] += 1;
        if (!lit || this.hidden.has(this.classOf[i])) continue;
        drawn += 1;
        const a = this.place(this.x[i], this.y[i]), b = this.place(this.ex[i], this.ey[i]);
        context.strokeStyle = context.fillStyle = shade(i);
        context.globalAlpha = 0.55;
        this.arrow(a, b, 1);
        context.globalAlpha = 1;
        this.dot(...a, dot);
      }
      this.drawRooms(ink, paper);
      if (!data.along) this.drawScale(soft);
      const s = this.selected;
      if (s >= 0 && this.visible(s)) this.drawSelected(s, ink, paper, shade(s));
      Object.assign(canvas.dataset, {
        drawn, lighting: this.lighting, zoom: this.zoom.toFixed(2), selected: s, ready: true,
        at: s >= 0 ? this.place(this.x[s], this.y[s]).map((v) => v.toFixed(1)).join(" ") : "",
      });
      this.article.querySelectorAll(".classes small").forEach((small, k) => { small.textContent = counts[k].toLocaleString("en"); });
    }

    dot(x, y, radius) {
      this.context.beginPath();
      this.context.arc(x, y, radius, 0, 2 * Math.PI);
      this.context.fill();
    }

    arrow([ax, ay], [bx, by], width) {
      const { context } = this;
      const length = Math.hypot(bx - ax, by - ay), angle = Math.atan2(by - ay, bx - ax);
      context.lineWidth = width;
      context.beginPath();
      context.moveTo(ax, ay);
      context.lineTo(bx, by);
      if (length > 10) {
        const head = 4 + width;
        for (const turn of [2.7, -2.7]) {
          context.moveTo(bx, by);
          context.lineTo(bx + head * Math.cos(angle + turn), by + head * Math.sin(angle + turn));
        }
      }
      context.stroke();
    }

    text(words, x, y, fill, halo, size = 12) {
      const { context } = this;
      context.font = `${size}px system-ui, sans-serif`;
      context.lineWidth = 3;
      context.lineJoin = "round";
      context.strokeStyle = halo;
      context.strokeText(words, x, y);
      context.fillStyle = fill;
      context.fillText(words, x, y);
    }

    drawBuilding() {
      if (!building || this.data.along) return;
      const { context } = this;
      context.save();
      context.translate(...this.place(building.x, building.y));
      context.rotate(-building.heading);
      const width = building.width * this.scale, height = building.height * this.scale;
      context.drawImage(building.picture, 0, -height, width, height);
      context.restore();
    }

    drawRooms(ink, halo) {
      if (this.data.labels.length > 40 || this.data.along) return;
      this.context.textAlign = "center";
      const taken = [];
      // Rooms with many frames come first; a name that would cover another is shown only at a higher zoom.
      for (const [room, at] of [...this.data.labels].sort((a, b) => b[2] - a[2])) {
        const [x, y] = this.place(this.mx[at], this.my[at]);
        const half = 3.6 * room.length + 3;
        if (taken.some(([tx, ty, th]) => Math.abs(tx - x) < th + half && Math.abs(ty - y) < 14)) continue;
        taken.push([x, y, half]);
        this.context.globalAlpha = 0.9;
        this.text(room, x, y - 7, ink, halo, 11.5);
        this.context.globalAlpha = 1;
      }
    }

    drawScale(soft) {
      const { context } = this;
      const step = roundStep(110 / this.scale);
      const length = step * this.scale, x = 14, y = this.height - 14;
      context.strokeStyle = soft;
      context.lineWidth = 1.5;
      context.beginPath();
      context.moveTo(x, y - 4);
      context.lineTo(x, y);
      context.lineTo(x + length, y);
      context.lineTo(x + length, y - 4);
      context.stroke();
      context.textAlign = "left";
      context.font = "12px system-ui, sans-serif";
      context.fillStyle = soft;
      context.fillText(`${Number(step.toPrecision(3))} ${this.data.unit}`, x + 4, y - 6);
    }

    drawDiagonal(soft) {
      const { context, data } = this;
      const low = this.middle[0] - this.extent[0] / 2, high = this.middle[0] + this.extent[0] / 2;
      context.strokeStyle = context.fillStyle = soft;
      context.lineWidth = 1;
      context.beginPath();
      context.moveTo(...this.place(low, low));
      context.lineTo(...this.place(high, high));
      context.stroke();
      context.font = "12px system-ui, sans-serif";
      context.textAlign = "center";
      context.fillText(`${data.truth} ${data.along} [${data.unit}]`, this.width / 2, this.height - 10);
      const ticks = (step) => {
        const first = Math.ceil(low / step);
        return Array.from({ length: Math.floor(high / step) - first + 1 }, (_, k) => Number(((first + k) * step).toPrecision(6)));
      };
      for (const value of ticks(roundStep(90 / this.across))) {
        const [x] = this.place(value, 0);
        if (x > 40 && x < this.width - 10) context.fillText(value, x, this.height - 28);
      }
      context.textAlign = "right";
      for (const value of ticks(roundStep(70 / this.scale))) {
        const [, y] = this.place(0, value);
        if (y > 10 && y < this.height - 40) context.fillText(value, 50, y + 4);
      }
      context.textAlign = "center";
      context.save();
      context.translate(16, this.height / 2);
      context.rotate(-Math.PI / 2);
      context.fillText(`estimated ${data.along} [${data.unit}]`, 0, 0);
      context.restore();
    }

    drawSelected(s, ink, halo, fill) {
      const { context, data } = this;
      const a = this.place(this.x[s], this.y[s]), b = this.place(this.ex[s], this.ey[s]);
      const frame = (i) => this.place(this.mx[i], this.my[i]);
      const n = frame(data.query.nearest[s]), m = data.finer ? frame(data.query.match[s]) : b;
      context.strokeStyle = halo;
      this.arrow(a, b, 6);
      context.strokeStyle = ink;
      this.arrow(a, b, 2.4);
      context.fillStyle = fill;
      this.dot(...a, 5.5);
      context.lineWidth = 2;
      context.strokeStyle = ink;
      context.beginPath();
      context.arc(...a, 6.5, 0, 2 * Math.PI);
      context.stroke();
      context.strokeRect(m[0] - 5, m[1] - 5, 10, 10);
      context.beginPath();
      [[0, -8], [8, 0], [0, 8], [-8, 0]].forEach(([dx, dy], k) => context[k ? "lineTo" : "moveTo"](n[0] + dx, n[1] + dy));
      context.closePath();
      context.stroke();
      context.textAlign = "left";
      const room = (x) => (x > this.width - 70 ? -1 : 1);
      const label = (words, [x, y], down) => {
        context.textAlign = room(x) > 0 ? "left" : "right";
        this.text(words, x + 11 * room(x), y + down, ink, halo);
      };
      label("query", a, -8);
      const apart = ([x, y]) => Math.hypot(a[0] - x, a[1] - y) > 26;
      if (data.finer && apart(b)) label("estimate", b, -8);
      if (apart(m)) label("match", m, 4);
      if (apart(n)) label("nearest", n, 16);
    }
  }

  const plans = [];
  for (const article of document.querySelectorAll("[data-evaluation]")) {
    if (!article.querySelector(".stage canvas")) continue;
    const plan = new Plan(article, read(`data-${article.dataset.evaluation}`));
    plans.push(plan);
    article.querySelectorAll(".switch input").forEach((radio) =>
      radio.addEventListener("change", () => plan.light(radio.value)));
  }
  const redraw = () => plans.forEach((plan) => plan.resize());
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  addEventListener("beforeprint", () => {
    document.documentElement.classList.add("printing");
    redraw();
  });
  addEventListener("afterprint", () => {
    document.documentElement.classList.remove("printing");
    redraw();
  });
})();
