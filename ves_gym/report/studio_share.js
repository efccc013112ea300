// What is drawn: undone, sent as a link, and saved as a picture.

const LINK = "#studio="; // begins the part of the address that holds the page's state
const SHARED = ["map-pair", "map-kind", "motion-a", "motion-b", "scene-speed", "scene-magnify"];
const PRESSED = ["scene-swap", "chart-limits"];
const GESTURE = 150; // ms without a change end a step that can be undone
const past = { steps: [], at: -1, timer: 0 };

// ------------------------------------------------------------------------------- undo

function rememberSoon() {
  clearTimeout(past.timer);
  past.timer = setTimeout(remember, GESTURE);
}

function remember() {
  clearTimeout(past.timer);
  const now = JSON.stringify({ points: path.points, duration: path.duration });
  if (now !== past.steps[past.at]) past.steps.splice(past.at += 1, Infinity, now);
  $("undo").setAttribute("aria-disabled", past.at === 0);
  $("redo").setAttribute("aria-disabled", past.at === past.steps.length - 1);
}

/** Go to the step before (-1) or after (1), if there is one. */
function goTo(way) {
  remember();
  if (!past.steps[past.at + way]) return;
  past.at += way;
  drawPath(JSON.parse(past.steps[past.at]));
  remember();
}

function drawPath({ points, duration, selected = Math.min(path.selected, points.length - 1) }) {
  Object.assign(path, { points, duration, selected });
  showDuration();
  pointsChanged();
  shadeMap();
}

// ------------------------------------------------------------------------------- link

function stateOfPage() {
  return {
    machine: data.machine.hash, points: path.points, duration: path.duration, selected: path.selected, camera, t: film.t,
    controls: Object.fromEntries(SHARED.map((id) => [id, $(id).value])),
    pressed: PRESSED.filter((id) => $(id).getAttribute("aria-pressed") === "true"),
  };
}

/** Refuse what the page cannot show, before any of it is shown. */
function requireState({ machine, points, duration, selected, camera: seen, t, controls, pressed }) {
  if (machine !== data.machine.hash) throw new Error("it is of another arm or base than this page");
  const within = (q) => q.length === links.length
    && q.every((angle, j) => Number.isFinite(angle) && withinLimits(j, angle) === angle);
  const { min, max } = $("duration");
  if (!(points.length > 1 && points.every(within) && points[selected] && duration >= min && duration <= max)) {
    throw new Error("its path is not one of this arm");
  }
  const view = [t, ...Object.keys(HOME).map((key) => seen[key])];
  if (!view.every(Number.isFinite) || !pressed.every((id) => PRESSED.includes(id)) || !controls) {
    throw new Error("its view is incomplete");
  }
}

/** Show what the address says; of a bad one, why not. */
function openLink() {
  if (!location.hash.startsWith(LINK)) return;
  try {
    const state = JSON.parse(decodeURIComponent(location.hash.slice(LINK.length)));
    requireState(state);
    showState(state);
  } catch (error) {
    const why = error instanceof SyntaxError || error instanceof URIError || error instanceof TypeError
      ? "it is cut off or changed" : error.message;
    sayOfLink(`The link was not opened: ${why}.`, true);
  }
}

function showState(state) {
  drawPath(state);
  const absent = SHARED.filter((id) => {
    const [control, value] = [$(id), state.controls[id]];
    if (control.options && ![...control.options].some((option) => option.value === value)) return true;
    control.value = value;
    for (const kind of ["input", "change"]) control.dispatchEvent(new Event(kind));
    return false;
  });
  for (const id of PRESSED) {
    if (state.pressed.includes(id) !== ($(id).getAttribute("aria-pressed") === "true")) $(id).click();
  }
  for (const key of Object.keys(HOME)) camera[key] = state.camera[key];
  refresh();
  seek(state.t);
  remember();
  sayOfLink(absent.length ? `Not on this page: ${absent.map((id) => state.controls[id]).join(", ")}.` : "");
}

async function copyLink() {
  const hash = LINK + encodeURIComponent(JSON.stringify(stateOfPage()));
  history.replaceState(null, "", hash);
  try {
    await navigator.clipboard.writeText(location.href);
    sayOfLink("The link is copied.");
  } catch {
    sayOfLink("Copy the link from the address bar.");
  }
}

function sayOfLink(text, bad = false) {
  $("link-note").textContent = text;
  $("link-note").classList.toggle("bad", bad);
}

// ---------------------------------------------------------------------------- pictures

/** A canvas's context that writes SVG, of the calls that the map and the charts make. */
class Paper {
  constructor(w, h) {
    this.root = svg("svg", { viewBox: `0 0 ${w} ${h}`, width: w, height: h });
    Object.assign(this, { group: this.root, groups: [], way: "", dashes: [], globalAlpha: 1, textAlign: "left" });
  }

  put(tag, attributes, ...inside) {
    const opacity = this.globalAlpha === 1 ? null : this.globalAlpha;
    this.group.append(svg(tag, { ...attributes, opacity }, ...inside));
  }

  save() { this.groups.push(this.group); this.group = this.group.appendChild(svg("g")); }
  restore() { this.group = this.groups.pop(); }
  turn(text) { this.group.setAttribute("transform", `${this.group.getAttribute("transform") ?? ""} ${text}`); }
  translate(x, y) { this.turn(`translate(${x} ${y})`); }
  rotate(angle) { this.turn(`rotate(${angle * DEG})`); }
  setLineDash(dashes) { this.dashes = dashes; }

  beginPath() { this.way = ""; }
  moveTo(x, y) { this.way += `M${x.toFixed(2)} ${y.toFixed(2)}`; }
  lineTo(x, y) { this.way += `L${x.toFixed(2)} ${y.toFixed(2)}`; }
  rect(x, y, w, h) { this.way += `M${x} ${y}h${w}v${h}h${-w}z`; }
  arc(x, y, r) { this.way += `M${x - r} ${y}a${r} ${r} 0 1 0 ${2 * r} 0a${r} ${r} 0 1 0 ${-2 * r} 0z`; } // whole

  clip() {
    this.group.append(svg("clipPath", { id: "inside" }, svg("path", { d: this.way })));
    this.group.setAttribute("clip-path", "url(#inside)");
  }

  fill() { this.put("path", { d: this.way, fill: this.fillStyle }); }
  fillRect(x, y, width, height) { this.put("rect", { x, y, width, height, fill: this.fillStyle }); }

  stroke() {
    this.put("path", {
      d: this.way, fill: "none", stroke: this.strokeStyle, "stroke-width": this.lineWidth, "stroke-linejoin": "round",
      "stroke-linecap": "round", "stroke-dasharray": this.dashes.join(" ") || null,
    });
  }

  fillText(text, x, y) {
    const anchor = { left: "start", center: "middle", right: "end" }[this.textAlign];
    this.put("text", { x, y, fill: this.fillStyle, style: `font: ${this.font}`, "text-anchor": anchor }, text);
  }

  drawImage(image, x, y, width, height) {
    this.put("image", { "data-href": image.toDataURL(), x, y, width, height, preserveAspectRatio: "none" });
  }
}

/** What a function draws on canvases, as papers; the canvases stay as they are. */
function onPaper(canvases, draw) {
  for (const canvas of canvases) canvas.paper = new Paper(canvas.clientWidth, canvas.clientHeight);
  draw();
  return canvases.map((canvas) => {
    const { paper } = canvas;
    delete canvas.paper;
    return paper;
  });
}

function pictureOfMap() {
  const [paper] = onPaper([$("map-canvas")], paintMap);
  Object.assign(paper, { font: "600 12px system-ui, sans-serif", textAlign: "center" });
  [...$("map-handles").children].forEach((handle, k) => {
    const [x, y] = chart.frame.to(onMap(path.points[k]));
    paper.beginPath();
    paper.arc(x, y, 11);
    paper.fillStyle = ink("--ink");
    paper.fill();
    paper.fillStyle = ink("--card");
    paper.fillText(handle.textContent, x, y + 4);
  });
  return paper.root;
}

/** Charts that are not empty, two beside each other under their titles. */
function pictureOfCharts() {
  const rows = charts.filter((row) => !row.cells[0].figure.hidden);
  const papers = rows.map((row) => onPaper(row.cells.map((cell) => cell.canvas), () => drawRow(row)));
  const [{ clientWidth: w, clientHeight: h }, top] = [rows[0].cells[0].canvas, 40];
  const whole = new Paper(2 * w, rows.length * (h + top));
  Object.assign(whole, { font: "12px system-ui, sans-serif", fillStyle: ink("--card") });
  whole.fillRect(0, 0, 2 * w, rows.length * (h + top));
  rows.forEach((row, i) => row.cells.forEach((cell, side) => {
    whole.save();
    whole.translate(side * w, i * (h + top) + top);
    whole.fillStyle = ink("--ink");
    whole.fillText(cell.figure.querySelector("strong").textContent, 8, -24);
    cell.lines.forEach(({ name }, k) => {
      whole.fillStyle = lineColour(row.spec, shown[side], k);
      whole.fillText(name, 8 + k * (w - 16) / cell.lines.length, -7);
    });
    whole.group.append(papers[i][side].root);
    whole.restore();
  }));
  return whole.root;
}

function download(text, type, name) {
  const address = URL.createObjectURL(new Blob([text], { type }));
  el("a", { href: address, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(address), 1000);
}

function savePicture(picture, name) {
  // images get their address in the text: the page itself may load none
  const text = new XMLSerializer().serializeToString(picture()).replaceAll(" data-href=", " href=");
  download(text, "image/svg+xml", name);
}

function connectShare() {
  $("share").hidden = location.protocol === "about:"; // a notebook's cell has no address
  $("share").addEventListener("click", copyLink);
  $("undo").addEventListener("click", () => goTo(-1));
  $("redo").addEventListener("click", () => goTo(1));
  $("map-picture").addEventListener("click", () => savePicture(pictureOfMap, "map.svg"));
  $("charts-picture").addEventListener("click", () => savePicture(pictureOfCharts, "charts.svg"));
  addEventListener("hashchange", openLink);
  addEventListener("keydown", (event) => {
    if (!(event.ctrlKey || event.metaKey) || event.key.toLowerCase() !== "z") return;
    event.preventDefault();
    goTo(event.shiftKey ? 1 : -1);
  });
  remember();
  openLink();
}
