"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const root = document.documentElement;
  const calm = matchMedia("(prefers-reduced-motion: reduce)");
  const VIEW = 70; // visible width while the view follows the ego [m]
  const BEFORE = 5; // time before the violation to which a replay jumps [s]
  const TYPES = ["sedan", "suv", "jeep", "hatchback", "school-bus"]; // their colors are v0 to v4; v5 is for other types

  // The canvas needs the colors of the style sheet as values.
  const probe = document.createElement("i");
  probe.hidden = true;
  document.body.append(probe);
  const NAMES = ["ground", "road", "dash", "curb", "yellow", "ego", "edge", "hit", "accent", "ink", "paper", "v0", "v1", "v2", "v3", "v4", "v5",
    "a0", "a1", "a2", "a3", "a4", "a5", "a6", "a7", "a8", "a9"];
  let colors = {};
  const readColors = () => {
    for (const name of NAMES) {
      probe.style.color = `var(--${name})`;
      colors[name] = getComputedStyle(probe).color;
    }
  };
  readColors();

  for (const run of data.runs) { // a road along x is flat; its pictures are lower
    let [low, high] = [Infinity, -Infinity];
    for (const [, y] of run.road.lanes.flat()) [low, high] = [Math.min(low, y), Math.max(high, y)];
    run.flat = high >= low && high - low < VIEW / 2;
  }

  async function unpack(replay) {
    const bytes = Uint8Array.from(atob(replay.data), (c) => c.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    const planes = new Uint8Array(await new Response(stream).arrayBuffer());
    const n = replay.frames, half = planes.length / 2;
    const row = (index) => {
      const out = new Int16Array(n);
      for (let i = 0; i < n; i++) out[i] = planes[index * n + i] | (planes[half + index * n + i] << 8);
      return out;
    };
    const summed = (index, unit, add) => {
      const steps = row(index), out = new Float64Array(n);
      for (let i = 0, value = 0; i < n; i++) out[i] = (value = add(value, steps[i])) * unit;
      return out;
    };
    const wrapped = (value, step) => ((value + step) << 16) >> 16; // positions and speeds fit into an int16
    const turned = (value, step) => value + step; // headings are not wrapped
    const later = (value, step) => value + (step & 0xffff);
    const cars = [];
    for (let i = 0; i < replay.vehicles; i++) {
      const x = summed(2 + 3 * i, replay.unit, wrapped).map((v) => v + replay.middle[0]);
      const y = summed(3 + 3 * i, replay.unit, wrapped).map((v) => v + replay.middle[1]);
      cars.push({ x, y, heading: summed(4 + 3 * i, (2 * Math.PI) / 65536, turned) });
    }
    return { time: summed(0, 0.01, later), speed: summed(1, 0.01, wrapped), cars };
  }

  class Player {
    constructor(card) {
      this.card = card;
      this.run = data.runs[card.dataset.run - 1];
      this.box = card.querySelector(".player");
      this.canvas = this.box.querySelector("canvas");
      this.strip = this.box.querySelector(".strip");
      this.scrub = this.box.querySelector(".scrub");
      this.playButton = this.box.querySelector(".play");
      this.viewButton = this.box.querySelector(".view");
      this.largeButton = this.box.querySelector(".large");
      this.output = this.box.querySelector(".time");
      this.pick = card.querySelector(".pick");
      this.speed = this.box.querySelector(".speed");
      card.classList.toggle("flat", this.run.flat);
      this.follow = true;
      this.peers = [this]; // the players that play together
      this.playing = false;
      this.now = 0;
      this.listen();
    }

    listen() {
      this.playButton.addEventListener("click", () => this.toggle());
      this.viewButton.addEventListener("click", () => this.turnView());
      this.largeButton.addEventListener("click", () => {
        const wide = this.card.classList.toggle("wide");
        this.largeButton.setAttribute("aria-pressed", wide);
      });
      this.box.querySelector(".moment").addEventListener("click", () => this.jump());
      this.scrub.addEventListener("input", () => {
        this.seekAll(this.motion ? this.motion.time[this.scrub.value] : 0);
      });
      this.pick?.addEventListener("change", () => this.load(this.pick.value));
      this.canvas.addEventListener("click", () => this.toggle());
      this.card.addEventListener("keydown", (event) => this.key(event));
      new ResizeObserver(() => this.draw()).observe(this.canvas);
    }

    key(event) { // anywhere in the card, but for what a slider, a list or a button does with the key itself
      if (event.target.matches("input, select") || (event.key === " " && event.target.matches("button, a"))) return;
      const keys = {
        " ": () => this.toggle(),
        ArrowLeft: () => this.step(-1),
        ArrowRight: () => this.step(1),
        Home: () => this.seekAll(0),
        End: () => this.seekAll(Infinity),
        f: () => this.turnView(),
        v: () => this.jump(),
      };
      const action = keys[event.key];
      if (!action || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      action();
    }

    async load(id) {
      this.pause();
      this.replay = this.run.replays[id];
      if (this.pick) this.pick.value = id;
      this.motion = null;
      try {
        const motion = await unpack(this.replay);
        if (this.replay !== this.run.replays[id]) return; // another replay was chosen meanwhile
        this.motion = motion;
      } catch (error) {
        this.output.textContent = "This browser cannot unpack replays.";
        return;
      }
      this.canvas.setAttribute("aria-label", this.canvas.getAttribute("aria-label").replace(/execution \d+/, `execution ${id}`));
      this.scrub.max = this.replay.frames - 1;
      this.bounds = this.measured();
      this.meet();
    }

    meet() { // two drivers are shown at the same time, that of the earlier moment
      const loaded = this.peers.filter((peer) => peer.motion);
      const moment = Math.min(...loaded.map((peer) => peer.motion.time[peer.replay.moment]));
      for (const peer of loaded) peer.seek(moment);
    }

    measured() { // the area that all vehicles cover during the replay
      let [left, right, top, bottom] = [Infinity, -Infinity, Infinity, -Infinity];
      for (const car of this.motion.cars) {
        for (let i = 0; i < this.replay.frames; i += 5) {
          left = Math.min(left, car.x[i]); right = Math.max(right, car.x[i]);
          top = Math.min(top, car.y[i]); bottom = Math.max(bottom, car.y[i]);
        }
      }
      return { x: (left + right) / 2, y: (top + bottom) / 2, width: right - left + 16, height: bottom - top + 16 };
    }

    get end() { return this.motion.time[this.replay.frames - 1]; }

    frame(time) { // the last frame up to a time
      const times = this.motion.time;
      let low = 0, high = times.length - 1;
      while (low < high) {
        const middle = (low + high + 1) >> 1;
        if (times[middle] <= time + 1e-6) low = middle; else high = middle - 1;
      }
      return low;
    }

    seek(time) {
      if (!this.motion) return;
      this.now = Math.min(Math.max(time, 0), this.end);
      const i = this.frame(this.now);
      this.scrub.value = i;
      const state = this.state(), decision = this.replay.decisions.filter(([begin]) => begin <= i).at(-1)?.[1] || "";
      const text = `${this.now.toFixed(1)} s  ${this.motion.speed[i].toFixed(1)} m/s  ${decision || (state && `state ${state}`)}`;
      this.output.textContent = text;
      this.scrub.setAttribute("aria-valuetext", text);
      this.draw();
    }

    state() { // the letter of the abstract state at this time
      let end = 0;
      for (const [letter, count] of this.replay.states) {
        end += 0.1 * count;
        if (this.now < end) return letter;
      }
      return this.replay.states.length ? this.replay.states.at(-1)[0] : "";
    }

    step(count) {
      if (!this.motion) return;
      const i = Math.min(Math.max(this.frame(this.now) + count, 0), this.replay.frames - 1);
      this.seekAll(this.motion.time[i]);
    }

    jump() {
      if (!this.motion) return;
      this.meet();
      for (const peer of this.peers) peer.seek(this.now - BEFORE);
    }

    seekAll(time) {
      for (const peer of this.peers) {
        peer.pause();
        peer.seek(time);
      }
    }

    turnView() {
      this.follow = !this.follow;
      this.viewButton.setAttribute("aria-pressed", this.follow);
      this.draw();
    }

    toggle() {
      const { playing, speed } = this;
      for (const peer of this.peers) {
        peer.speed.value = speed.value;
        if (playing) peer.pause(); else peer.play();
      }
    }

    play() {
      if (!this.motion) return;
      if (this.now >= this.end - 1e-6) this.seek(0);
      this.playing = true;
      this.playButton.textContent = "\u275a\u275a";
      this.playButton.setAttribute("aria-label", "Pause");
      let before = performance.now(), shown = before;
      const go = (stamp) => {
        if (!this.playing) return;
        if (calm.matches && stamp - shown < 500) return void requestAnimationFrame(go); // single pictures instead of motion
        shown = stamp;
        const time = this.now + (Math.max(stamp - before, 0) / 1000) * Number(this.speed.value);
        before = stamp;
        this.seek(time);
        if (this.now >= this.end - 1e-6) this.pause(); else requestAnimationFrame(go);
      };
      requestAnimationFrame(go);
    }

    pause() {
      this.playing = false;
      this.playButton.textContent = "\u25b6";
      this.playButton.setAttribute("aria-label", "Play");
    }

    pose(index) { // interpolated linearly between two frames
      const { time, cars } = this.motion, car = cars[index];
      const i = this.frame(this.now), j = Math.min(i + 1, this.replay.frames - 1);
      const share = j > i ? (this.now - time[i]) / (time[j] - time[i]) : 0;
      const between = (values) => values[i] + share * (values[j] - values[i]);
      return { x: between(car.x), y: between(car.y), heading: between(car.heading) };
    }

    draw() {
      if (!this.motion || !this.canvas.clientWidth) return;
      const ratio = Math.min(devicePixelRatio || 1, 2);
      const width = this.canvas.clientWidth, height = this.canvas.clientHeight;
      this.canvas.width = Math.round(width * ratio);
      this.canvas.height = Math.round(height * ratio);
      const pen = this.canvas.getContext("2d");
      const ego = this.pose(0);
      const scale = this.follow ? width / VIEW : Math.min(width / this.bounds.width, height / this.bounds.height);
      const middle = this.follow ? ego : this.bounds;
      pen.setTransform(ratio * scale, 0, 0, ratio * scale, ratio * (width / 2 - middle.x * scale), ratio * (height / 2 - middle.y * scale));
      this.pixel = 1 / scale;
      this.drawRoad(pen);
      this.drawRoutes(pen);
      for (let i = this.motion.cars.length - 1; i >= 0; i--) this.drawCar(pen, i);
      this.drawMark(pen);
      this.drawStrip(ratio);
    }

    line(pen, points, color, width, dash = []) {
      pen.beginPath();
      points.forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
      pen.strokeStyle = color;
      pen.lineWidth = Math.max(width, this.pixel);
      pen.setLineDash(dash);
      pen.stroke();
      pen.setLineDash([]);
    }

    drawRoad(pen) {
      const road = this.run.road;
      pen.fillStyle = pen.strokeStyle = colors.road;
      pen.lineWidth = 0.1;
      for (const lane of road.lanes) {
        pen.beginPath();
        lane.forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
        pen.closePath();
        pen.fill();
        pen.stroke(); // no seams between lanes
      }
      for (const dash of road.dashes) this.line(pen, dash, colors.dash, 0.15);
      for (const { kind, ends } of road.lines) {
        if (kind !== "double-yellow") {
          this.line(pen, ends, colors.curb, 0.25);
          continue;
        }
        const [[ax, ay], [bx, by]] = ends, length = Math.hypot(bx - ax, by - ay) || 1;
        const apart = Math.max(0.14, 1.3 * this.pixel); // so that both lines are visible
        for (const side of [apart, -apart]) {
          const dx = (-(by - ay) / length) * side, dy = ((bx - ax) / length) * side;
          this.line(pen, [[ax + dx, ay + dy], [bx + dx, by + dy]], colors.yellow, 0.14);
        }
      }
    }

    drawRoutes(pen) {
      const { road } = this.run;
      pen.globalAlpha = 0.75;
      this.replay.routes.forEach((name, i) => {
        const points = Object.hasOwn(road.routes, name) ? road.routes[name] : null;
        if (points) this.line(pen, points, this.color(i + 1), 0.12, [1, 1.6]);
      });
      const route = this.replay.route || road.ego, destination = this.replay.route ? this.replay.destination : road.destination;
      this.line(pen, route, colors.accent, 0.3, [1.6, 1]);
      pen.globalAlpha = 1;
      const car = this.motion.cars[0], driven = [], last = this.frame(this.now);
      for (let i = 0; i <= last; i++) driven.push([car.x[i], car.y[i]]);
      this.line(pen, driven, colors.ego, 0.2);
      if (!destination) return;
      pen.beginPath();
      pen.arc(destination[0], destination[1], 1, 0, 2 * Math.PI);
      pen.strokeStyle = colors.accent;
      pen.lineWidth = Math.max(0.3, this.pixel);
      pen.stroke();
    }

    color(index) {
      if (!index) return colors.ego;
      const type = TYPES.indexOf(this.replay.types[index - 1]);
      return colors[`v${type < 0 ? 5 : type}`];
    }

    drawCar(pen, index) {
      const [first, last] = this.replay.spans[index], now = this.frame(this.now);
      if (now < first || now > last) return; // it has not appeared yet, or has left
      const { x, y, heading } = this.pose(index), [length, width] = this.replay.size[index];
      pen.save();
      pen.translate(x, y);
      pen.rotate(heading);
      pen.fillStyle = this.color(index);
      pen.strokeStyle = index ? colors.edge : colors.accent;
      pen.lineWidth = Math.max(index ? 0.12 : 0.25, this.pixel);
      pen.fillRect(-length / 2, -width / 2, length, width);
      pen.strokeRect(-length / 2, -width / 2, length, width);
      pen.fillStyle = index ? colors.edge : colors.accent; // the windscreen marks the front
      pen.globalAlpha = 0.75;
      pen.beginPath();
      [[0.27, -0.4], [0.27, 0.4], [0.12, 0.34], [0.12, -0.34]].forEach(([ahead, across], i) => {
        const place = [ahead * length, across * width];
        if (i) pen.lineTo(...place); else pen.moveTo(...place);
      });
      pen.fill();
      pen.restore();
    }

    drawMark(pen) {
      const { mark, moment, violated } = this.replay;
      if (!mark || this.now < this.motion.time[moment] - 1e-6) return;
      const [x, y] = mark, radius = Math.max(2.2, 9 * this.pixel);
      pen.beginPath();
      pen.arc(x, y, radius, 0, 2 * Math.PI);
      pen.strokeStyle = colors.hit;
      pen.lineWidth = Math.max(0.4, 2.5 * this.pixel);
      pen.stroke();
      pen.save();
      pen.setTransform(1, 0, 0, 1, 0, 0);
      const ratio = Math.min(devicePixelRatio || 1, 2);
      pen.font = `600 ${12 * ratio}px system-ui, sans-serif`;
      const text = violated.join(", "), size = pen.measureText(text).width;
      pen.fillStyle = colors.paper;
      pen.fillRect(6 * ratio, 6 * ratio, size + 12 * ratio, 20 * ratio);
      pen.fillStyle = colors.hit;
      pen.fillText(text, 12 * ratio, 20 * ratio);
      pen.restore();
    }

    drawStrip(ratio) { // the behavior below the picture, with the current time
      const strip = this.strip, width = (strip.width = Math.round(strip.clientWidth * ratio)), height = (strip.height = Math.round(8 * ratio));
      const pen = strip.getContext("2d"), whole = Math.max(this.end, 1e-6);
      let begin = 0;
      for (const [letter, count] of this.replay.states) {
        pen.fillStyle = colors[`a${letter.charCodeAt(0) - 65}`];
        pen.fillRect((begin * 0.1 * width) / whole, 0, (count * 0.1 * width) / whole + 1, height);
        begin += count;
      }
      pen.fillStyle = colors.paper;
      pen.fillRect((this.now / whole) * width - 2.5 * ratio, 0, 5 * ratio, height);
      pen.fillStyle = colors.ink;
      pen.fillRect((this.now / whole) * width - ratio, 0, 2 * ratio, height);
    }
  }

  const cards = [...document.querySelectorAll(".card")];
  const players = new Map();
  for (const card of cards) if (card.querySelector(".player")) players.set(card, new Player(card));
  for (const pair of document.querySelectorAll(".pair")) {
    const peers = [...players.values()].filter((player) => pair.contains(player.card));
    for (const player of peers) player.peers = peers;
  }
  const first = (player) => player.load(player.box.dataset.replays.split(" ")[0]);
  const near = new IntersectionObserver((entries) => {
    for (const entry of entries) {
      const player = players.get(entry.target);
      if (!entry.isIntersecting) player.pause();
      else if (!player.replay) first(player);
    }
  }, { rootMargin: "300px" });
  for (const card of players.keys()) near.observe(card);

  // Filters, one for each run.
  for (const field of document.querySelectorAll(".filter")) {
    const own = cards.filter((card) => card.dataset.run === field.dataset.run && !card.closest(".pair")), output = field.querySelector("output");
    const filter = () => {
      const words = field.querySelector("input").value.toLowerCase().split(/\s+/);
      for (const card of own) {
        const text = `${card.dataset.class} ${card.getAttribute("aria-label")}`.toLowerCase();
        card.hidden = !words.every((word) => text.includes(word));
      }
      output.textContent = `${own.filter((card) => !card.hidden).length} of ${own.length} cards`;
    };
    field.addEventListener("input", filter);
    field.hidden = false;
    filter();
  }

  // Deep links: #run/class/execution, as in the anchors, or #run/execution.
  function open() {
    let parts;
    try {
      parts = location.hash.slice(1).split("/").map(decodeURIComponent);
    } catch (error) {
      return;
    }
    const run = parts.shift();
    if (!parts.length) return;
    const execution = /^\d+$/.test(parts.at(-1)) ? parts.pop() : null;
    const name = parts.join("/");
    const holds = (card) => card.querySelector(".player")?.dataset.replays.split(" ").includes(execution);
    const card = cards.find((c) => c.dataset.run === run && (name ? c.dataset.class === name : holds(c)));
    if (!card) return;
    for (const other of cards) other.classList.toggle("here", other === card);
    card.hidden = false; // whatever the filter says
    card.closest("details")?.setAttribute("open", "");
    const player = players.get(card);
    if (player && execution && holds(card)) player.load(execution);
    else if (player && !player.replay) first(player);
    card.scrollIntoView({ block: "start" });
    (card.querySelector("canvas") || card).focus({ preventScroll: true });
  }
  addEventListener("hashchange", open);
  open();

  const redraw = () => {
    readColors();
    for (const player of players.values()) player.draw();
  };
  root.addEventListener("colors", redraw);
})();
