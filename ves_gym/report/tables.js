// The summary table with its bars, and the table of all runs.

const straight = new Map(); // E_mean of the straight line by vehicle and query
for (const row of data.rows ?? []) {
  if (row.planner === BASELINE) straight.set(JSON.stringify([row.vehicle, row.query]), row.E_mean);
}

function ratioOf(row) {
  const base = straight.get(JSON.stringify([row.vehicle, row.query]));
  return base > 0 && row.E_mean !== null ? row.E_mean / base : null;
}

// ---------------------------------------------------------------------- summary

const MOVES = (data.summary ?? []).some((row) => typeof row.acceleration_peak_median === "number");
const BAR = { w: 190, h: 22, pad: 5 };

/** Median as a bar, its interval as a whisker, every query as a dot; 1 is the straight line. */
function ratioBar(row, top) {
  const x = (value) => BAR.pad + (BAR.w - 2 * BAR.pad) * Math.min(value / top, 1);
  const style = `fill:${colour(row.planner)};stroke:${colour(row.planner)}`;
  const picture = svg("svg", {
    class: "bar", viewBox: `0 0 ${BAR.w} ${BAR.h}`, style, "aria-hidden": "true",
  });
  picture.append(svg("rect", {
    x: x(0), y: 6, width: x(row.ratio_median) - x(0), height: 10, opacity: 0.45, stroke: "none",
  }));
  picture.append(svg("line", {
    x1: x(1), x2: x(1), y1: 0, y2: BAR.h, style: "stroke:var(--ink)", opacity: 0.55,
  }));
  if (row.planner !== BASELINE && row.n > 1) {
    for (const run of data.rows) {
      if (run.planner !== row.planner || run.vehicle !== row.vehicle) continue;
      const ratio = run.duration === row.duration ? ratioOf(run) : null;
      if (ratio === null) continue;
      picture.append(svg("circle", { cx: x(ratio), cy: 11, r: 2.2, opacity: 0.4, stroke: "none" }));
    }
  }
  if (row.ratio_high > row.ratio_low) {
    const [low, high] = [x(row.ratio_low), x(row.ratio_high)];
    picture.append(svg("path", {
      d: `M${low} 11H${high}M${low} 7V15M${high} 7V15`, "stroke-width": 1.6, fill: "none",
    }));
  }
  if (row.ratio_median > top) {
    picture.append(svg("path", { d: `M${BAR.w - 9} 6l5 5l-5 5`, fill: "none", "stroke-width": 2 }));
  }
  return picture;
}

function summaryTable(groups) {
  const rows = groups.flatMap((group) => group.rows);
  const top = Math.min(Math.max(1.3, ...rows.map((row) => 1.05 * row.ratio_high)), 3);
  const head = [
    ["case", ""], ["planner", ""], ["ratio to straight", `0 to ${number(top, 2)}`],
    ["E_mean", "ratio"], ["95 %", "interval"], ["E_mean", "J"], ["E_res", "ratio"],
    ["E_peak", "ratio"], ...(MOVES ? [["acceleration", "peak, ratio"], ["tip", "peak, ratio"]] : []),
    ...(EMULATED ? [["emulation", "error"], ["base", "error"]] : []), ["predicted", "error"],
    ["planning", "s"], ["95 %", "below s"], ["success", ""], ["solvable", "solved"], ["queries", ""],
  ];
  const header = el("tr", { role: "row" }, ...head.map(([name, unit], k) => el("th",
    { scope: "col", role: "columnheader", class: k > 2 ? "number" : null },
    symbol(name), unit ? el("span", { class: "unit" }, unit) : null)));
  const bodies = groups.map((group) => summaryGroup(group, top, head.slice(2)));
  $("summary").append(el("thead", { role: "rowgroup" }, header), ...bodies);
}

/** The rows of a case; each number carries its heading, shown where rows are stacked. */
function summaryGroup(group, top, headings) {
  const best = group.rows.length > 1 ? least(group.rows) : null;
  const body = el("tbody", { role: "rowgroup" });
  group.rows.forEach((row, k) => {
    const cell = (text, kind = "") => el("td", { class: `number ${kind}` }, text);
    const line = el("tr", { role: "row", class: row === best ? "best" : null });
    if (k === 0) {
      line.append(el("th", { scope: "rowgroup", role: "rowheader", rowspan: group.rows.length },
        `${group.vehicle} `, el("br"), `T = ${group.duration} s`));
    }
    line.append(
      el("th", { scope: "row", role: "rowheader", class: "planner" }, swatch(row.planner), row.planner),
      el("td", { class: "ratio" }, ratioBar(row, top)),
      cell(number(row.ratio_median)),
      cell(span(row.ratio_low, row.ratio_high), "soft"),
      cell(number(row.E_mean_median)),
      cell(number(row.E_res_ratio_median)),
      cell(number(row.E_peak_ratio_median)),
      ...(MOVES ? [
        cell(number(row.acceleration_peak_ratio_median)), cell(number(row.tip_peak_ratio_median)),
      ] : []),
      ...(EMULATED ? [
        row.stopped === row.n ? cell("stopped", "bad") : cell(signed(row.emulation_error_median)),
        cell(percent(row.base_error_median)),
      ] : []),
      cell(percent(row.prediction_error_median), "soft"),
      cell(number(row.plan_seconds_median, 2), "soft"),
      cell(number(row.plan_seconds_p95, 2), "soft"),
      cell(percent(row.success_rate), row.success_rate < 1 ? "bad" : "soft"),
      cell(percent(row.solvable_rate ?? null), row.solvable_rate < 1 ? "bad" : "soft"),
      cell(String(row.n), "soft"),
    );
    line.querySelectorAll("td").forEach((each, at) => {
      const [name, unit] = headings[at];
      each.setAttribute("role", "cell");
      each.prepend(el("span", { class: "label", "aria-hidden": "true" }, symbol(name), ` ${unit}`));
    });
    body.append(line);
  });
  return body;
}

summaryTable(cases());

/** A table as wide as its frame, or else one block per row: no column is ever out of sight. */
function fitSummary() {
  const table = $("summary");
  table.classList.remove("dense", "stacked");
  for (const closer of ["dense", "stacked"]) {
    if (table.scrollWidth <= table.parentElement.clientWidth) return;
    table.classList.add(closer);
  }
}

fitSummary();
addEventListener("resize", fitSummary);

// --------------------------------------------------------------------- all runs

// key, heading, unit, text of a value (a text column has none)
const COLUMNS = [
  ["planner", "planner", ""], ["query", "query", ""], ["vehicle", "vehicle", ""],
  ["duration", "T", "s", String],
  ["E_mean", "E_mean", "J", number], ["ratio", "ratio", "to straight", number],
  ["E_res", "E_res", "J", number], ["E_peak", "E_peak", "J", number],
  ["E_strain_peak", "E_strain peak", "J", number], ["E_int", "E_int", "J s", number],
  ["W_port", "W_port", "J", number], ["t_5", "t_5 %", "s", number],
  ...(MOVES ? [
    ["acceleration", "acceleration", "rms, m/s²", number],
    ["acceleration_peak", "acceleration", "peak, m/s²", number],
    ["angular", "angular acc.", "rms, rad/s²", number],
    ["angular_peak", "angular acc.", "peak, rad/s²", number],
    ["tip_peak", "tip error", "peak, m", number], ["tip_end", "tip error", "at the end, m", number],
    ["displacement_peak", "displacement", "peak, m", number],
    ["rotation_peak", "rotation", "peak, rad", number],
    ["attitude_end", "attitude", "at the end, rad", number],
    ["E_weighted", "E_weighted", "J", number],
  ] : []),
  ...(EMULATED ? [
    ["E_mean_ideal", "E_mean", "J in space", number],
    ["emulation_error", "emulation", "error", signed], ["base_error", "base", "error", percent],
  ] : []),
  ["predicted", "predicted", "J", number], ["prediction_error", "error", "", percent],
  ["plan_seconds", "planning", "s", (value) => number(value, 2)],
  ["success", "success", "", (value) => (value ? "yes" : "failed")],
  ["failure", "why", ""],
  ...(EMULATED ? [["stopped", "stopped", ""]] : []),
];
const FIRST = 200; // rows shown until all are asked for

const runs = (data.rows ?? []).map((row) => ({ ...row, ratio: ratioOf(row) }));
const words = new Map(runs.map((row) => [row, [
  row.planner, row.query, row.vehicle, row.mode, `${row.duration}s`, row.success ? "" : "failed",
].join(" ").toLowerCase()]));
const shown = { key: null, down: false, all: false };

/** The runs that match every word of the filter, sorted; a missing value comes last. */
function selected() {
  const terms = $("rows-filter").value.toLowerCase().split(/\s+/).filter(Boolean);
  const some = runs.filter((row) => terms.every((term) => words.get(row).includes(term)));
  if (shown.key === null) return some;
  const sign = shown.down ? -1 : 1;
  const missing = (value) => value === null || value === undefined;
  return some.sort((a, b) => {
    const [x, y] = [a[shown.key], b[shown.key]];
    if (missing(x) || missing(y)) return missing(x) - missing(y);
    return sign * (typeof x === "string" ? x.localeCompare(y) : x - y);
  });
}

const lines = new Map(); // table rows already made

function lineOf(row) {
  if (lines.has(row)) return lines.get(row);
  const line = el("tr");
  for (const [key, , , text] of COLUMNS) {
    const value = row[key];
    const missing = value === null || value === undefined;
    const kind = key === "success" && !value ? "number bad" : "number";
    line.append(el("td", { class: text ? kind : null }, missing ? "–" : text ? text(value) : value));
  }
  lines.set(row, line);
  return line;
}

function drawRows() {
  const some = selected();
  const visible = shown.all ? some : some.slice(0, FIRST);
  $("rows-table").tBodies[0].replaceChildren(...visible.map(lineOf));
  $("rows-count").textContent = some.length === visible.length
    ? `${some.length} of ${runs.length} runs`
    : `${visible.length} shown of ${some.length} that match`;
  $("rows-more").hidden = some.length === visible.length;
  $("rows-more").textContent = `Show all ${some.length}`;
}

function sortBy(key, header) {
  shown.down = shown.key === key && !shown.down;
  shown.key = key;
  for (const th of $("rows-table").querySelectorAll("th")) th.setAttribute("aria-sort", "none");
  header.setAttribute("aria-sort", shown.down ? "descending" : "ascending");
  drawRows();
}

function rowsTable() {
  const header = el("tr");
  for (const [key, name, unit, text] of COLUMNS) {
    const button = el("button", { type: "button" }, symbol(name));
    const th = el("th", { scope: "col", "aria-sort": "none", class: text ? "number" : null }, button,
      el("span", { class: "unit" }, unit || "\u00a0"));
    button.addEventListener("click", () => sortBy(key, th));
    header.append(th);
  }
  $("rows-table").append(el("thead", {}, header), el("tbody"));
  drawRows();
}

/** The selected runs as comma-separated values, in full precision. */
function csv() {
  const skipped = (value) => typeof value === "object" && value !== null;
  const keys = [...new Set(runs.flatMap((row) => Object.keys(row).filter((key) => !skipped(row[key]))))];
  const field = (value) => {
    const text = String(value ?? "");
    return /[",\n\r]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
  };
  const lines = selected().map((row) => keys.map((key) => field(row[key])).join(","));
  return `${[keys.join(","), ...lines].join("\n")}\n`;
}

$("rows-filter").addEventListener("input", drawRows);
$("rows-more").addEventListener("click", () => { shown.all = true; drawRows(); });
$("rows-csv").addEventListener("click", () => {
  const address = URL.createObjectURL(new Blob([csv()], { type: "text/csv" }));
  el("a", { href: address, download: `${data.suite}.csv` }).click();
  setTimeout(() => URL.revokeObjectURL(address), 1000);
});
rowsTable();
