// Plots and 3D view of the HTML report. The element "data" holds their data as JSON, see page.py.
"use strict";
const DATA = JSON.parse(document.getElementById("data").textContent);
const touch = matchMedia("(pointer: coarse)").matches;
const narrow = () => matchMedia("(max-width: 40rem)").matches;
const drawn = new Map();                // element -> function that draws it in the current theme
const views = [];                       // state of each 3D view

// Replace names of CSS variables by their values in all entries whose key contains "color".
function themed(value, key = "") {
  if (typeof value === "string")
    return /color/i.test(key) && value.startsWith("--")
      ? getComputedStyle(document.documentElement).getPropertyValue(value).trim() : value;
  if (Array.isArray(value)) return /color/i.test(key) ? value.map(v => themed(v, key))
    : value.map(v => typeof v === "object" ? themed(v) : v);
  if (value && typeof value === "object" && !ArrayBuffer.isView(value))
    return Object.fromEntries(Object.entries(value).map(([k, v]) => [k, themed(v, k)]));
  return value;
}

const CONFIG = {responsive: true, displaylogo: false, displayModeBar: touch ? true : "hover"};
const MODEBAR = {bgcolor: "rgba(0,0,0,0)", color: "--soft", activecolor: "--text"};

// On touch screens, dragging on a plot scrolls the page until a tool above the plot is selected.
function drawPlane(element, plot, go) {
  const layout = {...plot.layout, modebar: MODEBAR, uirevision: 1};
  if (touch) layout.dragmode = false;
  const fresh = !drawn.has(element);
  const draw = () => Plotly.react(element, themed(plot.data), themed(layout), {
    ...CONFIG, modeBarButtons: [["zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d"]]});
  drawn.set(element, draw);
  draw();
  if (fresh && go) {
    const line = element.appendChild(document.createElement("div"));
    line.className = "cursor";
    element.on("plotly_click", found => go(found.points[0].x));
    element.on("plotly_afterplot", () => element.cursor());
    element.cursor = (time = element.time) => {
      element.time = time;
      const {xaxis, yaxis} = element._fullLayout, x = xaxis.d2p(time);
      line.style.display = x >= 0 && x <= xaxis._length ? "block" : "none";
      line.style.left = `${xaxis._offset + x}px`;
      line.style.top = `${yaxis._offset}px`;
      line.style.height = `${yaxis._length}px`;
    };
  }
}

// Buttons that show or hide curves by name in all plots of a group.
function drawPicker(root, planes, plots) {
  const mine = planes.filter((_, k) => plots[k].pick === root.dataset.pick);
  const shown = new Map();                // name -> first trace
  plots.filter(plot => plot.pick === root.dataset.pick).forEach(plot => plot.data.forEach(trace => {
    if ("visible" in trace && !shown.has(trace.name)) shown.set(trace.name, trace);
  }));
  const set = (names, on) => {
    for (const plane of mine) {
      const found = [...plane.data.keys()].filter(k => names.includes(plane.data[k].name));
      // `drawn` draws the data of the page again when the theme changes.
      found.forEach(k => { plots[planes.indexOf(plane)].data[k].visible = on; });
      if (found.length) Plotly.restyle(plane, {visible: on}, found);
    }
    for (const button of buttons) if (names.includes(button.dataset.name)) button.ariaPressed = on;
  };
  const chip = text => {
    const button = root.querySelector(".chips").appendChild(document.createElement("button"));
    button.type = "button";
    button.append(text);
    return button;
  };
  const buttons = [...shown].map(([name, trace]) => {
    const button = chip(""), line = button.appendChild(document.createElement("i"));
    const text = document.createElement("textarea");
    text.innerHTML = name;                // names have escaped markup
    button.append(text.value);
    button.dataset.name = name;
    button.ariaPressed = trace.visible;
    line.style.borderTopColor = `var(${trace.line.color})`;
    line.style.borderTopStyle = {dash: "dashed", dot: "dotted"}[trace.line.dash] || "solid";
    button.addEventListener("click", () => set([name], button.ariaPressed !== "true"));
    return button;
  });
  if (buttons.length > 1) {
    chip("all").addEventListener("click", () => set([...shown.keys()], true));
    chip("none").addEventListener("click", () => set([...shown.keys()], false));
  }
}

// Solids of size 1 about their centre: [vertices, triangles]. A capsule's share of caps follows from its edges.
function makeSolid(kind, [across, , long]) {
  const points = [], faces = [];
  if (kind === "box") {
    for (let k = 0; k < 8; k++) points.push([(k & 1) - .5, (k >> 1 & 1) - .5, (k >> 2) - .5]);
    for (const [a, b, c, d] of [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3],
                                [0, 4, 6, 2], [1, 3, 7, 5]])
      faces.push([a, b, c], [a, c, d]);
    return [points, faces];
  }
  const around = 24, isRound = kind !== "cylinder", rings = isRound ? 12 : 2;
  const caps = kind === "capsule" ? across / long : 1;
  for (let r = 0; r < rings; r++)
    for (let k = 0; k < around; k++) {
      const turn = 2 * Math.PI * k / around, rise = Math.PI * (r + 1) / (rings + 1);
      const out = isRound ? Math.sin(rise) : 1, side = r < rings / 2 ? -.5 : .5;
      points.push([.5 * out * Math.cos(turn), .5 * out * Math.sin(turn),
                   isRound ? side * (1 - caps) - .5 * caps * Math.cos(rise) : side]);
    }
  points.push([0, 0, -.5], [0, 0, .5]);
  const bottom = points.length - 2, top = points.length - 1, last = (rings - 1) * around;
  for (let k = 0; k < around; k++) {
    const next = (k + 1) % around;
    faces.push([bottom, next, k], [top, last + k, last + next]);
    for (let r = 0; r + 1 < rings; r++) {
      const a = r * around + k, b = r * around + next;
      faces.push([a, b, b + around], [a, b + around, a + around]);
    }
  }
  return [points, faces];
}

// Points in the body frame, and triangles, of the visuals of a robot's file.
function triangles(shape) {
  const rows = list => Array.from({length: list.length / 3},
                                  (_, k) => [...list.subarray(3 * k, 3 * k + 3)]);
  return [rows(numbers(shape.points, Float32Array)), rows(numbers(shape.faces, Int32Array))];
}

function numbers(text, Kind) {
  return new Kind(Uint8Array.from(atob(text), letter => letter.charCodeAt(0)).buffer);
}

// Row-major rotation matrix of the pose at p in places: x, y, z, and x, y, z, w of the quaternion.
function rotation(places, p) {
  const [x, y, z, w] = places.subarray(p + 3, p + 7);
  return [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
          2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
          2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)];
}

function placed(matrix, offset, [x, y, z]) {
  return [0, 3, 6].map((r, i) =>
    offset[i] + matrix[r] * x + matrix[r + 1] * y + matrix[r + 2] * z);
}

// Corners of the box about a body, in its frame.
function corners({turn, at, size}) {
  return [...Array(8).keys()].map(k => placed(turn, at, size.map((edge, i) => (k >> i & 1 ? .5 : -.5) * edge)));
}

// Geometry of the 3D view: points and colours of frame k, paths, ranges of the axes.
class Motion {
  constructor(view) {
    this.view = view;
    this.bodies = view.bodies;
    this.times = numbers(view.times, Float64Array);
    this.places = numbers(view.places, Float32Array);
    this.forces = numbers(view.forces, Float32Array);
    this.touches = this.forces.length / 6 / this.times.length;
    this.touching = numbers(view.touching, Float32Array);
    this.ends = numbers(view.ends, Int32Array);
    this.most = this.ends.reduce((most, end, k) => Math.max(most, end - (k ? this.ends[k - 1] : 0)), 0);
    this.breaks = new Set(view.breaks);
    this.layers = [0, 1].map(() => ({points: [], faces: [], opacity: 1}));   // opaque, transparent
    [...this.bodies, ...view.fixed].forEach((body, k) => {
      const i = k < this.bodies.length ? k : -1;
      for (const shape of body.shapes || [null]) {
        const [points, faces] = shape ? triangles(shape) : makeSolid(body.solid, body.size);
        const opacity = shape?.opacity ?? 1, layer = this.layers[opacity < 1 ? 1 : 0];
        const first = layer.points.length;
        for (const point of points)
          layer.points.push([i, shape ? point : placed(
            body.turn, body.at, point.map((x, k) => x * body.size[k]))]);
        for (const face of faces) layer.faces.push([i, ...face.map(k => k + first), shape?.colour]);
        layer.opacity = Math.min(layer.opacity, opacity);
      }
    });
    this.layers = this.layers.filter(layer => layer.faces.length);
  }

  pose(k, i) {
    const p = 7 * (k * this.bodies.length + i);
    return [rotation(this.places, p), this.places.subarray(p, p + 3)];
  }

  point(k, i, local) { return i < 0 ? local : placed(...this.pose(k, i), local); }

  pushed(k) {
    const time = this.times[k];
    return new Set(this.view.pushes.filter(([, from, to]) =>
      time >= from && (to === null || time < to)).map(([body]) => body));
  }

  // Forces of contacts: from the point to the tip, with its head, a line each.
  arrows(k) {
    const lines = [];
    for (let i = 0; i < this.touches; i++) {
      const at = 6 * (k * this.touches + i), [start, tip] = [at, at + 3].map(p => [...this.forces.subarray(p, p + 3)]);
      if (Number.isNaN(start[0])) continue;
      const along = tip.map((x, axis) => x - start[axis]), thin = along.map(Math.abs), side = [0, 0, 0];
      side[thin.indexOf(Math.min(...thin))] = .08 * Math.hypot(...along);
      const barb = sign => tip.map((x, axis) => x - .2 * along[axis] + sign * side[axis]);
      lines.push(start, tip, barb(1), barb(-1), tip, [null, null, null]);
    }
    return lines;
  }

  // Vertices of the octahedra at points of contacts that press and stick, or slip; the rest of them is in one place.
  points(k, slips) {
    const found = [], r = this.view.point, rest = this.point(k, 0, [0, 0, 0]);
    for (let p = k ? this.ends[k - 1] : 0; p < this.ends[k]; p++) {
      const [x, y, z, own] = this.touching.subarray(4 * p, 4 * p + 4);
      if (own === slips)
        found.push([x - r, y, z], [x, y - r, z], [x + r, y, z], [x, y + r, z], [x, y, z - r], [x, y, z + r]);
    }
    while (found.length < 6 * this.most) found.push(rest);
    return found;
  }

  // x, y, z of links, joints, the layers of bodies, the forces of contacts, their points that stick, that slip
  frame(k) {
    const poses = this.bodies.map((_, i) => this.pose(k, i));
    const parts = [[], []];
    for (const {parent, child, at} of this.view.joints) {
      const place = placed(...poses[child], at);
      parts[1].push(place);
      for (const i of [parent, child])
        if (i >= 0) parts[0].push(place, placed(...poses[i], this.bodies[i].com),
                                  [null, null, null]);
    }
    for (const ends of this.view.links)
      parts[0].push(...ends.map(([i, at]) => i < 0 ? at : placed(...poses[i], at)), [null, null, null]);
    for (const {points} of this.layers)
      parts.push(points.map(([i, local]) => i < 0 ? local : placed(...poses[i], local)));
    parts.push(this.arrows(k));
    if (this.most) parts.push(this.points(k, 0), this.points(k, 1));
    return [0, 1, 2].map(axis => parts.map(part => part.map(place => place[axis])));
  }

  colours(k, {faces}) {
    const pushed = this.pushed(k);
    return faces.map(([i, , , , own]) =>
      pushed.has(i) ? "--red" : own ?? (i < 0 ? "--grey" : this.bodies[i].colour));
  }

  paths() {
    const every = Math.max(1, Math.ceil(this.times.length * this.bodies.length / 6000));
    const all = this.bodies.map((body, i) => {
      const path = [];
      for (let k = 0; k < this.times.length; k++) {
        if (this.breaks.has(k)) path.push([null, null, null, ""]);
        if (k % every === 0 || k === this.times.length - 1)
          path.push([...this.point(k, i, body.com), `${this.times[k].toFixed(3)} s`]);
      }
      return curve(path, `path of ${body.name}`, body.colour, 2);
    });
    const red = [];
    for (const [i, from, to] of this.view.pushes.slice(0, 200)) {
      for (let k = 0; k < this.times.length; k++)
        if (this.times[k] >= from && (to === null || this.times[k] <= to))
          red.push([...this.point(k, i, this.bodies[i].com), `${this.times[k].toFixed(3)} s`]);
      red.push([null, null, null, ""]);
    }
    return red.some(([x]) => x !== null) ? [...all, curve(red, "wrench applied", "--red", 7)] : all;
  }

  // Each axis covers the motion, and at least a quarter of the longest axis for planar motions.
  axes() {
    const low = [Infinity, Infinity, Infinity], high = low.map(x => -x);
    const take = (place, radius) => place.forEach((x, axis) => {
      low[axis] = Math.min(low[axis], x - radius);
      high[axis] = Math.max(high[axis], x + radius);
    });
    const every = Math.max(1, Math.ceil(this.times.length / 500));
    for (let k = 0; k < this.times.length; k += every) {
      this.bodies.forEach((body, i) => corners(body).forEach(corner => take(this.point(k, i, corner), 0)));
      for (const {child, at} of this.view.joints) take(this.point(k, child, at), 0);
    }
    for (const corner of this.view.planes.flat()) take(corner, 0);
    for (const {shapes} of this.view.fixed)
      for (const {at, size} of shapes) take(at, .5 * Math.hypot(...size));
    const longest = Math.max(...high.map((x, i) => x - low[i])) || 1;
    const lengths = high.map((x, i) => 1.04 * Math.max(x - low[i], longest / 4));
    const mean = Math.cbrt(lengths.reduce((a, b) => a * b)), style = {
      color: "--soft", gridcolor: "--grid", zerolinecolor: "--grid", showbackground: false,
      showspikes: false};
    const scene = {aspectmode: "manual", aspectratio: {}, dragmode: "turntable"};
    ["x", "y", "z"].forEach((name, i) => {
      const middle = (low[i] + high[i]) / 2, half = lengths[i] / 2;
      scene[`${name}axis`] = {...style, title: {text: `${name} / m`},
                              nticks: Math.max(2, Math.round(6 * lengths[i] / longest)),
                              range: [middle - half, middle + half]};
      scene.aspectratio[name] = lengths[i] / mean;
    });
    return scene;
  }
}

// Camera that shows the whole box; it views a plane of motion from the side, not along the plane.
function camera({x, y, z}, width, height) {
  const box = [x, y, z], thin = Math.min(...box), view = [.62, -.95, .5].map(
    (part, i) => box[i] === thin && thin < .6 * Math.max(...box) ? 2 * part : part);
  const size = Math.hypot(...view), to = view.map(part => part / size);
  const flat = Math.hypot(to[0], to[1]), right = [-to[1] / flat, to[0] / flat, 0];
  const up = [to[1] * right[2] - to[2] * right[1], to[2] * right[0] - to[0] * right[2],
              to[0] * right[1] - to[1] * right[0]];
  const dot = (a, b) => a.reduce((sum, part, i) => sum + part * b[i], 0);
  const corners = [...Array(8).keys()].map(k => box.map((edge, i) => (k >> i & 1 ? .5 : -.5) * edge));
  const slope = Math.tan(Math.PI / 8);        // plotly's field of view is 45 degrees high
  // Fractions of the card that the box may fill; the rest is for the labels of its axes.
  const across = (1 - 110 / width) * slope * width / height, rise = (1 - 60 / height) * slope;
  // Each corner at depth d - to.c must be within the fractions of its depth.
  const distance = Math.max(...corners.map(c => dot(to, c) + Math.max(Math.abs(dot(right, c)) / across,
                                                                      Math.abs(dot(up, c)) / rise)));
  const low = 28 / height * distance * slope;         // raises the picture by 14 px: labels are below the box
  const point = along => ({x: along[0], y: along[1], z: along[2]}), centre = up.map(part => -low * part);
  return {eye: point(centre.map((part, i) => part + distance * to[i])), center: point(centre)};
}

function curve(path, name, colour, width) {
  return {type: "scatter3d", mode: "lines", name, x: path.map(p => p[0]), y: path.map(p => p[1]),
          z: path.map(p => p[2]), text: path.map(p => p[3]), line: {color: colour, width},
          opacity: .75, connectgaps: false,
          hovertemplate: "%{text}<br>%{x:.4g}, %{y:.4g}, %{z:.4g} m"};
}

// Numbers of vertices of so many octahedra, from those of one.
function octahedra(count, own) {
  return [...Array(count).keys()].flatMap(p => own.map(n => 6 * p + n));
}

function drawView(root, view, planes) {
  const motion = new Motion(view), plot = root.querySelector(".plot");
  const [button, slider, speeds, output] = ["button", "input", "select", "output"].map(
    name => root.querySelector(name));
  const count = motion.times.length, start = motion.times[0], end = motion.times[count - 1];
  const paths = motion.paths(), last = 2 + motion.layers.length;
  const moving = [...Array(last + (motion.most ? 3 : 1)).keys()].map(k => paths.length + k);
  const scene = motion.axes(), height = narrow() ? 360 : 430;
  scene.camera = camera(scene.aspectratio, plot.clientWidth, height - view.layout.margin.t);
  const state = {frame: 0, time: start, playing: false, motion, plot, shown: ""};

  function draw() {
    const [x, y, z] = motion.frame(state.frame), k = state.frame;
    state.shown = [...motion.pushed(k)].join();
    const data = [...paths,
      {type: "scatter3d", mode: "lines", x: x[0], y: y[0], z: z[0], hoverinfo: "skip",
       showlegend: false, connectgaps: false, line: {color: "--soft", width: 4}},
      {type: "scatter3d", mode: "markers", x: x[1], y: y[1], z: z[1], showlegend: false,
       text: view.joints.map(joint => joint.name), hoverinfo: "text",
       marker: {size: 3.5, color: "--text"}},
      ...motion.layers.map((layer, n) => (
        {type: "mesh3d", x: x[2 + n], y: y[2 + n], z: z[2 + n], i: layer.faces.map(f => f[1]),
         j: layer.faces.map(f => f[2]), k: layer.faces.map(f => f[3]), opacity: layer.opacity,
         facecolor: motion.colours(k, layer), flatshading: true, hoverinfo: "text",
         text: layer.points.map(([i]) => i < 0 ? "fixed" : motion.bodies[i].name),
         showlegend: false, lighting: {ambient: .6, diffuse: .7, specular: .08, roughness: .9},
         lightposition: {x: 2000, y: -4000, z: 6000}})),
      {type: "scatter3d", mode: "lines", name: "contact force", x: x[last], y: y[last], z: z[last], hoverinfo: "skip",
       showlegend: motion.touches > 0, connectgaps: false, line: {color: "--green", width: 6}},
      ...(motion.most ? [["contact sticks", "--green"], ["contact slips", "--pink"]] : []).map(([name, color], n) => (
        {type: "mesh3d", name, x: x[last + 1 + n], y: y[last + 1 + n], z: z[last + 1 + n],
         i: octahedra(motion.most, [0, 1, 2, 3, 0, 1, 2, 3]), j: octahedra(motion.most, [1, 2, 3, 0, 1, 2, 3, 0]),
         k: octahedra(motion.most, [4, 4, 4, 4, 5, 5, 5, 5]), color, flatshading: true, hoverinfo: "name",
         showlegend: n > 0, lighting: {ambient: 1, diffuse: .1}})),
      ...view.planes.flatMap(corners => [
        {type: "mesh3d", x: corners.map(p => p[0]), y: corners.map(p => p[1]), z: corners.map(p => p[2]),
         i: corners.slice(2).map(() => 0), j: corners.slice(2).map((_, n) => n + 1),
         k: corners.slice(2).map((_, n) => n + 2), color: "--soft", opacity: .3, hoverinfo: "skip",
         showlegend: false},
        {...curve([...corners, corners[0]], "plane", "--soft", 3), hoverinfo: "skip", showlegend: false}])];
    paths.forEach((path, i) => { if (i >= 6) path.showlegend = false; });
    return Plotly.react(plot, themed(data), themed({...view.layout, scene,
      height, uirevision: 1, modebar: MODEBAR,
      showlegend: paths.length > 1 || motion.touches > 0}), {
      ...CONFIG, scrollZoom: false, modeBarButtons: [["zoom3d", "pan3d", "tableRotation",
                                                      "resetCameraDefault3d"]]});
  }

  function show(time) {
    state.time = Math.min(end, Math.max(start, time));
    let low = 0, high = count - 1;          // binary search for the last frame at or before this time
    while (low < high) {
      const middle = low + high + 1 >> 1;
      if (motion.times[middle] <= state.time) low = middle; else high = middle - 1;
    }
    output.textContent = `${state.time.toFixed(view.digits)} s`;
    for (const plane of planes) plane.cursor(state.time);
    if (low === state.frame) return;
    state.frame = low;
    slider.value = low;
    const [x, y, z] = motion.frame(low), pushed = [...motion.pushed(low)].join();
    Plotly.restyle(plot, {x, y, z}, moving);
    if (pushed !== state.shown) {
      state.shown = pushed;
      Plotly.restyle(plot, {facecolor: motion.layers.map(layer => themed(motion.colours(low, layer), "color"))},
                     moving.slice(2, last));
    }
  }

  function play(on) {
    state.playing = on;
    button.textContent = on ? "Pause" : "Play";
    if (!on) return;
    if (state.time >= end) show(start);
    let last = performance.now();
    const step = now => {
      if (!state.playing) return;
      show(state.time + (now - last) / 1000 * Number(speeds.value));
      last = now;
      if (state.time >= end) play(false); else requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  }

  slider.addEventListener("input", () => { play(false); show(motion.times[slider.value]); });
  button.addEventListener("click", () => play(!state.playing));
  drawn.set(plot, draw);
  draw();
  output.textContent = `${start.toFixed(view.digits)} s`;
  for (const plane of planes) plane.cursor(start);
  views.push(state);
  return time => { play(false); show(time); };
}

// Draw the plots of a recording once, when its section is expanded.
function open(root) {
  if (root.dataset.open) return;
  root.dataset.open = "1";
  const part = DATA[root.dataset.part], view = root.querySelector(".view");
  const planes = [...root.querySelectorAll(".plane")];
  let go = () => {};
  planes.forEach((plane, k) => drawPlane(plane, part.plots[k], part.view && (t => go(t))));
  for (const picker of root.querySelectorAll(".picker")) drawPicker(picker, planes, part.plots);
  if (view) go = drawView(view, part.view, planes);
}

for (const root of document.querySelectorAll("[data-part]")) {
  if (root.tagName !== "DETAILS" || root.open) open(root);
  else root.addEventListener("toggle", () => root.open && open(root));
}
// A link of the overview expands its target.
function follow() {
  const root = /^#log\d+$/.test(location.hash) && document.querySelector(location.hash);
  if (root) root.open = true;
}
addEventListener("hashchange", follow);
follow();
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  for (const draw of drawn.values()) draw();
});
