"use strict";
// Draws the figures of the page and lets them be read and zoomed, sorts tables, and switches between light and dark.
(() => {
  const NARROW = 520; // px: below, axes and their numbers are smaller
  const SNAP = 28; // px within which a measured point is read instead of the curves beside it
  const DRAG = 6; // px: a shorter drag is a click
  const MANY = 400; // points from which on they shrink to dots

  // --- elements

  const svg = (name, attributes = {}, ...children) => {
    const made = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    made.append(...children);
    return made;
  };
  const html = (name, attributes = {}, ...children) => {
    const made = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    made.append(...children);
    return made;
  };

  // --- numbers and ticks

  const shown = (value, digits = 5) => {
    if (value === null || !Number.isFinite(value)) return "–";
    const size = Math.abs(value);
    const text = size !== 0 && (size < 1e-4 || size >= 1e7) ? value.toExponential(digits - 1) : String(Number(value.toPrecision(digits)));
    return text.replace(/\.?0+e/, "e").replace("-", "−").replace("e-", "e−").replace("e+", "e");
  };

  // `steps` are those that are natural, as for angles, from the smallest one on; below and else 1, 2 and 5.
  const linearTicks = (low, high, count, steps, least = 0) => {
    const raw = Math.max((high - low) / Math.max(count, 1), least);
    let step = steps.find((one) => one >= raw);
    if (!step || raw < steps[0] / 3) {
      const power = 10 ** Math.floor(Math.log10(raw));
      step = [1, 2, 5, 10].find((one) => one * power >= raw * 0.999) * power;
    }
    const ticks = [];
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k += 1) ticks.push(k * step);
    // An axis with one number has no scale.
    if (ticks.length < 2 && count < 64 && high > low && !least) return linearTicks(low, high, 2 * Math.max(count, 1), steps);
    // Seconds since 1970 or meters on a grid of the Earth would all be one number: they count from a round one near them.
    const round = 10 ** (Math.floor(Math.log10(step)) + 3);
    const base = Math.max(Math.abs(low), Math.abs(high)) < 1e4 * step ? 0 : Math.round((low + high) / 2 / round) * round;
    const texts = ticks.map((tick) => ({ at: tick, text: shown(Math.abs(tick - base) < step * 1e-6 ? 0 : tick - base, 6) }));
    return Object.assign(texts, { base });
  };

  const counted = (ticks) => (ticks.base ? `${ticks.base > 0 ? "+" : ""}${shown(ticks.base, 12)}` : "");

  const logarithmicTicks = (low, high, count) => {
    if (high - low < 0.7) {
      return linearTicks(10 ** low, 10 ** high, count, []).filter((tick) => tick.at > 0).map((tick) => ({ at: Math.log10(tick.at), text: tick.text }));
    }
    const powers = Math.floor(high + 1e-9) - Math.ceil(low - 1e-9) + 1;
    const every = powers < 2 ? 1 : Math.min(Math.ceil((high - low) / Math.max(count, 1)), powers - 1);
    const named = (high - low) * 3 <= count || powers < 2 ? [1, 2, 5] : [1];
    const ticks = [];
    for (let power = Math.floor(low); power <= high; power += 1) {
      for (let digit = 1; digit < 10; digit += 1) {
        const at = power + Math.log10(digit);
        if (at < low - 1e-9 || at > high + 1e-9) continue;
        const labeled = named.includes(digit) && (digit > 1 || power % every === 0);
        ticks.push({ at, text: labeled ? shown(digit * 10 ** power, 3) : "" });
      }
    }
    return ticks;
  };

  const named = (names) => names.map((text, k) => ({ at: k + 1, text }));

  const span = (ranges) => {
    let low = Infinity;
    let high = -Infinity;
    for (const value of ranges) {
      if (value === null || value === undefined || !Number.isFinite(value)) continue;
      if (value < low) low = value;
      if (value > high) high = value;
    }
    if (low > high) return [0, 1];
    const room = high > low ? 0.05 * (high - low) : 0.1 * Math.abs(high) || 1;
    return [low - room, high + room];
  };

  const quantity = (label) => {
    const cut = label.lastIndexOf(", ");
    return cut < 0 ? [label, ""] : [label.slice(0, cut), label.slice(cut + 2)];
  };

  const MARKERS = [
    (x, y, r) => `M${x - r},${y}a${r},${r} 0 1,0 ${2 * r},0a${r},${r} 0 1,0 ${-2 * r},0`,
    (x, y, r) => `M${x - r},${y - r}h${2 * r}v${2 * r}h${-2 * r}z`,
    (x, y, r) => `M${x},${y - 1.2 * r}l${1.2 * r},${2.1 * r}h${-2.4 * r}z`,
    (x, y, r) => `M${x},${y - 1.35 * r}l${1.35 * r},${1.35 * r}l${-1.35 * r},${1.35 * r}l${-1.35 * r},${-1.35 * r}z`,
    (x, y, r) => `M${x},${y + 1.2 * r}l${1.2 * r},${-2.1 * r}h${-2.4 * r}z`,
  ];
  const DASHES = ["", "7 4", "2 3", "9 3 2 3"];
  const CROSS = -1;
  const cross = (x, y, r) => `M${x - r},${y - r}l${2 * r},${2 * r}M${x - r},${y + r}l${2 * r},${-2 * r}`;
  const colorOf = (series) => (series.color === -1 ? "gray" : series.color === -2 ? "ink" : `c${series.color % 6}`);

  // What sets the limits and can be read: a region may be many times as large as the data.
  const isData = (series) => series.kind !== "rule" && series.kind !== "regions";

  let plots = 0;
  let inHertz = false;
  const PER_HERTZ = 2 * Math.PI; // rad/s
  const hertz = (omega) => shown(Number(omega) / PER_HERTZ, 3);

  class Plot {
    constructor(holder) {
      this.holder = holder;
      this.figure = JSON.parse(holder.dataset.figure);
      delete holder.dataset.figure;
      this.number = plots += 1;
      this.hidden = new Set();
      this.toX = this.figure.is_logarithmic ? Math.log10 : (value) => value;
      this.fromX = this.figure.is_logarithmic ? (value) => 10 ** value : (value) => value;
      this.prepare();
      this.reset();
      this.build();
    }

    prepare() {
      for (const panel of this.figure.panels) {
        panel.to = panel.is_logarithmic ? (value) => (value > 0 ? Math.log10(value) : null) : (value) => value;
        panel.from = panel.is_logarithmic ? (value) => 10 ** value : (value) => value;
        for (const series of panel.series) {
          series.at = series.x.map(this.toX);
          series.sorted = series.at.every((value, k) => k === 0 || value >= series.at[k - 1]);
          for (const column of ["y", "low", "high"]) {
            const to = series.is_across && column !== "y" ? this.toX : panel.to;
            series[`${column}At`] = series[column] && series[column].map((value) => (value === null ? null : to(value)));
          }
        }
      }
    }

    // The unit of the horizontal axis in rad/s: 1, or 2 pi for an axis in Hz.
    get unit() {
      return inHertz && this.figure.label.endsWith(", rad/s") ? PER_HERTZ : 1;
    }

    get label() {
      return this.unit === 1 ? this.figure.label : "Frequency, Hz";
    }

    get series() {
      return this.figure.panels.flatMap((panel) => panel.series);
    }

    // Points are read, not places along the axis: in a plane, and where rows have names.
    get byPoint() {
      return this.figure.is_plane || this.figure.panels.some((panel) => panel.ticks.length);
    }

    visible(panel) {
      return panel.series.filter((series) => !this.hidden.has(series.name));
    }

    reset() {
      const { limits } = this.figure;
      this.view = limits ? limits.map(this.toX) : span(this.series.filter(isData).flatMap((series) => (series.is_across ? [...series.at, ...series.lowAt, ...series.highAt] : series.at)));
      this.whole = [...this.view];
      for (const panel of this.figure.panels) panel.view = null;
      this.reading = null;
    }

    get isZoomed() {
      return this.view.some((end, k) => end !== this.whole[k]) || this.figure.panels.some((panel) => panel.view);
    }

    // --- what stands around the drawing

    build() {
      const { title } = this.figure;
      this.legend = html("div", { class: "legend" });
      const names = new Map();
      for (const series of this.series) { // a band has the name of its curve
        const known = names.get(series.name);
        if (series.name && (!known || known.kind === "band")) names.set(series.name, series);
      }
      const kinds = ["line", "points", "band", "rule"];
      const sorted = [...names].sort(([, a], [, b]) => kinds.indexOf(a.kind) - kinds.indexOf(b.kind));
      for (const [name, series] of sorted) this.legend.append(this.key(name, series));
      this.area = html("div", { class: "area", tabindex: "0", role: "group", "aria-label": `${title}: arrow keys read values, plus and minus zoom, shift and arrow keys move, 0 shows all` });
      this.readout = html("div", { class: "readout", role: "status" });
      const button = (text, label, action) => {
        const made = html("button", { type: "button", "aria-label": `${label}: ${title}`, title: label }, text);
        made.addEventListener("click", action);
        return made;
      };
      this.undo = button("Show all", "Show all", () => { this.reset(); this.draw(); });
      const tools = html("div", { class: "tools" }, button("+", "Zoom in", () => this.zoom(0.5)), button("−", "Zoom out", () => this.zoom(2)), this.undo);
      this.holder.append(html("div", { class: "above" }, this.legend, tools), this.area);
      this.listen();
      new ResizeObserver(() => this.fit()).observe(this.holder);
      this.fit();
    }

    key(name, series) {
      const sample = svg("svg", { viewBox: "0 0 26 12", class: "key", "aria-hidden": "true" });
      const shape = { line: () => svg("path", { d: "M1,6H25", class: `line ${colorOf(series)}`, "stroke-dasharray": DASHES[Math.abs(series.style) % 4] }), band: () => svg("rect", { x: 1, y: 1, width: 24, height: 10, class: `band ${colorOf(series)}` }), rule: () => svg("path", { d: "M1,6H25", class: `line ${colorOf(series)}` }), points: () => this.marks(series, [[13, 6]], 4) };
      sample.append(shape[series.kind]());
      const made = html("button", { type: "button", "aria-pressed": "true" }, sample, name);
      made.addEventListener("click", () => {
        const shows = this.hidden.delete(name) || !this.hidden.add(name);
        made.setAttribute("aria-pressed", String(shows));
        this.draw();
      });
      return made;
    }

    marks(series, places, radius) {
      const isCross = series.style === CROSS;
      const path = isCross ? cross : MARKERS[series.style % MARKERS.length];
      const d = places.map(([x, y]) => path(Number(x.toFixed(1)), Number(y.toFixed(1)), radius)).join("");
      return svg("path", { d, class: `${isCross ? "line" : "marks"} ${colorOf(series)}` });
    }

    // --- drawing

    fit() {
      const width = Math.floor(this.holder.clientWidth);
      if (width > 0 && width !== this.width) {
        this.width = width;
        this.draw();
      }
    }

    draw() {
      if (!this.width) return;
      const { figure, width } = this;
      const narrow = width < NARROW;
      const longest = (names) => Math.max(0, ...names.map((name) => name.length));
      const names = longest(figure.panels.flatMap((panel) => panel.ticks));
      const left = names ? Math.min(0.45 * width, 14 + 6.6 * names) : narrow ? 50 : 66;
      const right = 10;
      const bottom = figure.ticks.length ? 24 + 6.6 * Math.min(longest(figure.ticks), 30) : 40;
      const usual = narrow ? 150 : 190;
      this.left = left;
      this.right = width - right;
      let top = 8;
      for (const panel of figure.panels) {
        panel.top = top;
        panel.bottom = top + (figure.is_plane ? Math.min(width - left - right, 470) : usual * panel.height);
        top = panel.bottom + 16;
      }
      const height = top - 16 + bottom;
      const root = svg("svg", { viewBox: `0 0 ${width} ${height}`, class: narrow ? "narrow" : "", role: "img", "aria-label": figure.title });
      this.places(figure);
      const ticks = this.horizontalTicks(narrow);
      for (const [k, panel] of figure.panels.entries()) root.append(this.panelOf(panel, k, ticks, narrow));
      const label = svg("text", { x: (left + this.right) / 2, y: height - 6, class: "label", "text-anchor": "middle" }, [this.label, counted(ticks)].filter(Boolean).join(" "));
      this.overlay = svg("g", { class: "overlay" });
      root.append(label, this.overlay);
      this.area.replaceChildren(root, this.readout);
      this.undo.hidden = !this.isZoomed;
      this.mark();
    }

    places(figure) {
      for (const panel of figure.panels) panel.shown = panel.view || this.natural(panel);
      this.seen = [...this.view];
      if (figure.is_plane) { // one scale for both axes
        const [panel] = figure.panels;
        const perX = (this.seen[1] - this.seen[0]) / (this.right - this.left);
        const perY = (panel.shown[1] - panel.shown[0]) / (panel.bottom - panel.top);
        const per = Math.max(perX, perY);
        const widen = ([low, high], size) => [(low + high - per * size) / 2, (low + high + per * size) / 2];
        this.seen = widen(this.seen, this.right - this.left);
        panel.shown = widen(panel.shown, panel.bottom - panel.top);
      }
    }

    natural(panel) {
      if (panel.limits) return panel.limits.map(panel.to);
      const [low, high] = this.view;
      const values = [];
      for (const series of this.visible(panel)) {
        series.at.forEach((x, k) => {
          if (series.kind === "regions" || (series.kind !== "rule" && (x < low || x > high))) return;
          // Circles of poor points may be many times as large as the curve.
          for (const column of this.figure.is_plane ? ["yAt"] : ["yAt", "lowAt", "highAt"]) if (series[column]) values.push(series[column][k]);
        });
      }
      return span(values);
    }

    px(x) {
      return this.left + ((x - this.seen[0]) / (this.seen[1] - this.seen[0])) * (this.right - this.left);
    }

    py(panel, y) {
      return panel.bottom - ((y - panel.shown[0]) / (panel.shown[1] - panel.shown[0])) * (panel.bottom - panel.top);
    }

    horizontalTicks(narrow) {
      if (this.figure.ticks.length) return named(this.figure.ticks);
      const count = (this.right - this.left) / (narrow ? 48 : 64);
      const { unit, seen } = this;
      if (this.figure.is_logarithmic) {
        const shift = Math.log10(unit);
        return logarithmicTicks(seen[0] - shift, seen[1] - shift, count).map((tick) => ({ ...tick, at: tick.at + shift }));
      }
      const ticks = linearTicks(seen[0] / unit, seen[1] / unit, count, [], this.figure.is_whole ? 1 : 0);
      return Object.assign(ticks.map((tick) => ({ ...tick, at: tick.at * unit })), { base: ticks.base });
    }

    panelOf(panel, k, ticks, narrow) {
      const { left, right } = this;
      const clip = `clip-${this.number}-${k}`;
      const group = svg("g", { class: "panel" });
      const width = right - left;
      const height = panel.bottom - panel.top;
      group.append(svg("clipPath", { id: clip }, svg("rect", { x: left, y: panel.top, width, height })));
      const isLast = k === this.figure.panels.length - 1;
      let grid = "";
      let free = -Infinity; // to the right of the last number
      for (const tick of ticks) {
        const x = this.px(tick.at);
        grid += `M${x.toFixed(1)},${panel.top}v${height}`;
        const half = 3.6 * tick.text.length;
        if (isLast && this.figure.ticks.length) {
          const at = `${x + 4} ${panel.bottom + 8}`;
          group.append(svg("text", { x: x + 4, y: panel.bottom + 8, "text-anchor": "end", transform: `rotate(-90 ${at})` }, tick.text.slice(0, 30)));
        } else if (isLast && tick.text && x - half > free && x + half < right + 12) {
          free = x + half + 4;
          group.append(svg("text", { x, y: panel.bottom + 15, "text-anchor": "middle" }, tick.text));
        }
      }
      const count = height / (narrow ? 30 : 34);
      const rows = panel.ticks.length ? named(panel.ticks) : panel.is_logarithmic ? logarithmicTicks(...panel.shown, count) : linearTicks(...panel.shown, count, panel.steps);
      for (const tick of rows) {
        const y = this.py(panel, tick.at);
        grid += `M${left},${y.toFixed(1)}h${width}`;
        if (tick.text) group.append(svg("text", { x: left - 6, y: y + 3.5, "text-anchor": "end" }, tick.text.length * 6.6 > left ? `${tick.text.slice(0, Math.floor(left / 6.6) - 3)}…` : tick.text));
      }
      if (rows.base) group.append(svg("text", { x: left + 4, y: panel.top + 9, class: "base" }, counted(rows)));
      group.prepend(svg("path", { d: grid, class: "grid" }));
      const inside = svg("g", { "clip-path": `url(#${clip})` });
      for (const series of this.visible(panel)) this.append(inside, panel, series);
      const [x, y] = [narrow ? 9 : 13, (panel.top + panel.bottom) / 2];
      const label = svg("text", { x, y, class: "label", "text-anchor": "middle", transform: `rotate(-90 ${x} ${y})` }, panel.label);
      const most = height + 24;
      if (panel.label.length * 6.4 > most) { label.setAttribute("textLength", most); label.setAttribute("lengthAdjust", "spacingAndGlyphs"); }
      group.append(inside, svg("path", { d: `M${left},${panel.top}V${panel.bottom}H${right}`, class: "frame" }), label);
      return group;
    }

    append(inside, panel, series) {
      const color = colorOf(series);
      if (series.kind === "rule") {
        inside.append(svg("path", { d: `M${this.left},${this.py(panel, series.yAt[0]).toFixed(1)}H${this.right}`, class: `rule ${color}` }));
        return;
      }
      const [from, to] = this.rows(series);
      if (series.kind === "regions") {
        const d = this.path(panel, series.at, series.yAt, 0, series.at.length).replace(/(.)M/g, "$1zM");
        inside.append(svg("path", { d: `${d}z`, class: series.is_hollow ? `bars ${color}` : `band ${color}` }));
      } else if (series.kind === "band") {
        inside.append(svg("path", { d: this.band(panel, series, from, to), class: `band ${color}` }));
      } else if (series.kind === "line") {
        inside.append(svg("path", { d: this.path(panel, series.at, series.yAt, from, to), class: `line ${color}${series.is_hollow ? " thin" : ""}`, "stroke-dasharray": DASHES[series.style % 4] }));
      } else {
        if (series.lowAt) inside.append(svg("path", { d: this.bars(panel, series, from, to), class: `bars ${color}` }));
        const places = [];
        for (let k = from; k < to; k += 1) if (series.yAt[k] !== null) places.push([this.px(series.at[k]), this.py(panel, series.yAt[k])]);
        inside.append(this.marks(series, places, places.length > MANY ? 1.6 : places.length > 100 ? 2.4 : 3.6));
        const labels = inHertz ? series.labels.map(hertz) : series.labels;
        if (labels.length === places.length) this.write(inside, labels, places);
      }
    }

    // Labels beside points, away from the middle of all, where they cover neither points nor labels.
    write(inside, labels, places) {
      const middle = [0, 1].map((k) => (Math.min(...places.map((place) => place[k])) + Math.max(...places.map((place) => place[k]))) / 2);
      const taken = [...places];
      places.forEach(([x, y], k) => {
        const half = 3.2 * labels[k].length;
        const side = x - 2 * half - 8 > this.left && (x < middle[0] || x + 2 * half + 8 > this.right) ? -1 : 1;
        const spot = [x + side * (8 + half), y + (y < middle[1] ? -6 : 6)];
        const room = 9 + half;
        if (taken.some(([a, b], other) => other !== k && Math.abs(a - spot[0]) < room + (other < places.length ? 2 : 10) && Math.abs(b - spot[1]) < 10)) return;
        taken.push(spot);
        inside.append(svg("text", { x: spot[0], y: spot[1] + 4, class: "beside", "text-anchor": "middle" }, labels[k]));
      });
    }

    // The rows in sight, and one to either side.
    rows(series) {
      const count = series.at.length;
      if (!series.sorted || this.byPoint) return [0, count];
      return [Math.max(0, below(series.at, this.seen[0]) - 1), Math.min(count, below(series.at, this.seen[1]) + 2)];
    }

    path(panel, xs, ys, from, to) {
      let d = "";
      let pen = "M";
      for (let k = from; k < to; k += 1) {
        if (ys[k] === null || xs[k] === null) { pen = "M"; continue; }
        const x = Math.max(-9e4, Math.min(9e4, this.px(xs[k])));
        const y = Math.max(-9e4, Math.min(9e4, this.py(panel, ys[k])));
        d += `${pen}${x.toFixed(1)},${y.toFixed(1)}`;
        pen = "L";
      }
      return d;
    }

    band(panel, series, from, to) {
      let d = "";
      let piece = [];
      const close = () => {
        if (piece.length) {
          const rim = (column, rows) => this.path(panel, rows.map((k) => series.at[k]), rows.map((k) => series[column][k]), 0, rows.length);
          d += `${rim("lowAt", piece)}${rim("highAt", [...piece].reverse()).replace("M", "L")}z`;
        }
        piece = [];
      };
      for (let k = from; k < to; k += 1) {
        if (series.lowAt[k] === null || series.highAt[k] === null) close();
        else piece.push(k);
      }
      close();
      return d;
    }

    bars(panel, series, from, to) {
      let d = "";
      for (let k = from; k < to; k += 1) {
        if (series.lowAt[k] === null || series.highAt[k] === null) continue;
        if (this.figure.is_plane) {
          const radius = (this.py(panel, series.lowAt[k]) - this.py(panel, series.highAt[k])) / 2;
          d += MARKERS[0](Number(this.px(series.at[k]).toFixed(1)), Number(this.py(panel, series.yAt[k]).toFixed(1)), Number(radius.toFixed(1)));
          continue;
        }
        if (series.is_across) {
          d += `M${this.px(series.lowAt[k]).toFixed(1)},${this.py(panel, series.yAt[k]).toFixed(1)}H${this.px(series.highAt[k]).toFixed(1)}`;
          continue;
        }
        d += `M${this.px(series.at[k]).toFixed(1)},${this.py(panel, series.lowAt[k]).toFixed(1)}V${this.py(panel, series.highAt[k]).toFixed(1)}`;
      }
      return d;
    }

    // --- reading

    // The points that can be read one after the other: the measured ones where there are any.
    stops() {
      const all = this.figure.panels.flatMap((panel) => this.visible(panel).filter(isData).map((series) => ({ panel, series })));
      const points = all.filter(({ series }) => series.kind === "points");
      const stops = [];
      for (const { panel, series } of points.length ? points : all.slice(0, 1)) {
        series.at.forEach((x, k) => {
          if (x >= this.seen[0] && x <= this.seen[1] && series.yAt[k] !== null) stops.push({ panel, series, k, x });
        });
      }
      return this.byPoint ? stops : stops.sort((a, b) => a.x - b.x).filter((stop, k, list) => k === 0 || stop.x !== list[k - 1].x);
    }

    read(x, y) {
      const stops = this.stops();
      let best = null;
      let distance = Infinity;
      for (const stop of stops) {
        const aside = Math.abs(this.px(stop.x) - x);
        const away = this.byPoint ? Math.hypot(aside, this.py(stop.panel, stop.series.yAt[stop.k]) - y) : aside;
        if (away < distance) [best, distance] = [stop, away];
      }
      if (this.byPoint) this.reading = distance < 2 * SNAP ? best : null;
      else if (best && distance < SNAP) this.reading = best;
      else this.reading = { x: this.seen[0] + ((x - this.left) / (this.right - this.left)) * (this.seen[1] - this.seen[0]) };
      this.mark();
    }

    step(by) {
      const stops = this.stops();
      if (!stops.length) return;
      let k = this.reading ? stops.findIndex((stop) => (this.byPoint ? stop.series === this.reading.series && stop.k === this.reading.k : stop.x >= this.reading.x - 1e-12)) : by > 0 ? -1 : stops.length;
      if (k < 0 && this.reading) k = stops.length;
      this.reading = stops[Math.max(0, Math.min(stops.length - 1, k + by))];
      this.mark();
    }

    // What every series is at x: a measured point there, or the curve between its points.
    values(x) {
      const found = [];
      for (const panel of this.figure.panels) {
        for (const series of this.visible(panel)) {
          if (!isData(series)) continue;
          const k = near(series, x);
          if (series.kind === "points") {
            if (k !== null && Math.abs(this.px(series.at[k]) - this.px(x)) < 0.5 && series.yAt[k] !== null) found.push({ panel, series, k, y: series.yAt[k] });
          } else if (series.kind === "line" && series.sorted) {
            const y = between(series.at, series.yAt, x);
            if (y !== null) found.push({ panel, series, y });
          } else if (series.kind === "band" && series.sorted) {
            const [low, high] = [between(series.at, series.lowAt, x), between(series.at, series.highAt, x)];
            if (low !== null && high !== null) found.push({ panel, series, low, high });
          }
        }
      }
      const order = { points: 0, line: 1, band: 2 }; // what was measured is said first
      const place = (one) => 3 * this.figure.panels.indexOf(one.panel) + order[one.series.kind];
      return found.sort((a, b) => place(a) - place(b));
    }

    mark() {
      const { reading, figure } = this;
      this.overlay.replaceChildren();
      this.readout.replaceChildren();
      if (!reading) return;
      const found = this.byPoint ? [{ panel: reading.panel, series: reading.series, k: reading.k, y: reading.series.yAt[reading.k] }] : this.values(reading.x);
      if (!this.byPoint) this.overlay.append(svg("path", { d: `M${this.px(reading.x).toFixed(1)},${figure.panels[0].top}V${figure.panels.at(-1).bottom}`, class: "cursor" }));
      for (const { panel, y } of found) {
        if (y === undefined) continue;
        const [cx, cy] = [this.px(reading.x), this.py(panel, y)];
        if (cy >= panel.top && cy <= panel.bottom) this.overlay.append(svg("circle", { cx, cy, r: 5, class: "cursor" }));
      }
      const [name, unit] = quantity(this.label);
      if (!this.byPoint) this.readout.append(html("b", {}, `${name} = ${shown(this.fromX(reading.x) / this.unit)} ${unit}`.trim()));
      let last = null;
      for (const one of found) {
        if (one.panel !== last && figure.panels.length > 1) this.readout.append(html("i", {}, quantity(one.panel.label)[0]));
        last = one.panel;
        this.readout.append(html("span", {}, this.said(one)));
      }
      this.place();
    }

    said({ panel, series, k, y, low, high }) {
      const name = series.name ? `${series.name}: ` : "";
      if (k !== undefined && series.notes.length) return name + (inHertz ? series.notes[k].replace(/([\d.e+-]+) rad\/s$/, (_, omega) => `${hertz(omega)} Hz`) : series.notes[k]);
      const unit = quantity(panel.label)[1];
      if (low !== undefined) return `${name}${shown(panel.from(low), 4)} to ${shown(panel.from(high), 4)} ${unit}`;
      const bars = k !== undefined && series.low && series.low[k] !== null && series.high[k] !== null ? ` (${shown(series.low[k], 4)} to ${shown(series.high[k], 4)})` : "";
      return `${name}${shown(panel.from(y))}${bars} ${unit}`;
    }

    // Beside the line that is read, on the side with more room.
    place() {
      const scale = this.area.clientWidth / this.width;
      const x = this.px(this.reading.x) * scale;
      const toLeft = x > this.area.clientWidth / 2;
      this.readout.style.left = toLeft ? "auto" : `${x + 12}px`;
      this.readout.style.right = toLeft ? `${this.area.clientWidth - x + 12}px` : "auto";
    }

    // --- zooming

    zoom(factor, x) {
      const around = x ?? (this.reading ? this.reading.x : (this.seen[0] + this.seen[1]) / 2);
      const shrink = ([low, high], center) => [center + (low - center) * factor, center + (high - center) * factor];
      const before = this.seen;
      this.view = shrink(before, around);
      if (this.figure.is_plane) {
        const [panel] = this.figure.panels;
        const center = this.reading ? this.reading.series.yAt[this.reading.k] : (panel.shown[0] + panel.shown[1]) / 2;
        panel.view = shrink(panel.shown, center);
      }
      if (factor > 1 && this.view[0] <= this.whole[0] && this.view[1] >= this.whole[1]) {
        const { reading } = this;
        this.reset();
        this.reading = reading;
      }
      this.draw();
    }

    move(share) {
      const by = share * (this.view[1] - this.view[0]);
      this.view = this.view.map((end) => end + by);
      this.draw();
    }

    drag(start, end) {
      const panel = this.figure.panels.find((one) => start.y >= one.top - 8 && start.y <= one.bottom + 8);
      const fromPx = (x) => this.seen[0] + ((x - this.left) / (this.right - this.left)) * (this.seen[1] - this.seen[0]);
      const ends = (a, b) => [Math.min(a, b), Math.max(a, b)];
      const wide = Math.abs(end.x - start.x) > DRAG;
      const tall = Math.abs(end.y - start.y) > DRAG;
      if (tall && panel && (this.figure.is_plane || Math.abs(end.y - start.y) > 24)) {
        const fromPy = (y) => panel.shown[0] + ((panel.bottom - y) / (panel.bottom - panel.top)) * (panel.shown[1] - panel.shown[0]);
        panel.view = ends(fromPy(start.y), fromPy(end.y));
      }
      if (wide) this.view = ends(fromPx(Math.max(this.left, Math.min(this.right, start.x))), fromPx(Math.max(this.left, Math.min(this.right, end.x))));
      this.reading = null;
      this.draw();
    }

    // --- events

    listen() {
      const { area } = this;
      const placeOf = (event) => {
        const box = area.firstChild.getBoundingClientRect();
        const scale = this.width / box.width;
        return { x: (event.clientX - box.left) * scale, y: (event.clientY - box.top) * scale };
      };
      let start = null;
      area.addEventListener("pointerdown", (event) => {
        const place = placeOf(event);
        if (event.pointerType === "touch") this.read(place.x, place.y);
        else if (event.button === 0) { start = place; area.setPointerCapture(event.pointerId); }
      });
      area.addEventListener("pointermove", (event) => {
        if (event.pointerType === "touch") return;
        const place = placeOf(event);
        if (!start) { this.read(place.x, place.y); return; }
        const panel = this.figure.panels.find((one) => start.y >= one.top - 8 && start.y <= one.bottom + 8);
        const tall = panel && (this.figure.is_plane || Math.abs(place.y - start.y) > 24);
        const [top, bottom] = tall ? [Math.min(start.y, place.y), Math.max(start.y, place.y)] : [this.figure.panels[0].top, this.figure.panels.at(-1).bottom];
        const box = { x: Math.min(start.x, place.x), y: top, width: Math.abs(place.x - start.x), height: bottom - top, class: "drag" };
        this.readout.replaceChildren();
        this.overlay.replaceChildren(svg("rect", box));
      });
      area.addEventListener("pointerup", (event) => {
        if (!start) return;
        const place = placeOf(event);
        const from = start;
        start = null;
        if (Math.hypot(place.x - from.x, place.y - from.y) > DRAG) this.drag(from, place);
      });
      area.addEventListener("pointercancel", () => { start = null; this.draw(); });
      const leave = () => { this.reading = null; this.mark(); };
      area.addEventListener("pointerleave", (event) => { if (!start && event.pointerType !== "touch" && document.activeElement !== area) leave(); });
      area.addEventListener("blur", leave);
      area.addEventListener("dblclick", () => { this.reset(); this.draw(); });
      area.addEventListener("wheel", (event) => {
        if (!event.ctrlKey) return; // the page is scrolled
        event.preventDefault();
        const { x } = placeOf(event);
        this.zoom(event.deltaY > 0 ? 1.25 : 0.8, this.seen[0] + ((x - this.left) / (this.right - this.left)) * (this.seen[1] - this.seen[0]));
      }, { passive: false });
      area.addEventListener("keydown", (event) => this.press(event));
    }

    press(event) {
      if (event.ctrlKey || event.altKey || event.metaKey) return;
      const toward = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
      const actions = {
        "+": () => this.zoom(0.5), "=": () => this.zoom(0.5), "-": () => this.zoom(2),
        0: () => { this.reset(); this.draw(); }, Escape: () => { this.reset(); this.draw(); },
        Home: () => this.step(-1e9), End: () => this.step(1e9),
      };
      if (toward && event.shiftKey) this.move(0.2 * toward);
      else if (toward) this.step(toward);
      else if (actions[event.key]) actions[event.key]();
      else return;
      event.preventDefault();
    }
  }

  // How many of the sorted values lie below one.
  function below(sorted, value) {
    let [low, high] = [0, sorted.length];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (sorted[middle] < value) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  function near(series, x) {
    const { at } = series;
    if (!at.length) return null;
    if (!series.sorted) return at.reduce((best, value, k) => (Math.abs(value - x) < Math.abs(at[best] - x) ? k : best), 0);
    const k = below(at, x);
    if (k === 0) return 0;
    return k < at.length && at[k] - x < x - at[k - 1] ? k : k - 1;
  }

  function between(at, values, x) {
    const k = below(at, x);
    if (k < at.length && at[k] === x) return values[k];
    if (k === 0 || k === at.length || values[k - 1] === null || values[k] === null) return null;
    return values[k - 1] + ((x - at[k - 1]) / (at[k] - at[k - 1])) * (values[k] - values[k - 1]);
  }

  // --- tables

  // Rows that contain all words of the text, of tables that are too long to look through.
  function filterable(table) {
    const rows = [...table.tBodies[0].rows];
    if (rows.length < 10) return;
    const input = html("input", { type: "search", class: "filter", placeholder: "Filter rows", "aria-label": "Filter rows" });
    input.addEventListener("input", () => {
      const words = input.value.toLowerCase().split(/\s+/);
      for (const row of rows) row.hidden = !words.every((word) => row.textContent.toLowerCase().includes(word));
    });
    table.parentElement.before(input);
  }

  function sortable(table) {
    const [body] = table.tBodies;
    [...table.tHead.rows[0].cells].forEach((cell, column) => {
      if (!cell.textContent.trim()) return;
      const button = html("button", { type: "button" }, ...cell.childNodes);
      cell.replaceChildren(button);
      button.addEventListener("click", () => {
        const sign = cell.getAttribute("aria-sort") === "ascending" ? -1 : 1;
        const rows = [...body.rows].sort((a, b) => sign * compared(a.cells[column], b.cells[column]));
        for (const other of table.tHead.rows[0].cells) other.removeAttribute("aria-sort");
        cell.setAttribute("aria-sort", sign > 0 ? "ascending" : "descending");
        body.append(...rows);
      });
    });
  }

  // Numbers by size, then what is no number by its text; what is not known comes last.
  function compared(a, b) {
    const [x, y] = [a, b].map((cell) => (cell.dataset.value === undefined ? NaN : Number(cell.dataset.value)));
    if (Number.isNaN(x) !== Number.isNaN(y)) return Number.isNaN(x) ? 1 : -1;
    return Number.isNaN(x) ? a.textContent.localeCompare(b.textContent) : x - y;
  }

  // --- light and dark

  function themes(button) {
    const names = ["auto", "light", "dark"];
    button.hidden = false;
    button.addEventListener("click", () => {
      const root = document.documentElement;
      const next = names[(names.indexOf(root.dataset.theme || "auto") + 1) % names.length];
      root.dataset.theme = next;
      button.textContent = `Colors: ${next}`;
    });
  }

  // --- rad/s and Hz

  function units(before, plots) {
    if (!plots.some((plot) => plot.figure.label.endsWith(", rad/s"))) return;
    const button = html("button", { type: "button", id: "unit" }, "Frequency: rad/s");
    button.addEventListener("click", () => {
      inHertz = !inHertz;
      button.textContent = `Frequency: ${inHertz ? "Hz" : "rad/s"}`;
      for (const plot of plots) plot.draw();
    });
    before.before(button);
  }

  const drawn = [...document.querySelectorAll(".plot")].map((holder) => new Plot(holder));
  document.querySelectorAll("table.sortable").forEach(sortable);
  document.querySelectorAll("table.sortable").forEach(filterable);
  themes(document.getElementById("theme"));
  units(document.getElementById("theme"), drawn);

  let closed = [];
  window.addEventListener("beforeprint", () => {
    // Of more than a few results only what a reader has opened: a study would take a hundred pages.
    const few = document.querySelectorAll("main > section > details").length <= 3;
    closed = few ? [...document.querySelectorAll("details:not([open])")] : [];
    for (const details of closed) details.open = true;
    // Columns of A4 between margins of 15 mm: a figure that was drawn for a screen has small numbers.
    for (const plot of drawn) {
      plot.width = plot.holder.closest("figure").classList.contains("wide") ? 680 : 330;
      plot.draw();
    }
  });
  window.addEventListener("afterprint", () => {
    for (const details of closed) details.open = false;
    for (const plot of drawn) plot.fit();
  });
})();
